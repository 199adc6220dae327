// SPDX-License-Identifier: Apache-2.0
#include "twin.hpp"

#include <limits>
#include <vector>

namespace impact_rs {

namespace {

constexpr double ALIGNED = 1e-9;         // m, as in impact_rs_sim/impact_map/contacts.py
constexpr double MARGIN = 2e-3;          // m; what is closer may touch soon
constexpr double IN_REACH = 1e-4;        // m; what is closer, but for its speed, may touch within a step or did so in the last one
constexpr double WHOLE_FACE = 2e-2;      // m; corners that far apart belong to one face
constexpr double FACE_POINTS = 4.0;      // that share stiffness and damping of a face
constexpr double RIGID = 1e4;            // of the object's mass stops it within a step, and holds what sticks
constexpr double SUPPORT_THICKNESS = 0.1;      // m
constexpr double FIXED_MASS = 10.0;            // kg, of an arm at its pad; stands for the mass of a fixed object in tolerances
constexpr double SUPPORT_DAMPING_RATIO = 0.5;  // of the object on a compliant support
constexpr double RESOLVED = 1e-2;        // m/s; a pad that meets the object more slowly needs no shorter steps

constexpr double PI = 3.14159265358979323846;
constexpr double SLOW = 2e-3;            // m/s; sliding below it has less than its force, so that rest is a state

bool is_zero(const Vector& a) { return a[0] == 0.0 && a[1] == 0.0 && a[2] == 0.0; }

// Quaternion x y z w, with the sign that is nearer to another one unless that is null.
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

Twin::Solid::Solid(const BoxModel& box)
    : model(box),
      fixed(std::isinf(box.mass)),
      awake(false),
      mass(fixed ? FIXED_MASS : box.mass),
      rotation(IDENTITY) {}

Twin::Twin(const TwinModel& model, const TwinStart& start)
    : model_(model),
      last_(model.period),
      pad_forces_(model.arms.size()),
      pushes_(!start.boxes.empty() && !model.formulas.empty()),
      memory_(fresh_memory(model.formulas)),
      symbols_(of_joints, 0.0),
      softened_(model.arms.size()) {
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
  touching_.resize(pairs_.size());
  for (int box = 0; box < boxes; ++box) {
    solids_.emplace_back(model.boxes[box]);
    place(solids_.back(), start.boxes[box]);
  }
  look_around(0.0);
  for (std::size_t i = 0; i < arms_.size(); ++i) arms_[i].look_back(start.arms[i].before);
}

void Twin::place(Solid& solid, const BoxStart& start) {
  for (const ArmModel& arm : model_.arms)
    for (const FormulaLoad& load : arm.formulas)
      pushes_ = pushes_ || load.acts == Acts::on_pad || load.acts == Acts::along_pad;
  solid.rotation = start.rotation;
  const Vector lever = solid.rotation * solid.model.offset;
  solid.centre = start.centre + lever;
  if (solid.fixed) return;  // without velocity, and untouched so far
  solid.angular = start.angular;
  solid.velocity = start.velocity + cross(solid.angular, lever);
  solid.momentum = solid.inertia() * solid.angular;
  solid.awake = !(model_.support && is_zero(start.velocity) && is_zero(start.angular) && rests(solid));
}

// Whether a box without velocity stays where it is until it is touched: gravity pulls it neither along its support,
// against friction, nor over the edge of what it stands on. Normal forces only push, so that the line of gravity through
// the centre of mass has to meet the support within the polygon of its points.
bool Twin::rests(const Solid& solid) {
  const Vector& g = model_.gravity;
  if (!(std::hypot(g[0], g[1]) < -g[2] * model_.support->friction)) return false;
  const Body below = table(solid);
  touches_.clear();
  touch(below, solid.body(), ALIGNED, MARGIN, MARGIN, touches_);
  const Vector& centre = solid.centre;
  const double fall = (centre[2] - below.centre[2] - below.half[2]) / -g[2];
  std::vector<double> directions;  // of the points, seen from there; around a point inside is no gap of pi
  for (const Touch& touch : touches_)
    directions.push_back(std::atan2(touch.position[1] - centre[1] - fall * g[1], touch.position[0] - centre[0] - fall * g[0]));
  std::sort(directions.begin(), directions.end());
  for (std::size_t i = 0; i + 1 < directions.size(); ++i)
    if (directions[i + 1] - directions[i] >= PI) return false;
  return !directions.empty() && directions.back() - directions.front() > PI;
}

Matrix Twin::Solid::inertia() const {
  Matrix found;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      double sum = 0.0;
      for (int k = 0; k < 3; ++k) sum += rotation[3 * i + k] * model.inertia[k] * rotation[3 * j + k];
      found[3 * i + j] = sum;
    }
  return found;
}

// Unloaded, a compliant support is higher by what an object's weight presses it down.
Body Twin::table(const Solid& solid) const {
  const SupportModel& support = *model_.support;
  const double surface = support.height - model_.gravity[2] * solid.model.mass * support.compliance;
  return {{0.0, 0.0, surface - 0.5 * SUPPORT_THICKNESS},
          IDENTITY,
          {support.half_x, support.half_y, 0.5 * SUPPORT_THICKNESS}};
}

bool Twin::any_awake() const {
  return std::any_of(solids_.begin(), solids_.end(), [](const Solid& one) { return one.awake; });
}

std::size_t Twin::row() const {
  std::size_t size = BOX_ROW * solids_.size();
  for (const TwinArm& arm : arms_) size += 5 * arm.joints();
  return size;
}

void Twin::state(double* out, const double* before) const {
  const double* begin = out;
  for (const TwinArm& arm : arms_)
    for (const auto* values : {&arm.q, &arm.dq, &arm.elastic(), &arm.motor_position(), &arm.motor_velocity()})
      out = std::copy(values->begin(), values->end(), out);
  for (const Solid& solid : solids_) {
    const Vector lever = solid.rotation * solid.model.offset, middle = solid.centre - lever;
    const Vector velocity = solid.velocity - cross(solid.angular, lever);
    out = std::copy(middle.begin(), middle.end(), out);
    quaternion(solid.rotation, out, before != nullptr ? before + (out - begin) : nullptr);
    out += 4;
    out = std::copy(velocity.begin(), velocity.end(), out);
    out = std::copy(solid.angular.begin(), solid.angular.end(), out);
  }
}

bool Twin::is_finite() const {
  double sum = 0.0;
  for (const Solid& one : solids_)
    sum += dot(one.centre, one.centre) + dot(one.velocity, one.velocity) + dot(one.angular, one.angular);
  for (const TwinArm& arm : arms_)
    for (int i = 0; i < arm.joints(); ++i) sum += arm.q[i] + arm.dq[i];
  return std::isfinite(sum);
}

void Twin::load(double time) {
  look_around(time);
  for (TwinArm& arm : arms_) arm.load();
}

// Symbols of time, object and contact, of the object's formulas and of those of every arm.
void Twin::look_around(double time) {
  symbols_[of_time] = time;
  if (!solids_.empty()) {
    const Solid& object = solids_.front();
    const Vector middle = object.body().centre;
    const Vector velocity = object.velocity + cross(object.angular, middle - object.centre);
    std::copy(middle.begin(), middle.end(), &symbols_[of_object_place]);
    std::copy(velocity.begin(), velocity.end(), &symbols_[of_object_velocity]);
    std::copy(object.angular.begin(), object.angular.end(), &symbols_[of_object_turning]);
    symbols_[of_object_speed] = norm(velocity);
    const Touching& support = touching_[arms_.size()];
    symbols_[of_support_force] = support.force;
    symbols_[of_support_slip] = support.slip;
  }
  symbols_[of_normal_force] = symbols_[of_since_contact] = 0.0;
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const Touching& pad = touching_[i];
    std::vector<double>& own = arms_[i].symbols;
    std::copy(symbols_.begin(), symbols_.end(), own.begin());
    own[of_normal_force] = pad.force;
    own[of_penetration] = pad.penetration;
    own[of_closing] = pad.closing;
    own[of_slip] = pad.slip;
    own[of_since_contact] = pad.begin < 0.0 ? 0.0 : time - pad.begin;
  }
  for (const TwinArm& arm : arms_) {  // of all pads together, and since the first touch
    symbols_[of_normal_force] += arm.symbols[of_normal_force];
    symbols_[of_since_contact] = std::max(symbols_[of_since_contact], arm.symbols[of_since_contact]);
  }
}

