// SPDX-License-Identifier: Apache-2.0

#include "impact.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

namespace impact_rs {

namespace {

// Ratio of impulses to velocities above which the solver uses the root: from 14 points of one arm on. Boxes have 8,
// random problems never more. Points given by the caller, as a grid on a face, cost 1.3 times as much without it for 16
// points, 9 times for 64.
constexpr int ROOT_RATIO = 3;
constexpr double ORTHONORMAL = 1e-6;  // of a rotation, as check_problem() of problem.py
constexpr double FREE_BODY_JACOBIAN[36] = {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0,
                                           0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0,
                                           0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0};

Matrix matrix(const double* values) {
  Matrix m;
  std::copy(values, values + 9, m.begin());
  return m;
}

bool within(const double* values, const double* low, const double* high, int count) {
  for (int i = 0; i < count; ++i)
    if (!(low[i] <= values[i] && values[i] <= high[i])) return false;
  return true;
}

bool finite(const double* values, int count) {
  for (int i = 0; i < count; ++i)
    if (!std::isfinite(values[i])) return false;
  return true;
}

double mean(const std::vector<double>& values) {
  return values.empty() ? 1.0 : std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

bool is_rotation(const Matrix& m) {
  double worst = 0.0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const double product = dot({m[3 * i], m[3 * i + 1], m[3 * i + 2]}, {m[3 * j], m[3 * j + 1], m[3 * j + 2]});
      worst = std::max(worst, std::abs(product - (i == j ? 1.0 : 0.0)));
    }
  return worst <= ORTHONORMAL && dot(column(m, 0), cross(column(m, 1), column(m, 2))) > 0.0;
}

void twist_of(const double* jacobian, const double* rates, int joints, double* twist) {
  for (int i = 0; i < 6; ++i) {
    twist[i] = 0.0;
    for (int j = 0; j < joints; ++j) twist[i] += jacobian[i * joints + j] * rates[j];
  }
}

// Three rows of the angular velocity times a length.
void turning_rows(const double* jacobian, int columns, double length, double* rows) {
  for (int j = 0; j < 3 * columns; ++j) rows[j] = length * jacobian[3 * columns + j];
}

// Three rows of the velocity of a point at `lever` from the origin of a twist: linear + angular x lever, times columns.
void point_rows(const double* jacobian, int columns, const Vector& lever, double sign, double* rows) {
  const double* angular = jacobian + 3 * columns;
  for (int j = 0; j < columns; ++j) {
    const Vector turned = cross({angular[j], angular[columns + j], angular[2 * columns + j]}, lever);
    for (int k = 0; k < 3; ++k) rows[k * columns + j] = sign * (jacobian[k * columns + j] + turned[k]);
  }
}

}  // namespace

bool Impact::is_valid(const Arms& arms, const Objects& objects) const {
  for (const ArmState& arm : arms) {
    if (!within(arm.position, arm.low, arm.high, arm.joints)) return false;
    for (int j = 0; j < arm.joints; ++j)
      if (!(std::abs(arm.velocity[j]) <= arm.fastest[j] && arm.motor[j] >= 0.0 && std::isfinite(arm.motor[j])))
        return false;
  }
  return std::all_of(objects.begin(), objects.end(), [](const ObjectState& object) {
    return finite(object.position, 3) && finite(object.twist, 6) && finite(object.axes, 9) &&
           is_rotation(matrix(object.axes)) &&
           !(object.fixed() && std::any_of(object.twist, object.twist + 6, [](double value) { return value != 0.0; }));
  });
}

Impact::Side Impact::object_side(const Objects& objects, int number) const {
  const ObjectState& object = objects[number];
  const int block = static_cast<int>(blocks_.size() - objects.size()) + number;
  return {FREE_BODY_JACOBIAN, object.fixed() ? 0 : 6, vector(object.position), block};
}

// Block of H with the velocities of a partner; -1: the support, which has none.
int Impact::block_of(const Arms& arms, int partner) const {
  const int count = static_cast<int>(arms.size());
  if (partner < count) return arms[partner].carrier;
  return partner == count ? -1 : partner - 1;
}

Impact::Side Impact::partner_side(const Arms& arms, const Objects& objects, int partner) const {
  const int count = static_cast<int>(arms.size());
  if (partner < count) return {arms[partner].jacobian, arms[partner].joints, origins_[partner], block_of(arms, partner)};
  return partner == count ? Side{FREE_BODY_JACOBIAN, 0, {}, -1} : object_side(objects, partner - count - 1);
}

bool Impact::find_points(const Arms& arms, const Objects& objects, const ContactState& contact) {
  points.clear();
  const int count = static_cast<int>(arms.size());
  const auto body_of = [](const ObjectState& object) {
    return ConvexBody{vector(object.position), matrix(object.axes), vector(object.half), object.shape};
  };
  const auto add = [this, &contact](int partner, const ConvexBody& other, int number, const ConvexBody& body,
                                    double friction) {
    const SeparatingAxis separating = separating_axis(other, body, rules_.aligned);
    if (!(-separating.separation <= rules_.penetration)) return false;
    if (!(separating.separation <= rules_.gap)) return true;
    manifold_.clear();
    contact_manifold(other, body, separating, rules_.gap, manifold_);
    const ContactLaw law{friction, *contact.restitution};
    for (const ManifoldPoint& candidate : manifold_)
      points.push_back({partner, candidate.position, separating.normal, {}, candidate.gap, State::open, law, number});
    return true;
  };
  for (int number = 0; number < static_cast<int>(objects.size()); ++number) {
    const ConvexBody body = body_of(objects[number]);
    for (int partner = 0; partner < count; ++partner) {
      const ArmState& arm = arms[partner];
      const Matrix axes = matrix(arm.axes);
      const ConvexBody pad{origins_[partner] + axes * vector(arm.pad_centre), axes * matrix(arm.pad_axes),
                           vector(arm.pad_half), arm.pad_shape};
      if (!add(partner, pad, number, body, *contact.pad_friction)) return false;
    }
    if (contact.support != nullptr) {
      const ConvexBody below{vector(contact.support), IDENTITY, vector(contact.support + 3)};
      if (!add(count, below, number, body, *contact.support_friction)) return false;
    }
    for (int before = 0; before < number; ++before)
      if (!add(count + 1 + before, body_of(objects[before]), number, body, *contact.object_friction)) return false;
  }
  return true;
}

// Inertia of an object at its middle. A fixed one keeps its velocity: no column of J_c is its own, and any inertia does.
void Impact::add_object(const ObjectState& object, Block& body) {
  body.start = static_cast<int>(before_.size());
  body.size = 6;
  body.inertia.assign(36, 0.0);
  before_.insert(before_.end(), object.twist, object.twist + 6);
  if (object.fixed()) {
    for (int i = 0; i < 6; ++i) body.inertia[7 * i] = 1.0;
    return;
  }
  const Matrix axes = matrix(object.axes);
  const Vector c = axes * vector(object.offset);
  const double mass = *object.mass;
  const Matrix lever{0.0, -c[2], c[1], c[2], 0.0, -c[0], -c[1], c[0], 0.0};
  for (int i = 0; i < 3; ++i) {
    body.inertia[6 * i + i] = mass;
    for (int j = 0; j < 3; ++j) {
      body.inertia[6 * i + 3 + j] = -mass * lever[3 * i + j];
      body.inertia[6 * (3 + i) + j] = mass * lever[3 * i + j];
      double moment = mass * ((i == j ? dot(c, c) : 0.0) - c[i] * c[j]);
      for (int k = 0; k < 3; ++k) moment += axes[3 * i + k] * object.moments[k] * axes[3 * j + k];
      body.inertia[6 * (3 + i) + 3 + j] = moment;
    }
  }
}

bool Impact::assemble(const Arms& arms, const Objects& objects) {
  const int count = static_cast<int>(arms.size());
  blocks_.resize(count + objects.size());
  before_.clear();
  before_twists_.resize(6 * count);
  for (int a = 0; a < count; ++a) {
    const ArmState& arm = arms[a];
    const int n = arm.joints;
    Block& block = blocks_[a];
    twist_of(arm.jacobian, arm.velocity, n, before_twists_.data() + 6 * a);
    if (arm.carrier != a) {  // its velocities stand in the block of its carrier
      block.start = blocks_[arm.carrier].start;
      block.size = 0;
      continue;
    }
    block.start = static_cast<int>(before_.size());
    block.size = n;
    block.inertia.resize(n * n);
    for (int i = 0; i < n; ++i)
      for (int j = 0; j < n; ++j)
        block.inertia[i * n + j] = arm.inertia[std::min(i, j) * n + std::max(i, j)] + (i == j ? arm.motor[i] : 0.0);
    before_.insert(before_.end(), arm.velocity, arm.velocity + n);
  }
  for (std::size_t k = 0; k < objects.size(); ++k) add_object(objects[k], blocks_[count + k]);
  for (Block& block : blocks_) {
    block.factor = block.inertia;
    if (!factorise(block.factor.data(), block.size)) return false;
  }

  turning_.clear();
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].law.drilling_arm > 0.0 || points[i].law.rolling_arm > 0.0) turning_.push_back(static_cast<int>(i));
  const ObjectState& object = objects.front();
  const bool fixed = object.fixed();
  length_ = fixed ? norm(vector(object.half))
                  : std::sqrt((object.moments[0] + object.moments[1] + object.moments[2]) / (3.0 * *object.mass));
  const int m = static_cast<int>(points.size() + turning_.size()), size = 3 * m;
  terms_.resize(m);
  // Y = L^-1 J_c^T of the object and of its partner at every contact, three columns each; G = Y^T Y.
  int widest = 6;
  for (const Block& block : blocks_) widest = std::max(widest, block.size);
  object_columns_.resize(18 * m);
  arm_columns_.assign(3 * widest * m, 0.0);
  work_.resize(3 * widest);
  for (int i = 0; i < m; ++i) {
    const Point& point = point_of(i);
    const auto columns = [&](const Side& side, const Vector& at, double sign, double* found) {
      if (turns(i)) {
        turning_rows(side.jacobian, side.size, sign * length_, work_.data());
      } else {
        point_rows(side.jacobian, side.size, at, sign, work_.data());
      }
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < side.size; ++j) found[3 * j + k] = work_[k * side.size + j];
      forward(blocks_[side.block].factor.data(), side.size, found, 3);
    };
    const Side own = object_side(objects, point.body), other = partner_side(arms, objects, point.partner);
    double* of_object = object_columns_.data() + 18 * i;
    double* of_partner = arm_columns_.data() + 3 * widest * i;
    std::fill_n(of_object, 18, 0.0);
    if (own.size > 0) columns(own, point.position - own.origin, 1.0, of_object);
    if (other.size > 0) columns(other, point.position - point.gap * point.normal - other.origin, -1.0, of_partner);
    for (int j = 0; j <= i; ++j) {
      const Point& before = point_of(j);
      double sums[9] = {};
      const auto add = [&sums](const double* left, const double* right, int rows) {
        for (int r = 0; r < rows; ++r)
          for (int k = 0; k < 3; ++k)
            for (int c2 = 0; c2 < 3; ++c2) sums[3 * k + c2] += left[3 * r + k] * right[3 * r + c2];
      };
      const double* object_before = object_columns_.data() + 18 * j;
      const double* partner_before = arm_columns_.data() + 3 * widest * j;
      if (point.body == before.body) add(of_object, object_before, 6);
      if (other.block == block_of(arms, before.partner)) add(of_partner, partner_before, other.size);
      if (point.partner == count + 1 + before.body) add(of_partner, object_before, other.size);
      if (before.partner == count + 1 + point.body) add(of_object, partner_before, own.size);
      for (int k = 0; k < 3; ++k)
        for (int c2 = 0; c2 < 3; ++c2)
          terms_.delassus[(3 * i + k) * size + 3 * j + c2] = terms_.delassus[(3 * j + c2) * size + 3 * i + k] =
              sums[3 * k + c2];
    }
  }
  build_root(arms);
  terms_.compute_inverse_mass();
  terms_.mobility = fixed ? mean(terms_.inverse_mass) : 1.0 / *object.mass;
  relative_velocities(arms, objects, before_twists_.data(), before_.data() + blocks_[count].start,
                      terms_.approach.data());
  for (int i = 0; i < m; ++i) {
    const Point& point = point_of(i);
    const ContactLaw& law = point.law;
    std::copy(point.normal.begin(), point.normal.end(), terms_.normals.begin() + 3 * i);
    terms_.host[i] = turns(i) ? turning_[i - points.size()] : -1;
    terms_.friction[i] = turns(i) ? law.rolling_arm / length_ : law.friction;
    terms_.spin[i] = turns(i) ? law.drilling_arm / length_ : 0.0;
    const Vector approach = vector(terms_.approach.data() + 3 * i);
    const double normal_velocity = dot(point.normal, approach);
    const Vector along = normal_velocity * point.normal;
    // Restitution along the normal acts at closing points only; with e J_n u^- > 0 it could close after the impact.
    const Vector closing = std::min(normal_velocity, 0.0) * point.normal;
    const Vector rebound = turns(i) ? law.spin_restitution * along
                                 : law.restitution * closing + law.tangential_restitution * (approach - along);
    std::copy(rebound.begin(), rebound.end(), terms_.rebound.begin() + 3 * i);
  }
  return true;
}

