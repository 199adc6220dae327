// SPDX-License-Identifier: Apache-2.0
#include "twin.hpp"

#include <limits>
#include <vector>

namespace impact_rs {

namespace {

constexpr double ALIGNED = 1e-9;               // m, as in impact_rs_sim/impact_map/contacts.py
constexpr double MARGIN = 2e-3;                // m; a contact may follow below this distance
constexpr double CONTACT_RANGE = 1e-4;         // m; a closer point may, with its speed, be in contact within a step
constexpr double WHOLE_FACE = 2e-2;            // m; corners that far apart belong to one face
constexpr double FACE_POINTS = 4.0;            // that share stiffness and damping of a face
constexpr double RIGID_FACTOR = 1e4;           // of the object's mass stops it within a step, and holds what sticks
constexpr double SUPPORT_THICKNESS = 0.1;      // m
constexpr double FIXED_MASS = 10.0;            // kg, of an arm at its pad; replaces the mass of a fixed object in tolerances
constexpr double SUPPORT_DAMPING_RATIO = 0.5;  // of the object on a compliant support
constexpr double RESOLVED_SPEED = 1e-2;        // m/s; a slower impact of a pad needs no shorter steps

constexpr double PI = 3.14159265358979323846;
constexpr double SLIDING_REGULARISATION = 2e-3;  // m/s; slower sliding has a smaller force, so that rest is an equilibrium

bool is_zero(const Vector& a) { return a[0] == 0.0 && a[1] == 0.0 && a[2] == 0.0; }

// Quaternion x y z w, in the hemisphere of `near` unless that is null.
void quaternion(const Matrix& m, double* out, const double* near) {
  const double squares[] = {1.0 + m[0] - m[4] - m[8], 1.0 - m[0] + m[4] - m[8], 1.0 - m[0] - m[4] + m[8],
                            1.0 + m[0] + m[4] + m[8]};  // 4 x^2, 4 y^2, 4 z^2, 4 w^2
  const auto most = std::max_element(squares, squares + 4) - squares;
  const double twice = std::sqrt(squares[most]), scale = 0.5 / twice;
  const double xy = m[3] + m[1], xz = m[2] + m[6], yz = m[7] + m[5];  // 4 x y, 4 x z, 4 y z
  const double xw = m[7] - m[5], yw = m[2] - m[6], zw = m[3] - m[1];
  const double products[4][4] = {
      {squares[0], xy, xz, xw}, {xy, squares[1], yz, yw}, {xz, yz, squares[2], zw}, {xw, yw, zw, squares[3]}};
  double sign = 0.0;
  for (int i = 0; i < 4; ++i) {
    out[i] = scale * products[most][i];
    if (near != nullptr) sign += out[i] * near[i];
  }
  if (sign < 0.0) {
    for (int i = 0; i < 4; ++i) out[i] = -out[i];
  }
}

// S^-1 x of a symmetric 3 x 3 matrix.
Vector divided(const Matrix& s, const Vector& x) {
  const Vector a = row(s, 0), b = row(s, 1), c = row(s, 2);
  const Vector bc = cross(b, c), ca = cross(c, a), ab = cross(a, b);
  return (1.0 / dot(a, bc)) * Vector{bc[0] * x[0] + ca[0] * x[1] + ab[0] * x[2], bc[1] * x[0] + ca[1] * x[1] + ab[1] * x[2],
                                     bc[2] * x[0] + ca[2] * x[1] + ab[2] * x[2]};
}

Vector tangential(const Vector& a, const Vector& normal) { return a + -dot(a, normal) * normal; }

}  // namespace

Twin::RigidBody::RigidBody(const BoxModel& box)
    : model(box),
      fixed(std::isinf(box.mass)),
      awake(false),
      mass(fixed ? FIXED_MASS : box.mass),
      rotation(IDENTITY),
      first_rotation(IDENTITY) {}

Twin::Twin(const TwinModel& model, const TwinStart& start)
    : model_(model),
      last_(model.period),
      pad_forces_(model.arms.size()),
      formulas_act_(!start.boxes.empty() && !model.formulas.empty()),
      memory_(fresh_memory(model.formulas)),
      symbols_(of_joints, 0.0),
      pad_shears_(model.arms.size()) {
  arms_.reserve(model.arms.size());
  for (std::size_t i = 0; i < model.arms.size(); ++i) arms_.emplace_back(model.arms[i], start.arms[i], model.period);
  const int arms = static_cast<int>(arms_.size()), boxes = static_cast<int>(start.boxes.size());
  for (int box = 0; box < std::max(boxes, 1); ++box) {
    for (int arm = 0; arm < arms; ++arm) pairs_.push_back({box, arm, -1});
    pairs_.push_back({box, -1, -1});
  }
  for (int box = 1; box < boxes; ++box)
    for (int other = 0; other < box; ++other) pairs_.push_back({box, -1, other});
  motions_.resize(pairs_.size());
  guesses_.resize(pairs_.size());
  resultants_.resize(pairs_.size());
  for (int box = 0; box < boxes; ++box) {
    bodies_.emplace_back(model.boxes[box]);
    set_state(bodies_.back(), start.boxes[box]);
  }
  update_symbols(0.0);
  for (std::size_t i = 0; i < arms_.size(); ++i) arms_[i].initialise_memory(start.arms[i].before);
}

void Twin::set_state(RigidBody& body, const BoxStart& start) {
  for (const ArmModel& arm : model_.arms)
    for (const FormulaLoad& load : arm.formulas)
      formulas_act_ = formulas_act_ || load.acts == Acts::on_pad || load.acts == Acts::along_pad;
  body.rotation = start.rotation;
  const Vector lever = body.rotation * body.model.offset;
  body.centre = start.centre + lever;
  if (body.fixed) return;  // without velocity
  body.angular = start.angular;
  body.velocity = start.velocity + cross(body.angular, lever);
  body.momentum = body.inertia() * body.angular;
  if (body.model.guide) {  // whose bearing stops the rest of the twist
    const Spatial along = body.guide_motion();
    const Vector spin = body.inertia() * along.angular;
    body.guided_inertia = dot(along.angular, spin) + body.mass * dot(along.linear, along.linear);
    body.speed = (dot(spin, body.angular) + body.mass * dot(along.linear, body.velocity)) / body.guided_inertia;
    body.first_centre = body.centre;
    body.first_rotation = body.rotation;
    body.integrate_guide(0.0);
  }
  body.awake = !(model_.support && is_zero(start.velocity) && is_zero(start.angular) && in_equilibrium(body));
}

// Whether a box without velocity is in equilibrium on its support: friction holds it, and it does not tip. Normal forces
// only push, so the line of gravity through the centre of mass has to lie within the support polygon.
bool Twin::in_equilibrium(const RigidBody& body) {
  const Vector& g = model_.gravity;
  if (!(std::hypot(g[0], g[1]) < -g[2] * model_.support->friction)) return false;
  const ConvexBody below = support_box(body);
  manifold_.clear();
  collide(below, body.geometry(), ALIGNED, MARGIN, MARGIN, manifold_);
  const Vector& centre = body.centre;
  const double fall = (centre[2] - below.centre[2] - below.half[2]) / -g[2];
  std::vector<double> directions;  // of the points, seen from there; around a point inside is no gap of pi
  for (const ManifoldPoint& candidate : manifold_)
    directions.push_back(
        std::atan2(candidate.position[1] - centre[1] - fall * g[1], candidate.position[0] - centre[0] - fall * g[0]));
  std::sort(directions.begin(), directions.end());
  for (std::size_t i = 0; i + 1 < directions.size(); ++i)
    if (directions[i + 1] - directions[i] >= PI) return false;
  return !directions.empty() && directions.back() - directions.front() > PI;
}

Matrix Twin::RigidBody::inertia() const {
  Matrix found;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      double sum = 0.0;
      for (int k = 0; k < 3; ++k) sum += rotation[3 * i + k] * model.inertia[k] * rotation[3 * j + k];
      found[3 * i + j] = sum;
    }
  return found;
}