// Forces of formulas on the object, and their reactions on the pads, over the coming step.
void Twin::push(double time) {
  force_ = moment_ = {};
  look_around(time);
  const Vector& centre = solids_.front().centre;
  const auto at_surface = [&](const Touching& touching, double normal, double along) {
    const Vector force = normal * touching.normal + -along * touching.along;
    force_ = force_ + force;
    moment_ = moment_ + cross(touching.place - centre, force);
    return force;
  };
  const Touching& support = touching_.back();
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
  moment_ = moment_ + cross(vector(&symbols_[of_object_place]) - centre, at_middle);
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const Touching& pad = touching_[i];
    const std::vector<FormulaLoad>& loads = arms_[i].formulas();
    bool looked = false;
    for (std::size_t k = 0; k < loads.size(); ++k) {
      const FormulaLoad& load = loads[k];
      if (load.acts != Acts::on_pad && load.acts != Acts::along_pad) continue;
      if (pad.force <= 0.0 && load.formula.lags() == 0) continue;
      if (!looked) arms_[i].look_around();
      looked = true;
      const double value = arms_[i].value(k);
      if (pad.force <= 0.0) continue;
      const bool along = load.acts == Acts::along_pad;
      arms_[i].push(pad.place, -1.0 * at_surface(pad, along ? 0.0 : value, along ? value : 0.0));
    }
  }
}