// Y, from the columns of the object and of its partner at every point.
void Impact::build_root(const Arms& arms) {
  const int m = terms_.count, size = 3 * m, stride = m == 0 ? 0 : static_cast<int>(arm_columns_.size()) / m;
  const int velocities = static_cast<int>(before_.size());
  terms_.rank = size > ROOT_RATIO * velocities && turning_.empty() ? velocities : 0;
  if (terms_.rank == 0) return;
  terms_.root.assign(terms_.rank * size, 0.0);
  const auto put = [this, size](const double* columns, const Block& block, int point) {
    for (int r = 0; r < block.size; ++r)
      for (int k = 0; k < 3; ++k) terms_.root[(block.start + r) * size + 3 * point + k] = columns[3 * r + k];
  };
  for (int i = 0; i < m; ++i) {
    put(object_columns_.data() + 18 * i, blocks_[arms.size() + points[i].body], i);
    const int block = block_of(arms, points[i].partner);
    if (block >= 0) put(arm_columns_.data() + stride * i, blocks_[block], i);
  }
}

void Impact::relative_velocities(const Arms& arms, const Objects& objects, const double* of_arms,
                                 const double* of_objects, double* found) const {
  const int count = static_cast<int>(arms.size());
  const auto twist_of_partner = [=](int partner) {
    if (partner == count) return static_cast<const double*>(nullptr);
    return partner < count ? of_arms + 6 * partner : of_objects + 6 * (partner - count - 1);
  };
  for (const Point& point : points) {
    const double* own = of_objects + 6 * point.body;
    Vector moving = vector(own) + cross(vector(own + 3), point.position - vector(objects[point.body].position));
    if (const double* twist = twist_of_partner(point.partner)) {
      const Vector origin = partner_side(arms, objects, point.partner).origin;
      moving = moving - vector(twist) - cross(vector(twist + 3), point.position - point.gap * point.normal - origin);
    }
    std::copy(moving.begin(), moving.end(), found);
    found += 3;
  }
  for (const int number : turning_) {
    Vector moving = vector(of_objects + 6 * points[number].body + 3);
    if (const double* twist = twist_of_partner(points[number].partner)) moving = moving - vector(twist + 3);
    moving = length_ * moving;
    std::copy(moving.begin(), moving.end(), found);
    found += 3;
  }
}