Spatial Twin::RigidBody::guide_motion() const {
  const Spatial& guide = *model.guide;
  return {rotation * guide.angular, rotation * (guide.linear + cross(guide.angular, model.offset))};
}

// Along hinge or slide at its speed. The pose follows from the travel, so that it does not drift from its hinge.
void Twin::RigidBody::integrate_guide(double length) {
  travel += length * speed;
  const Vector& axis = model.guide->angular;
  const double square = dot(axis, axis);
  Vector shift = travel * model.guide->linear;
  if (square > 0.0) {  // about a point of the hinge, from the centre of mass
    const Vector point = (1.0 / square) * cross(axis, model.guide->linear) - model.offset;
    const Matrix turn = turned(travel * axis, IDENTITY);
    rotation = first_rotation * turn;
    shift = point - turn * point;
  }
  centre = first_centre + first_rotation * shift;
  const Spatial now = guide_motion();
  angular = speed * now.angular;
  velocity = speed * now.linear;
}

// Unloaded, a compliant support is higher by its deflection under the object's weight.
ConvexBody Twin::support_box(const RigidBody& body) const {
  const SupportModel& support = *model_.support;
  const double surface = support.height - model_.gravity[2] * body.model.mass * support.compliance;
  return {{0.0, 0.0, surface - 0.5 * SUPPORT_THICKNESS},
          IDENTITY,
          {support.half_x, support.half_y, 0.5 * SUPPORT_THICKNESS}};
}

bool Twin::any_awake() const {
  return std::any_of(bodies_.begin(), bodies_.end(), [](const RigidBody& one) { return one.awake; });
}

std::size_t Twin::state_size() const {
  std::size_t size = BOX_ROW * bodies_.size();
  for (const TwinArm& arm : arms_) size += 5 * arm.joints();
  return size;
}