void Twin::run(const Course& course, double* out) {
  const std::size_t ticks = course.time.size(), size = row();
  state(out, nullptr);
  for (std::size_t tick = 0; tick + 1 < ticks; ++tick, out += size) {
    const double time = course.time[tick];
    load(time);
    for (int i = 0; i < course.substeps; ++i) {
      for (std::size_t arm = 0; arm < arms_.size(); ++arm) {
        const auto& [torques, acting] = course.arms[arm];
        const int* row = acting + periods_;
        if (row == acting || row[0] != row[-1]) arms_[arm].desire(torques + row[0] * arms_[arm].joints(), periods_);
      }
      period(time + i * model_.period);
    }
    if (!is_finite()) {  // what follows stays NaN
      report_.failed.push_back(time);
      return;
    }
    state(out + size, out);
  }
}

bool Twin::tick(double time, int substeps, const std::vector<const double*>& torques) {
  load(time);
  for (std::size_t arm = 0; arm < arms_.size(); ++arm) arms_[arm].desire(torques[arm], periods_);
  for (int i = 0; i < substeps; ++i) period(time + i * model_.period);
  if (is_finite()) return true;
  report_.failed.push_back(time);
  return false;
}

void Twin::period(double time) {
  for (TwinArm& arm : arms_) arm.command(periods_);
  ++periods_;
  const int steps = look() ? model_.refinement : 1;
  const double length = model_.period / steps;
  for (int i = 0; i < steps; ++i) {
    if (i > 0) look();
    step(length, time + i * length);
  }
}

bool Twin::look() {
  for (TwinArm& arm : arms_) arm.look();
  partners_.clear();
  solver_.partners.clear();
  solver_.points.clear();
  if (solids_.empty()) return false;
  const int count = static_cast<int>(pairs_.size());
  for (int number = 0; number < count; ++number)
    if (pairs_[number].arm >= 0) look_at_pad(number);
  bool fast = false;
  for (const ContactPoint& point : solver_.points)
    fast = fast || (std::abs(point.speed) > RESOLVED && point.gap + 2.0 * model_.period * std::min(point.speed, 0.0) < 0.0);
  for (const int number : partners_) solids_[pairs_[number].box].awake = true;
  // A box that is touched wakes, and may wake others.
  std::vector<bool> looked(count, false);
  for (bool again = solids_.size() > 1; again;) {
    again = false;
    for (int number = 0; number < count; ++number) {
      const Pair& pair = pairs_[number];
      if (pair.other < 0 || looked[number] || !(solids_[pair.box].awake || solids_[pair.other].awake)) continue;
      looked[number] = true;
      if (look_at_boxes(number)) again = solids_[pair.box].awake = solids_[pair.other].awake = true;
    }
  }
  for (int number = 0; number < count && model_.support; ++number)
    if (pairs_[number].arm < 0 && pairs_[number].other < 0 && solids_[pairs_[number].box].awake) look_at_support(number);
  return fast;
}