void Impact::impulses_to_momenta(const Arms& arms, const Objects& objects, std::vector<double>& momenta) {
  momenta.assign(before_.size(), 0.0);
  for (int i = 0; i < terms_.count; ++i) {
    const Point& point = point_of(i);
    const Vector given = vector(impulses_.data() + 3 * i);
    const Vector impulse = turns(i) ? Vector{} : given, couple = turns(i) ? length_ * given : Vector{};
    const Side own = object_side(objects, point.body), other = partner_side(arms, objects, point.partner);
    double* body = momenta.data() + blocks_[own.block].start;
    const Vector moment = cross(point.position - own.origin, impulse) + couple;
    for (int k = 0; k < 3 && own.size > 0; ++k) {
      body[k] += impulse[k];
      body[3 + k] += moment[k];
    }
    if (other.size == 0) continue;
    const Vector at = point.position - point.gap * point.normal - other.origin;
    const Vector turning = cross(at, impulse) + couple;
    double* joints = momenta.data() + blocks_[other.block].start;
    const int n = other.size;
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < n; ++j)
        joints[j] -= other.jacobian[k * n + j] * impulse[k] + other.jacobian[(3 + k) * n + j] * turning[k];
  }
}

// From the impulses: velocities, residuals and energy.
void Impact::finish(const Arms& arms, const Objects& objects) {
  const int count = static_cast<int>(arms.size());
  impulses_to_momenta(arms, objects, momenta_);
  velocity = before_;
  momentum = energy = gain = 0.0;
  for (const Block& block : blocks_) {
    const int n = block.size;
    double* after = velocity.data() + block.start;
    const double* start = before_.data() + block.start;
    const double* given = momenta_.data() + block.start;
    const auto solve = [&block, n](double* x) {
      forward(block.factor.data(), n, x, 1);
      backward(block.factor.data(), n, x, 1);
    };
    work_.assign(given, given + n);
    solve(work_.data());
    for (int i = 0; i < n; ++i) {
      after[i] += work_[i];
      gain += 0.5 * given[i] * (after[i] + start[i]);
    }
    for (int i = 0; i < n; ++i) {
      work_[i] = -given[i];
      for (int j = 0; j < n; ++j) {
        work_[i] += block.inertia[i * n + j] * (after[j] - start[j]);
        energy += 0.5 * start[i] * block.inertia[i * n + j] * start[j];
      }
    }
    solve(work_.data());
    for (int i = 0; i < n; ++i) momentum = std::max(momentum, std::abs(work_[i]));
  }
  twists.resize(6 * count);
  for (int a = 0; a < count; ++a)
    twist_of(arms[a].jacobian, velocity.data() + blocks_[a].start, arms[a].joints, twists.data() + 6 * a);
  after_.resize(3 * terms_.count);
  relative_velocities(arms, objects, twists.data(), velocity.data() + blocks_[count].start, after_.data());
  laws = judge(terms_, impulses_.data(), after_.data());
}

Status Impact::solve(const Arms& arms, const Objects& objects, const ContactState& contact, const Point* begin,
                     const Point* end, bool resumed) {
  if (!is_valid(arms, objects)) return Status::invalid;
  origins_.clear();
  for (const ArmState& arm : arms) origins_.push_back(vector(arm.origin));
  if (begin != nullptr) {
    points.assign(begin, end);
  } else if (!find_points(arms, objects, contact)) {
    return Status::invalid;
  }
  if (!assemble(arms, objects)) return Status::invalid;
  solver_.steps = 0;
  bool solved = false;
  if (resumed) {
    impulses_.assign(3 * terms_.count, 0.0);
    for (std::size_t i = 0; i < points.size(); ++i)
      std::copy(points[i].impulse.begin(), points[i].impulse.end(), impulses_.begin() + 3 * i);
    solved = solver_.resume(terms_, impulses_, rules_.compliance);
  }
  if (!solved) solved = solver_.solve(terms_, impulses_, rules_.compliance);
  steps = solver_.steps;
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i].impulse = vector(impulses_.data() + 3 * i);
    points[i].state = solver_.state(static_cast<int>(i));
  }
  finish(arms, objects);
  return solved ? Status::solved : Status::unsolved;
}

}  // namespace impact_rs