void Twin::state(double* out, const double* before) const {
  const double* begin = out;
  for (const TwinArm& arm : arms_)
    for (const auto* values : {&arm.q, &arm.dq, &arm.elastic(), &arm.motor_position(), &arm.motor_velocity()})
      out = std::copy(values->begin(), values->end(), out);
  for (const RigidBody& body : bodies_) {
    const Vector lever = body.rotation * body.model.offset, middle = body.centre - lever;
    const Vector velocity = body.velocity - cross(body.angular, lever);
    out = std::copy(middle.begin(), middle.end(), out);
    quaternion(body.rotation, out, before != nullptr ? before + (out - begin) : nullptr);
    out += 4;
    out = std::copy(velocity.begin(), velocity.end(), out);
    out = std::copy(body.angular.begin(), body.angular.end(), out);
  }
}

bool Twin::is_finite() const {
  double sum = 0.0;
  for (const RigidBody& one : bodies_)
    sum += dot(one.centre, one.centre) + dot(one.velocity, one.velocity) + dot(one.angular, one.angular);
  for (const TwinArm& arm : arms_)
    for (int i = 0; i < arm.joints(); ++i) sum += arm.q[i] + arm.dq[i];
  return std::isfinite(sum);
}

void Twin::update_loads(double time) {
  update_symbols(time);
  for (TwinArm& arm : arms_) arm.update_loads();
}

// Symbols of time, object and contact, of the object's formulas and of those of every arm.
void Twin::update_symbols(double time) {
  symbols_[of_time] = time;
  if (!bodies_.empty()) {
    const RigidBody& object = bodies_.front();
    const Vector middle = object.geometry().centre;
    const Vector velocity = object.velocity + cross(object.angular, middle - object.centre);
    std::copy(middle.begin(), middle.end(), &symbols_[of_object_position]);
    std::copy(velocity.begin(), velocity.end(), &symbols_[of_object_velocity]);
    std::copy(object.angular.begin(), object.angular.end(), &symbols_[of_object_angular_velocity]);
    symbols_[of_object_speed] = norm(velocity);
    const ContactResultant& support = object_on_support();
    symbols_[of_support_force] = support.force;
    symbols_[of_support_slip] = support.slip;
  }
  symbols_[of_normal_force] = symbols_[of_since_contact] = 0.0;
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const ContactResultant& pad = resultants_[i];
    std::vector<double>& own = arms_[i].symbols;
    std::copy(symbols_.begin(), symbols_.end(), own.begin());
    own[of_normal_force] = pad.force;
    own[of_penetration] = pad.penetration;
    own[of_closing] = pad.closing;
    own[of_slip] = pad.slip;
    own[of_since_contact] = pad.onset < 0.0 ? 0.0 : time - pad.onset;
  }
  for (const TwinArm& arm : arms_) {  // of all pads together, and since the first contact
    symbols_[of_normal_force] += arm.symbols[of_normal_force];
    symbols_[of_since_contact] = std::max(symbols_[of_since_contact], arm.symbols[of_since_contact]);
  }
}

// Forces of formulas on the object, and their reactions on the pads, over the coming step.
void Twin::apply_formulas(double time) {
  force_ = moment_ = {};
  update_symbols(time);
  const Vector& centre = bodies_.front().centre;
  const auto at_surface = [&](const ContactResultant& resultant, double normal, double along) {
    const Vector force = normal * resultant.normal + -along * resultant.along;
    force_ = force_ + force;
    moment_ = moment_ + cross(resultant.position - centre, force);
    return force;
  };
  const ContactResultant& support = object_on_support();
  Vector at_middle{};
  for (std::size_t i = 0; i < model_.formulas.size(); ++i) {
    const FormulaLoad& load = model_.formulas[i];
    const bool lost = (load.acts == Acts::on_support || load.acts == Acts::along_support) && support.force <= 0.0;
    if (lost && load.formula.lags() == 0) continue;
    const double value = load.at(symbols_, memory_[i]);
    if (lost) continue;
    if (load.acts == Acts::on_object) {
      at_middle[load.index] += value;
    } else if (load.acts == Acts::turning_object) {
      moment_[load.index] += value;
    } else {
      at_surface(support, load.acts == Acts::on_support ? value : 0.0, load.acts == Acts::along_support ? value : 0.0);
    }
  }
  force_ = force_ + at_middle;
  moment_ = moment_ + cross(vector(&symbols_[of_object_position]) - centre, at_middle);
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const ContactResultant& pad = resultants_[i];
    const std::vector<FormulaLoad>& loads = arms_[i].formulas();
    bool updated = false;
    for (std::size_t k = 0; k < loads.size(); ++k) {
      const FormulaLoad& load = loads[k];
      if (load.acts != Acts::on_pad && load.acts != Acts::along_pad) continue;
      if (pad.force <= 0.0 && load.formula.lags() == 0) continue;
      if (!updated) arms_[i].update_symbols();
      updated = true;
      const double value = arms_[i].value(k);
      if (pad.force <= 0.0) continue;
      const bool along = load.acts == Acts::along_pad;
      arms_[i].apply_force(pad.position, -1.0 * at_surface(pad, along ? 0.0 : value, along ? value : 0.0));
    }
  }
}