void Twin::look_at_pad(int number) {
  TwinArm& arm = arms_[pairs_[number].arm];
  const Solid& solid = solids_[pairs_[number].box];
  const bool shears = pairs_[number].box == 0;  // a pad remembers its shear on the object
  const Body object = solid.body(), pad = arm.pad_box();
  const double reach = norm(pad.half) + norm(object.half) + MARGIN;
  const Vector apart = object.centre - pad.centre;
  if (shears) softened_[pairs_[number].arm].yields = false;
  if (!(dot(apart, apart) < reach * reach)) {
    if (shears) arm.shear = {};
    return;
  }
  touches_.clear();
  const Vector normal = touch(pad, object, ALIGNED, MARGIN, WHOLE_FACE, touches_);
  const std::size_t first = solver_.points.size();
  const double share = std::min(1.0, FACE_POINTS / static_cast<double>(touches_.size())) / FACE_POINTS;
  std::vector<double>& motions = motions_[number];
  motions.clear();
  for (const Touch& touch : touches_) {
    if (touch.gap > MARGIN) continue;
    ContactPoint point{};
    point.place = touch.position - solid.centre;
    point.normal = normal;
    point.gap = touch.gap;
    point.share = share;
    solver_.points.push_back(point);
  }
  const std::size_t count = solver_.points.size() - first;
  if (count == 0) {
    if (shears) arm.shear = {};
    return;
  }
  Vector linear = solid.velocity, angular = solid.angular;
  const auto moves = [&](const Spatial& axis, double rate) {
    const Vector slides = axis.linear + cross(axis.angular, solid.centre);
    motions.insert(motions.end(), axis.angular.begin(), axis.angular.end());
    motions.insert(motions.end(), slides.begin(), slides.end());
    linear = linear - rate * slides;
    angular = angular - rate * axis.angular;
  };
  for (int i = 0; i < arm.joints(); ++i) moves(arm.axis(i), arm.dq[i]);
  for (int i = 0; i < arm.yields(); ++i) moves(arm.yielding(i), arm.tool_rate[i]);
  bool in_reach = false;
  for (std::size_t i = first; i < first + count; ++i) {
    ContactPoint& point = solver_.points[i];
    point.speed = dot(point.normal, linear + cross(angular, point.place));
    in_reach = in_reach || point.gap - 2.0 * model_.period * std::abs(point.speed) < IN_REACH;
  }
  if (!in_reach) {
    solver_.points.resize(first);
    if (shears) arm.shear = {};
    return;
  }
  partners_.push_back(number);
  solver_.partners.push_back({arm.joints() + arm.yields(), 0, motions.data(), first, count, 0});
}

// Whether a box touches one before it.
bool Twin::look_at_boxes(int number) {
  const Solid &solid = solids_[pairs_[number].box], &other = solids_[pairs_[number].other];
  const Body object = solid.body(), before = other.body();
  const double reach = norm(before.half) + norm(object.half) + MARGIN;
  const Vector apart = object.centre - before.centre, lever = solid.centre - other.centre;
  if (!(dot(apart, apart) < reach * reach)) return false;
  touches_.clear();
  const Vector normal = touch(before, object, ALIGNED, MARGIN, MARGIN, touches_);
  const std::size_t first = solver_.points.size();
  const Vector angular = solid.angular - other.angular;
  const Vector linear = solid.velocity - other.velocity - cross(other.angular, lever);
  bool in_reach = false;
  for (const Touch& touch : touches_) {
    ContactPoint point{};
    point.place = touch.position - solid.centre;
    point.normal = normal;
    point.gap = touch.gap;
    point.speed = dot(normal, linear + cross(angular, point.place));
    in_reach = in_reach || point.gap - 2.0 * model_.period * std::abs(point.speed) < IN_REACH;
    solver_.points.push_back(point);
  }
  if (!in_reach) {
    solver_.points.resize(first);
    return false;
  }
  std::vector<double>& motions = motions_[number];
  motions.assign(36, 0.0);
  for (int i = 0; i < 3; ++i) {
    Vector axis{};
    axis[i] = 1.0;
    const Vector slides = cross(axis, lever);
    motions[7 * i] = motions[21 + 7 * i] = 1.0;
    std::copy(slides.begin(), slides.end(), motions.begin() + 6 * i + 3);
  }
  partners_.push_back(number);
  solver_.partners.push_back({6, 0, motions.data(), first, touches_.size(), 0});
  return true;
}

void Twin::look_at_support(int number) {
  const Solid& solid = solids_[pairs_[number].box];
  const Body object = solid.body(), below = table(solid);
  if (object.centre[2] - norm(object.half) > below.centre[2] + below.half[2] + MARGIN) return;
  touches_.clear();
  const Vector normal = touch(below, object, ALIGNED, MARGIN, MARGIN, touches_);
  if (touches_.empty()) return;
  const std::size_t first = solver_.points.size();
  const double share = std::min(1.0, FACE_POINTS / static_cast<double>(touches_.size())) / FACE_POINTS;
  for (const Touch& touch : touches_) {
    ContactPoint point{};
    point.place = touch.position - solid.centre;
    point.normal = normal;
    point.gap = touch.gap;
    point.share = share;
    point.speed = dot(point.normal, solid.velocity + cross(solid.angular, point.place));
    solver_.points.push_back(point);
  }
  partners_.push_back(number);
  solver_.partners.push_back({0, 0, nullptr, first, touches_.size(), 0});
}

// Laws of the points of one partner over the coming step.
void Twin::prepare(std::size_t number, double kick) {
  const Partner& partner = solver_.partners[number];
  const Pair& pair = pairs_[partners_[number]];
  const bool is_pad = pair.arm >= 0;
  const Solid& solid = solids_[pair.box];
  const double mass = pair.other < 0 ? solid.mass : std::min(solid.mass, solids_[pair.other].mass);
  const double hold = RIGID * mass / (FACE_POINTS * kick);
  const Vector half = solid.model.half;
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
  const double decay = 2.0 * kick * damping / mass;
  const double implicit = decay > 2.0 ? 1.0 - 1.0 / decay : 0.5;
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    ContactPoint& point = solver_.points[i];
    point.rigid = rigid;
    point.stiffness = point.share * stiffness;
    point.damping = point.share * damping;
    point.implicit = implicit;
    point.stop = hold;
    point.stick = hold;
    point.held = {};
    point.friction = friction;
    point.augmented = 1.0 / RIGID;
    point.lever = model_.rolling_arm;
    point.turn_stick = hold * dot(half, half);
  }
  if (is_pad && pair.box == 0) soften(number);
}