void Twin::run(const TorqueTrajectory& trajectory, double* out) {
  const std::size_t ticks = trajectory.time.size(), size = state_size();
  state(out, nullptr);
  for (std::size_t tick = 0; tick + 1 < ticks; ++tick, out += size) {
    const double time = trajectory.time[tick];
    update_loads(time);
    for (int i = 0; i < trajectory.substeps; ++i) {
      for (std::size_t arm = 0; arm < arms_.size(); ++arm) {
        const auto& [torques, row_by_period] = trajectory.arms[arm];
        const int* row = row_by_period + periods_;
        if (row == row_by_period || row[0] != row[-1])
          arms_[arm].set_desired_torque(torques + row[0] * arms_[arm].joints(), periods_);
      }
      advance_period(time + i * model_.period);
    }
    if (!is_finite()) {  // what follows stays NaN
      report_.failed.push_back(time);
      return;
    }
    state(out + size, out);
  }
}

bool Twin::tick(double time, int substeps, const std::vector<const double*>& torques) {
  update_loads(time);
  for (std::size_t arm = 0; arm < arms_.size(); ++arm) arms_[arm].set_desired_torque(torques[arm], periods_);
  for (int i = 0; i < substeps; ++i) advance_period(time + i * model_.period);
  if (is_finite()) return true;
  report_.failed.push_back(time);
  return false;
}

void Twin::advance_period(double time) {
  for (TwinArm& arm : arms_) arm.command(periods_);
  ++periods_;
  const int steps = find_contacts() ? model_.refinement : 1;
  const double length = model_.period / steps;
  for (int i = 0; i < steps; ++i) {
    if (i > 0) find_contacts();
    step(length, time + i * length);
  }
}

bool Twin::find_contacts() {
  for (TwinArm& arm : arms_) arm.update_kinematics();
  partners_.clear();
  solver_.partners.clear();
  solver_.points.clear();
  if (bodies_.empty()) return false;
  const int count = static_cast<int>(pairs_.size());
  for (int number = 0; number < count; ++number)
    if (pairs_[number].arm >= 0) find_pad_contacts(number);
  bool fast = false;
  for (const ContactPoint& point : solver_.points)
    fast = fast || (std::abs(point.speed) > RESOLVED_SPEED &&
                    point.gap + 2.0 * model_.period * std::min(point.speed, 0.0) < 0.0);
  for (const int number : partners_) bodies_[pairs_[number].box].awake = true;
  // A box in contact wakes, and may wake others.
  std::vector<bool> visited(count, false);
  for (bool again = bodies_.size() > 1; again;) {
    again = false;
    for (int number = 0; number < count; ++number) {
      const Pair& pair = pairs_[number];
      if (pair.other < 0 || visited[number] || !(bodies_[pair.box].awake || bodies_[pair.other].awake)) continue;
      visited[number] = true;
      if (find_object_contacts(number)) again = bodies_[pair.box].awake = bodies_[pair.other].awake = true;
    }
  }
  for (int number = 0; number < count && model_.support; ++number)
    if (pairs_[number].arm < 0 && pairs_[number].other < 0 && bodies_[pairs_[number].box].awake)
      find_support_contacts(number);
  return fast;
}

void Twin::find_pad_contacts(int number) {
  TwinArm& arm = arms_[pairs_[number].arm];
  const RigidBody& body = bodies_[pairs_[number].box];
  const bool shears = pairs_[number].box == 0;  // a pad remembers its shear on the object
  const ConvexBody object = body.geometry(), pad = arm.pad_box();
  const double range = norm(pad.half) + norm(object.half) + MARGIN;
  const Vector apart = object.centre - pad.centre;
  if (shears) pad_shears_[pairs_[number].arm].compliant = false;
  if (!(dot(apart, apart) < range * range)) {
    if (shears) arm.shear = {};
    return;
  }
  manifold_.clear();
  const Vector normal = collide(pad, object, ALIGNED, MARGIN, WHOLE_FACE, manifold_);
  const std::size_t first = solver_.points.size();
  const double share = std::min(1.0, FACE_POINTS / static_cast<double>(manifold_.size())) / FACE_POINTS;
  std::vector<double>& motions = motions_[number];
  motions.clear();
  for (const ManifoldPoint& candidate : manifold_) {
    if (candidate.gap > MARGIN) continue;
    ContactPoint point{};
    point.position = candidate.position - body.centre;
    point.normal = normal;
    point.gap = candidate.gap;
    point.share = share;
    solver_.points.push_back(point);
  }
  const std::size_t count = solver_.points.size() - first;
  if (count == 0) {
    if (shears) arm.shear = {};
    return;
  }
  Vector linear = body.velocity, angular = body.angular;
  const auto add_motion = [&](const Spatial& axis, double rate) {
    const Vector at_centre = axis.linear + cross(axis.angular, body.centre);
    motions.insert(motions.end(), axis.angular.begin(), axis.angular.end());
    motions.insert(motions.end(), at_centre.begin(), at_centre.end());
    linear = linear - rate * at_centre;
    angular = angular - rate * axis.angular;
  };
  for (int i = 0; i < arm.joints(); ++i) add_motion(arm.axis(i), arm.dq[i]);
  for (int i = 0; i < arm.tool_freedoms(); ++i) add_motion(arm.tool_motion(i), arm.tool_rate[i]);
  bool in_range = false;
  for (std::size_t i = first; i < first + count; ++i) {
    ContactPoint& point = solver_.points[i];
    point.speed = dot(point.normal, linear + cross(angular, point.position));
    in_range = in_range || point.gap - 2.0 * model_.period * std::abs(point.speed) < CONTACT_RANGE;
  }
  if (!in_range) {
    solver_.points.resize(first);
    if (shears) arm.shear = {};
    return;
  }
  partners_.push_back(number);
  solver_.partners.push_back({arm.joints() + arm.tool_freedoms(), 0, motions.data(), first, count, 0});
}