// Friction of a pad that yields along its face: impact_rs_sim/plant/pad_shear.py, with spring and damper after the step.
void Twin::soften(std::size_t number) {
  const Partner& partner = solver_.partners[number];
  TwinArm& arm = arms_[partners_[number]];  // pairs of the object with arms have their numbers
  Softened& own = softened_[partners_[number]];
  const double compliance = arm.pad().shear_compliance, creep = arm.pad().creep;
  own.yields = compliance > 0.0 || creep > 0.0;
  if (!own.yields) return;
  own.weights.clear();
  double total = 0.0;
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    const ContactPoint& point = solver_.points[i];
    own.weights.push_back(normal_force(point, solver_.span, point.speed).force);
    total += own.weights.back();
  }
  if (!(total > 0.0)) arm.shear = {};
  own.centre = {};
  for (std::size_t i = 0; i < partner.count; ++i) {
    own.weights[i] = total > 0.0 ? own.weights[i] / total : 1.0 / static_cast<double>(partner.count);
    own.centre = own.centre + own.weights[i] * solver_.points[partner.first + i].place;
  }
  own.lag = std::sqrt(compliance);  // damping ratio 0.5 of a kilogram on the spring
  const double theta = own.lag + solver_.span.now, stiff = 1.0 / (compliance + theta * creep);
  const Vector& normal = solver_.points[partner.first].normal;
  const Vector lever = cross(normal, own.centre + solids_.front().centre - arm.end());
  const Vector shift = tangential(arm.axes_of_last() * arm.shear.shift + arm.shear.twist * lever, normal);
  for (std::size_t i = 0; i < partner.count; ++i) {
    ContactPoint& point = solver_.points[partner.first + i];
    point.stick = own.weights[i] * stiff * theta;
    point.augmented = std::min(1.0, point.stop / (RIGID * std::max(point.stick, 1e-300)));
    point.held = (own.weights[i] * stiff) * (shift + arm.shear.twist * cross(normal, point.place - own.centre));
  }
}

// Shear after the step: what friction holds.
void Twin::remember(std::size_t number) {
  const Partner& partner = solver_.partners[number];
  TwinArm& arm = arms_[partners_[number]];
  const Softened& own = softened_[partners_[number]];
  const Vector& normal = solver_.points[partner.first].normal;
  const double* wrench = solver_.wrench(number);  // about the object's centre of mass
  const Vector force = vector(wrench + 3), pull = tangential(force, normal);
  double torque = dot(normal, vector(wrench) - cross(own.centre, force)), radius = 0.0;
  for (std::size_t i = 0; i < partner.count; ++i) {
    const Vector turning = cross(normal, solver_.points[partner.first + i].place - own.centre);
    radius += own.weights[i] * dot(turning, turning);
  }
  const double theta = own.lag + solver_.span.now, kept = own.lag / theta;
  const double yields = solver_.span.now * arm.pad().shear_compliance / theta;
  const Vector lever = cross(normal, own.centre + solids_.front().centre - arm.end());
  const Vector shift = tangential(arm.axes_of_last() * arm.shear.shift + arm.shear.twist * lever, normal);
  const double twist = kept * arm.shear.twist - (radius > 1e-12 ? yields * torque / radius : 0.0);
  arm.shear.twist = twist;
  arm.shear.shift = transposed_times(arm.axes_of_last(), kept * shift - yields * pull - twist * lever);
}

void Twin::step(double length, double time) {
  const double kick = 0.5 * (last_ + length);
  ++report_.steps;
  std::fill(pad_forces_.begin(), pad_forces_.end(), Vector{});
  solver_.span = {last_, length};
  for (TwinArm& arm : arms_) arm.equations();
  if (pushes_) push(time);
  if (any_awake()) {
    touch_step(kick, time);
  } else {
    for (TwinArm& arm : arms_)
      if (!arm.coast(kick)) std::fill(arm.dq.begin(), arm.dq.end(), std::numeric_limits<double>::quiet_NaN());
  }
  for (std::size_t i = 0; i < arms_.size(); ++i) {
    const auto touches = [&](int number) { return pairs_[number].arm == static_cast<int>(i); };
    arms_[i].move(kick, length, std::any_of(partners_.begin(), partners_.end(), touches));
  }
  for (Solid& solid : solids_) {
    if (!solid.awake || solid.fixed) continue;
    solid.centre = solid.centre + length * solid.velocity;
    solid.rotation = turned(length * solid.angular, solid.rotation);
  }
  if (pushes_ && !(is_zero(force_) && is_zero(moment_))) solids_.front().awake = true;  // with its support, from the next step on
  last_ = length;
}

// An arm in contact among the unknowns of the step.
void Twin::put_arm(const Partner& partner, const TwinArm& arm) {
  StepSolver& solver = solver_;
  const int joints = arm.joints(), at = partner.offset, n = solver.size;
  for (int i = 0; i < joints; ++i)
    for (int j = 0; j <= i; ++j)
      solver.mass[(at + i) * n + at + j] = solver.mass[(at + j) * n + at + i] = arm.mass[i * joints + j];
  for (int i = 0; i < joints; ++i) {
    double sum = solver.kick * arm.driving[i];
    for (int j = 0; j < joints; ++j) sum += solver.mass[(at + i) * n + at + j] * arm.dq[j];
    solver.impulse[at + i] = sum;
    solver.velocity[at + i] = arm.dq[i];
  }
  for (int i = 0, own = at + joints; i < arm.yields(); ++i, ++own) {
    solver.mass[own * n + own] = arm.tool_inertia(solver.kick, solver.span.now);
    solver.impulse[own] = arm.tool_impulse(i, solver.kick);
    solver.velocity[own] = arm.tool_rate[i];
  }
}

// A box likewise, under a force and a moment about its centre of mass.
void Twin::put_box(Solid& solid, const Vector& force, const Vector& moment) {
  StepSolver& solver = solver_;
  const int o = solid.offset, n = solver.size;
  const Matrix turns = solid.fixed ? IDENTITY : solid.inertia();
  if (!solid.fixed) solid.momentum = solid.momentum + solver.kick * moment;
  const Vector free =
      solid.fixed ? Vector{} : solid.velocity + solver.kick * (model_.gravity + (1.0 / solid.mass) * force);
  const Vector spin = divided(turns, solid.momentum);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) solver.mass[(o + i) * n + o + j] = turns[3 * i + j];
    solver.mass[(o + 3 + i) * n + o + 3 + i] = solid.mass;
    solver.impulse[o + i] = solid.momentum[i];
    solver.impulse[o + 3 + i] = solid.mass * free[i];
    solver.velocity[o + i] = partners_.empty() ? spin[i] : solid.angular[i];
    solver.velocity[o + 3 + i] = partners_.empty() ? free[i] : solid.velocity[i];
  }
}