// Whether a box is in contact with one before it.
bool Twin::find_object_contacts(int number) {
  const RigidBody &body = bodies_[pairs_[number].box], &other = bodies_[pairs_[number].other];
  const ConvexBody object = body.geometry(), before = other.geometry();
  const double range = norm(before.half) + norm(object.half) + MARGIN;
  const Vector apart = object.centre - before.centre, lever = body.centre - other.centre;
  if (!(dot(apart, apart) < range * range)) return false;
  manifold_.clear();
  const Vector normal = collide(before, object, ALIGNED, MARGIN, MARGIN, manifold_);
  const std::size_t first = solver_.points.size();
  const Vector angular = body.angular - other.angular;
  const Vector linear = body.velocity - other.velocity - cross(other.angular, lever);
  bool in_range = false;
  for (const ManifoldPoint& candidate : manifold_) {
    ContactPoint point{};
    point.position = candidate.position - body.centre;
    point.normal = normal;
    point.gap = candidate.gap;
    point.speed = dot(normal, linear + cross(angular, point.position));
    in_range = in_range || point.gap - 2.0 * model_.period * std::abs(point.speed) < CONTACT_RANGE;
    solver_.points.push_back(point);
  }
  if (!in_range) {
    solver_.points.resize(first);
    return false;
  }
  std::vector<double>& motions = motions_[number];
  motions.assign(36, 0.0);
  for (int i = 0; i < 3; ++i) {
    Vector axis{};
    axis[i] = 1.0;
    const Vector at_centre = cross(axis, lever);
    motions[7 * i] = motions[21 + 7 * i] = 1.0;
    std::copy(at_centre.begin(), at_centre.end(), motions.begin() + 6 * i + 3);
  }
  partners_.push_back(number);
  solver_.partners.push_back({6, 0, motions.data(), first, manifold_.size(), 0});
  return true;
}

void Twin::find_support_contacts(int number) {
  const RigidBody& body = bodies_[pairs_[number].box];
  const ConvexBody object = body.geometry(), below = support_box(body);
  if (object.centre[2] - norm(object.half) > below.centre[2] + below.half[2] + MARGIN) return;
  manifold_.clear();
  const Vector normal = collide(below, object, ALIGNED, MARGIN, MARGIN, manifold_);
  if (manifold_.empty()) return;
  const std::size_t first = solver_.points.size();
  const double share = std::min(1.0, FACE_POINTS / static_cast<double>(manifold_.size())) / FACE_POINTS;
  for (const ManifoldPoint& candidate : manifold_) {
    ContactPoint point{};
    point.position = candidate.position - body.centre;
    point.normal = normal;
    point.gap = candidate.gap;
    point.share = share;
    point.speed = dot(point.normal, body.velocity + cross(body.angular, point.position));
    solver_.points.push_back(point);
  }
  partners_.push_back(number);
  solver_.partners.push_back({0, 0, nullptr, first, manifold_.size(), 0});
}

// Laws of the points of one partner over the coming step.
void Twin::set_contact_laws(std::size_t number, double velocity_step) {
  const Partner& partner = solver_.partners[number];
  const Pair& pair = pairs_[partners_[number]];
  const bool is_pad = pair.arm >= 0;
  const RigidBody& body = bodies_[pair.box];
  const double mass = pair.other < 0 ? body.mass : std::min(body.mass, bodies_[pair.other].mass);
  const double hold = RIGID_FACTOR * mass / (FACE_POINTS * velocity_step);
  const Vector half = body.model.half;
  double stiffness = 0.0, damping = 0.0, friction = model_.pad_friction;
  bool rigid = true;
  if (is_pad) {
    const Pad& pad = arms_[pair.arm].pad();
    rigid = pad.rigid;
    stiffness = pad.stiffness;
    damping = pad.damping;
  } else if (pair.other >= 0) {
    friction = model_.box_friction;
  } else {
    const SupportModel& support = *model_.support;
    rigid = support.compliance == 0.0;
    friction = support.friction;
    if (!rigid) {
      stiffness = 1.0 / support.compliance;
      damping = 2.0 * SUPPORT_DAMPING_RATIO * std::sqrt(stiffness * mass);
    }
  }
  // Half of the damper acts after the step, for second order; more where it would reverse the velocity within a step.
  const double decay = 2.0 * velocity_step * damping / mass;
  const double implicit = decay > 2.0 ? 1.0 - 1.0 / decay : 0.5;
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    ContactPoint& point = solver_.points[i];
    point.rigid = rigid;
    point.stiffness = point.share * stiffness;
    point.damping = point.share * damping;
    point.implicit = implicit;
    point.rigid_damping = hold;
    point.stick_damping = hold;
    point.friction_offset = {};
    point.friction = friction;
    point.augmented = 1.0 / RIGID_FACTOR;
    point.rolling_arm = model_.rolling_arm;
    point.rolling_damping = hold * dot(half, half);
  }
  if (is_pad && pair.box == 0) set_shear_law(number);
}

// Friction of a pad with elastic shear: impact_rs_sim/plant/pad_shear.py, with spring and damper after the step.
void Twin::set_shear_law(std::size_t number) {
  const Partner& partner = solver_.partners[number];
  TwinArm& arm = arms_[partners_[number]];  // pairs of the object with arms have their numbers
  PadShear& own = pad_shears_[partners_[number]];
  const double compliance = arm.pad().shear_compliance, creep = arm.pad().creep;
  own.compliant = compliance > 0.0 || creep > 0.0;
  if (!own.compliant) return;
  own.weights.clear();
  double total = 0.0;
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    const ContactPoint& point = solver_.points[i];
    own.weights.push_back(normal_force(point, solver_.lengths, point.speed).force);
    total += own.weights.back();
  }
  if (!(total > 0.0)) arm.shear = {};
  own.centre = {};
  for (std::size_t i = 0; i < partner.count; ++i) {
    own.weights[i] = total > 0.0 ? own.weights[i] / total : 1.0 / static_cast<double>(partner.count);
    own.centre = own.centre + own.weights[i] * solver_.points[partner.first + i].position;
  }
  own.lag = std::sqrt(compliance);  // damping ratio 0.5 of a kilogram on the spring
  const double theta = own.lag + solver_.lengths.now, stiff = 1.0 / (compliance + theta * creep);
  const Vector& normal = solver_.points[partner.first].normal;
  const Vector lever = cross(normal, own.centre + bodies_.front().centre - arm.end());
  const Vector shift = tangential(arm.last_joint_axes() * arm.shear.shift + arm.shear.twist * lever, normal);
  for (std::size_t i = 0; i < partner.count; ++i) {
    ContactPoint& point = solver_.points[partner.first + i];
    point.stick_damping = own.weights[i] * stiff * theta;
    point.augmented = std::min(1.0, point.rigid_damping / (RIGID_FACTOR * std::max(point.stick_damping, 1e-300)));
    point.friction_offset =
        (own.weights[i] * stiff) * (shift + arm.shear.twist * cross(normal, point.position - own.centre));
  }
}

// Shear after the step, under the friction force.
void Twin::update_shear(std::size_t number) {
  const Partner& partner = solver_.partners[number];
  TwinArm& arm = arms_[partners_[number]];
  const PadShear& own = pad_shears_[partners_[number]];
  const Vector& normal = solver_.points[partner.first].normal;
  const double* wrench = solver_.wrench(number);  // about the object's centre of mass
  const Vector force = vector(wrench + 3), tangential_force = tangential(force, normal);
  double torque = dot(normal, vector(wrench) - cross(own.centre, force)), radius = 0.0;
  for (std::size_t i = 0; i < partner.count; ++i) {
    const Vector turning = cross(normal, solver_.points[partner.first + i].position - own.centre);
    radius += own.weights[i] * dot(turning, turning);
  }
  const double theta = own.lag + solver_.lengths.now, kept = own.lag / theta;
  const double relaxed = solver_.lengths.now * arm.pad().shear_compliance / theta;
  const Vector lever = cross(normal, own.centre + bodies_.front().centre - arm.end());
  const Vector shift = tangential(arm.last_joint_axes() * arm.shear.shift + arm.shear.twist * lever, normal);
  const double twist = kept * arm.shear.twist - (radius > 1e-12 ? relaxed * torque / radius : 0.0);
  arm.shear.twist = twist;
  arm.shear.shift = transposed_times(arm.last_joint_axes(), kept * shift - relaxed * tangential_force - twist * lever);
}

void Twin::step(double length, double time) {
  const double velocity_step = 0.5 * (last_ + length);
  ++report_.steps;
  std::fill(pad_forces_.begin(), pad_forces_.end(), Vector{});
  solver_.lengths = {last_, length};
  for (TwinArm& arm : arms_) arm.equations();
  if (formulas_act_) apply_formulas(time);
  if (any_awake()) {
    contact_step(velocity_step, time);
  } else {
    for (TwinArm& arm : arms_)
      if (!arm.free_step(velocity_step)) std::fill(arm.dq.begin(), arm.dq.end(), std::numeric_limits<double>::quiet_NaN());
  }
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const auto in_contact = [&](int number) { return pairs_[number].arm == static_cast<int>(i); };
    arms_[i].integrate(velocity_step, length, std::any_of(partners_.begin(), partners_.end(), in_contact));
  }
  for (RigidBody& body : bodies_) {
    if (!body.awake || body.fixed) continue;
    if (body.model.guide) {
      body.integrate_guide(length);
      continue;
    }
    body.centre = body.centre + length * body.velocity;
    body.rotation = turned(length * body.angular, body.rotation);
  }
  // Awake with its support from the next step on.
  if (formulas_act_ && !(is_zero(force_) && is_zero(moment_))) bodies_.front().awake = true;
  last_ = length;
}