void Twin::touch_step(double kick, double time) {
  StepSolver& solver = solver_;
  std::vector<int> offsets(arms_.size(), -1);
  int size = 0;
  for (const int number : partners_) {
    const int arm = pairs_[number].arm;
    if (arm < 0 || offsets[arm] >= 0) continue;
    offsets[arm] = size;
    size += arms_[arm].joints() + arms_[arm].yields();
  }
  for (std::size_t i = 0; i < arms_.size(); ++i)
    if (offsets[i] < 0 && !arms_[i].coast(kick))
      std::fill(arms_[i].dq.begin(), arms_[i].dq.end(), std::numeric_limits<double>::quiet_NaN());
  solver.objects.clear();
  for (Solid& solid : solids_) {
    if (!solid.awake) continue;
    solid.offset = size;
    solver.objects.push_back(size);
    size += 6;
  }
  const int n = size;
  solver.size = n;
  solver.kick = kick;
  solver.object_mass = solids_.front().mass;
  solver.fixed = solids_.front().fixed;
  solver.mass.assign(n * n, 0.0);
  solver.impulse.resize(n);
  solver.velocity.resize(n);
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    Partner& partner = solver.partners[k];
    const Pair& pair = pairs_[partners_[k]];
    partner.object = solids_[pair.box].offset;
    if (pair.arm >= 0) partner.offset = offsets[pair.arm];
    if (pair.other >= 0) partner.offset = solids_[pair.other].offset;
    prepare(k, kick);
    if (pair.arm >= 0) put_arm(partner, arms_[pair.arm]);
  }
  for (Solid& solid : solids_) {
    if (!solid.awake) continue;
    const bool is_object = &solid == &solids_.front();
    put_box(solid, is_object ? force_ : Vector{}, is_object ? moment_ : Vector{});
  }
  if (!partners_.empty()) {
    ++report_.contact_steps;
    recall();
    const std::vector<double> before = solver.velocity;
    if (partners_ == partners_before_ && change_.size() == before.size()) {
      for (int i = 0; i < n; ++i) solver.velocity[i] += kick / kick_before_ * change_[i];
    }
    const Solution solution = solver.solve();
    change_.resize(n);
    for (int i = 0; i < n; ++i) change_[i] = solver.velocity[i] - before[i];
    kick_before_ = kick;
    report_.iterations += solution.iterations;
    report_.fallbacks += solution.fallback;
    report_.residual = std::max(report_.residual, solution.residual);
    if (!solution.solved) report_.failed.push_back(time);
  }
  partners_before_ = partners_;
  for (Touching& touching : touching_)
    touching.force = touching.penetration = touching.closing = touching.slip = 0.0;
  for (auto& guesses : guesses_) guesses.clear();
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    const Partner& partner = solver.partners[k];
    const Pair& pair = pairs_[partners_[k]];
    std::vector<Guess>& guesses = guesses_[partners_[k]];
    for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
      guesses.push_back(solver.guesses[i]);
      guesses.back().load = solver.loads()[i];
    }
    const double* wrench = solver.wrench(k);
    Solid& solid = solids_[pair.box];
    for (int i = 0; i < 3 && !solid.fixed; ++i) solid.momentum[i] += kick * wrench[i];
    if (pair.other >= 0) {
      Vector& momentum = solids_[pair.other].momentum;
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 6; ++i) momentum[j] -= kick * partner.motions[6 * j + i] * wrench[i];
    }
    if (pair.arm < 0) continue;
    TwinArm& arm = arms_[pair.arm];
    pad_forces_[pair.arm] = pad_forces_[pair.arm] + -1.0 * vector(wrench + 3);
    const auto rates = solver.velocity.begin() + partner.offset;
    std::copy_n(rates, arm.joints(), arm.dq.begin());
    std::copy_n(rates + arm.joints(), arm.yields(), arm.tool_rate.begin());
    if (pair.box == 0 && softened_[pair.arm].yields) remember(k);
  }
  for (Solid& solid : solids_) {
    if (!solid.awake || solid.fixed) continue;
    solid.angular = vector(&solver.velocity[solid.offset]);
    solid.velocity = vector(&solver.velocity[solid.offset + 3]);
  }
  for (std::size_t k = 0; k < partners_.size(); ++k) note(k, time);
}

// How a partner was touched in this step.
void Twin::note(std::size_t number, double time) {
  const Partner& partner = solver_.partners[number];
  Touching& own = touching_[partners_[number]];
  double total = 0.0, deep = 0.0;
  Vector place{};
  for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
    const double load = solver_.loads()[i];
    total += load;
    deep -= load * solver_.points[i].gap;
    place = place + load * solver_.points[i].place;
  }
  if (!(total > 0.0)) return;
  place = (1.0 / total) * place;
  const Solid& solid = solids_[pairs_[partners_[number]].box];
  Vector angular = solid.angular, linear = solid.velocity;
  for (int j = 0; j < partner.joints; ++j) {
    const double rate = solver_.velocity[partner.offset + j];
    angular = angular - rate * vector(partner.motions + 6 * j);
    linear = linear - rate * vector(partner.motions + 6 * j + 3);
  }
  own.normal = solver_.points[partner.first].normal;
  const Vector velocity = linear + cross(angular, place), sliding = tangential(velocity, own.normal);
  own.force = total;
  own.penetration = deep / total;
  own.closing = -dot(velocity, own.normal);
  own.slip = norm(sliding);
  own.along = (1.0 / std::hypot(own.slip, SLOW)) * sliding;
  own.place = place + solid.centre;
  if (own.begin < 0.0) own.begin = time;
}

// Forces of the step before as a first guess, where a partner has as many points as then.
void Twin::recall() {
  solver_.guesses.assign(solver_.points.size(), Guess{{}, -1.0, true, true});
  for (std::size_t k = 0; k < partners_.size(); ++k) {
    const Partner& partner = solver_.partners[k];
    const std::vector<Guess>& before = guesses_[partners_[k]];
    if (before.size() == partner.count) std::copy(before.begin(), before.end(), solver_.guesses.begin() + partner.first);
  }
}

}  // namespace impact_rs