// An arm in contact among the unknowns of the step.
void Twin::assemble_arm(const Partner& partner, const TwinArm& arm) {
  StepSolver& solver = solver_;
  const int joints = arm.joints(), at = partner.offset, n = solver.size;
  for (int i = 0; i < joints; ++i)
    for (int j = 0; j <= i; ++j)
      solver.mass[(at + i) * n + at + j] = solver.mass[(at + j) * n + at + i] = arm.mass[i * joints + j];
  for (int i = 0; i < joints; ++i) {
    double sum = solver.velocity_step * arm.net_torque[i];
    for (int j = 0; j < joints; ++j) sum += solver.mass[(at + i) * n + at + j] * arm.dq[j];
    solver.impulse[at + i] = sum;
    solver.velocity[at + i] = arm.dq[i];
  }
  for (int i = 0, own = at + joints; i < arm.tool_freedoms(); ++i, ++own) {
    solver.mass[own * n + own] = arm.tool_inertia(solver.velocity_step, solver.lengths.now);
    solver.impulse[own] = arm.tool_impulse(i, solver.velocity_step);
    solver.velocity[own] = arm.tool_rate[i];
  }
}

// A box likewise, under a force and a moment about its centre of mass.
void Twin::assemble_object(RigidBody& body, const Vector& force, const Vector& moment) {
  StepSolver& solver = solver_;
  const int o = body.offset, n = solver.size;
  const Matrix turns = body.fixed ? IDENTITY : body.inertia();
  if (!body.fixed) body.momentum = body.momentum + solver.velocity_step * moment;
  const Vector free =
      body.fixed ? Vector{} : body.velocity + solver.velocity_step * (model_.gravity + (1.0 / body.mass) * force);
  const Vector spin = divided(turns, body.momentum);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) solver.mass[(o + i) * n + o + j] = turns[3 * i + j];
    solver.mass[(o + 3 + i) * n + o + 3 + i] = body.mass;
    solver.impulse[o + i] = body.momentum[i];
    solver.impulse[o + 3 + i] = body.mass * free[i];
    solver.velocity[o + i] = partners_.empty() ? spin[i] : body.angular[i];
    solver.velocity[o + 3 + i] = partners_.empty() ? free[i] : body.velocity[i];
  }
}

// A box on a hinge or slide without friction: s^T M s dz/dt = s^T (moment, force), since the forces of the bearing do no
// work (Featherstone, Rigid Body Dynamics Algorithms, ch. 3). s^T M s is constant, for the axis rests.
void Twin::assemble_guided(const RigidBody& body, const Vector& force, const Vector& moment) {
  StepSolver& solver = solver_;
  const int o = body.offset;
  const Spatial along = body.guide_motion();
  const double driving = dot(along.angular, moment) + dot(along.linear, force + body.mass * model_.gravity);
  const double impulse = body.guided_inertia * body.speed + solver.velocity_step * driving;
  for (int i = 0; i < 3; ++i) {
    solver.along[i] = along.angular[i];
    solver.along[3 + i] = along.linear[i];
  }
  solver.mass[o * solver.size + o] = body.guided_inertia;
  solver.impulse[o] = impulse;
  solver.velocity[o] = partners_.empty() ? impulse / body.guided_inertia : body.speed;
}

void Twin::contact_step(double velocity_step, double time) {
  StepSolver& solver = solver_;
  std::vector<int> offsets(arms_.size(), -1);
  int size = 0;
  for (const int number : partners_) {
    const int arm = pairs_[number].arm;
    if (arm < 0 || offsets[arm] >= 0) continue;
    offsets[arm] = size;
    size += arms_[arm].joints() + arms_[arm].tool_freedoms();
  }
  for (std::size_t i = 0; i < arms_.size(); ++i)
    if (offsets[i] < 0 && !arms_[i].free_step(velocity_step))
      std::fill(arms_[i].dq.begin(), arms_[i].dq.end(), std::numeric_limits<double>::quiet_NaN());
  solver.objects.clear();
  for (RigidBody& body : bodies_) {
    if (!body.awake) continue;
    body.offset = size;
    solver.objects.push_back(size);
    size += body.model.guide ? 1 : 6;
  }
  const int n = size;
  solver.size = n;
  solver.velocity_step = velocity_step;
  solver.object_mass = bodies_.front().mass;
  solver.fixed = bodies_.front().fixed;
  solver.guided = bodies_.front().model.guide.has_value();
  solver.mass.assign(n * n, 0.0);
  solver.impulse.resize(n);
  solver.velocity.resize(n);
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    Partner& partner = solver.partners[k];
    const Pair& pair = pairs_[partners_[k]];
    partner.object = bodies_[pair.box].offset;
    if (pair.arm >= 0) partner.offset = offsets[pair.arm];
    if (pair.other >= 0) partner.offset = bodies_[pair.other].offset;
    set_contact_laws(k, velocity_step);
    if (pair.arm >= 0) assemble_arm(partner, arms_[pair.arm]);
  }
  for (RigidBody& body : bodies_) {
    if (!body.awake) continue;
    const bool is_object = &body == &bodies_.front();
    if (body.model.guide) {
      assemble_guided(body, force_, moment_);
    } else {
      assemble_object(body, is_object ? force_ : Vector{}, is_object ? moment_ : Vector{});
    }
  }
  if (!partners_.empty()) {
    ++report_.contact_steps;
    warm_start();
    const std::vector<double> before = solver.velocity;
    if (partners_ == partners_before_ && change_.size() == before.size()) {
      for (int i = 0; i < n; ++i) solver.velocity[i] += velocity_step / velocity_step_before_ * change_[i];
    }
    const Solution solution = solver.solve();
    change_.resize(n);
    for (int i = 0; i < n; ++i) change_[i] = solver.velocity[i] - before[i];
    velocity_step_before_ = velocity_step;
    report_.iterations += solution.iterations;
    report_.fallbacks += solution.fallback;
    report_.residual = std::max(report_.residual, solution.residual);
    if (!solution.solved) report_.failed.push_back(time);
  }
  partners_before_ = partners_;
  for (ContactResultant& resultant : resultants_)
    resultant.force = resultant.penetration = resultant.closing = resultant.slip = 0.0;
  for (auto& guesses : guesses_) guesses.clear();
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    const Partner& partner = solver.partners[k];
    const Pair& pair = pairs_[partners_[k]];
    std::vector<Guess>& guesses = guesses_[partners_[k]];
    for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
      guesses.push_back(solver.guesses[i]);
      guesses.back().normal_force = solver.normal_forces()[i];
    }
    const double* wrench = solver.wrench(k);
    RigidBody& body = bodies_[pair.box];
    for (int i = 0; i < 3 && !body.fixed; ++i) body.momentum[i] += velocity_step * wrench[i];
    if (pair.other >= 0) {
      Vector& momentum = bodies_[pair.other].momentum;
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 6; ++i) momentum[j] -= velocity_step * partner.motions[6 * j + i] * wrench[i];
    }
    if (pair.arm < 0) continue;
    TwinArm& arm = arms_[pair.arm];
    pad_forces_[pair.arm] = pad_forces_[pair.arm] + -1.0 * vector(wrench + 3);
    const auto rates = solver.velocity.begin() + partner.offset;
    std::copy_n(rates, arm.joints(), arm.dq.begin());
    std::copy_n(rates + arm.joints(), arm.tool_freedoms(), arm.tool_rate.begin());
    if (pair.box == 0 && pad_shears_[pair.arm].compliant) update_shear(k);
  }
  for (RigidBody& body : bodies_) {
    if (!body.awake || body.fixed) continue;
    if (body.model.guide) {
      body.speed = solver.velocity[body.offset];
      body.angular = body.speed * vector(solver.along.data());
      body.velocity = body.speed * vector(solver.along.data() + 3);
      continue;
    }
    body.angular = vector(&solver.velocity[body.offset]);
    body.velocity = vector(&solver.velocity[body.offset + 3]);
  }
  for (std::size_t k = 0; k < partners_.size(); ++k) record_resultant(k, time);
}

// Resultant contact force of a partner in this step.
void Twin::record_resultant(std::size_t number, double time) {
  const Partner& partner = solver_.partners[number];
  ContactResultant& own = resultants_[partners_[number]];
  double total = 0.0, deep = 0.0;
  Vector position{};
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    const double load = solver_.normal_forces()[i];
    total += load;
    deep -= load * solver_.points[i].gap;
    position = position + load * solver_.points[i].position;
  }
  if (!(total > 0.0)) return;
  position = (1.0 / total) * position;
  const RigidBody& body = bodies_[pairs_[partners_[number]].box];
  Vector angular = body.angular, linear = body.velocity;
  for (int j = 0; j < partner.joints; ++j) {
    const double rate = solver_.velocity[partner.offset + j];
    angular = angular - rate * vector(partner.motions + 6 * j);
    linear = linear - rate * vector(partner.motions + 6 * j + 3);
  }
  own.normal = solver_.points[partner.first].normal;
  const Vector velocity = linear + cross(angular, position), sliding = tangential(velocity, own.normal);
  own.force = total;
  own.penetration = deep / total;
  own.closing = -dot(velocity, own.normal);
  own.slip = norm(sliding);
  own.along = (1.0 / std::hypot(own.slip, SLIDING_REGULARISATION)) * sliding;
  own.position = position + body.centre;
  if (own.onset < 0.0) own.onset = time;
}

// Forces of the step before as a first guess, where a partner has as many points as then.
void Twin::warm_start() {
  solver_.guesses.assign(solver_.points.size(), Guess{{}, -1.0, true, true});
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    const Partner& partner = solver_.partners[k];
    const std::vector<Guess>& before = guesses_[partners_[k]];
    if (before.size() == partner.count) std::copy(before.begin(), before.end(), solver_.guesses.begin() + partner.first);
  }
}

}  // namespace impact_rs
