// SPDX-License-Identifier: Apache-2.0
#include "twin_arm.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace impact_rs {

TwinArm::TwinArm(const ArmModel& model, const ArmStart& start, double period)
    : q(start.position),
      dq(start.velocity),
      model_(model),
      memory_(fresh_memory(model.formulas)),
      period_(period),
      links_(model.links),
      drive_(model.drive),
      commands_(start.earlier) {
  const std::size_t n = q.size();
  for (auto* numbers : {&desired_torque_, &shaped_, &link_torque_, &on_links_, &on_motors_, &acceleration_, &net_torque})
    numbers->assign(n, 0.0);
  mass.assign(n * n, 0.0);
  symbols.assign(of_joints + 3 * n, 0.0);
  for (auto* numbers : {&tool, &tool_rate, &tool_before_, &tool_load_}) numbers->assign(tool_freedoms(), 0.0);
  torque_rate_ = start.torque_rate;
  drive_.elastic = start.torque;
  for (std::size_t i = 0; i < n; ++i) {
    const double tau = start.torque[i], rate = torque_rate_[i];
    drive_.position[i] = q[i] + tau / model.stiffness[i];
    drive_.velocity[i] = dq[i] + rate / model.stiffness[i];
    drive_.transmission[i] = tau + model.damping[i] / model.stiffness[i] * rate;
  }
}

ConvexBody TwinArm::pad_box() const {
  const Matrix& axes = links_.last_joint_axes();
  const Pad& pad = model_.pad;
  if (tool_freedoms() == 0) return {links_.end() + axes * pad.centre, axes * pad.rotation, pad.half, pad.shape};
  Spatial displaced{};
  for (int i = 0; i < tool_freedoms(); ++i) displaced = displaced + tool[i] * model_.tool.motions[i];
  const Matrix turn = turned(displaced.angular, IDENTITY);
  return {links_.end() + axes * (displaced.linear + turn * pad.centre), axes * (turn * pad.rotation), pad.half,
          pad.shape};
}

Spatial TwinArm::tool_motion(int freedom) const {
  const Matrix& axes = links_.last_joint_axes();
  const Spatial& own = model_.tool.motions[freedom];
  const Vector angular = axes * own.angular;
  return {angular, axes * own.linear + cross(end(), angular)};
}

// lag dz+/dt + (z- + z+) / 2 = B^T w with z+ = z + position_step dz+/dt: the mean of two steps keeps the spring's energy.
double TwinArm::tool_inertia(double velocity_step, double position_step) const {
  return velocity_step * (model_.tool.lag + 0.5 * position_step);
}

double TwinArm::tool_impulse(int freedom, double velocity_step) const {
  return velocity_step * (tool_load_[freedom] - 0.5 * (tool[freedom] + tool_before_[freedom]));
}

void TwinArm::update_symbols() {
  const int n = joints();
  Spatial twist{};
  for (int i = 0; i < n; ++i) twist = twist + dq[i] * axis(i);
  const Vector velocity = twist.linear + cross(twist.angular, end());
  std::copy(end().begin(), end().end(), &symbols[of_position]);
  std::copy(velocity.begin(), velocity.end(), &symbols[of_velocity]);
  symbols[of_speed] = norm(velocity);
  double* joint = &symbols[of_joints];
  for (const auto* values : {&q, &dq, &drive_.elastic}) joint = std::copy(values->begin(), values->end(), joint);
}

void TwinArm::initialise_memory(const std::vector<double>& samples) {
  bool remembers = false;
  for (const FormulaLoad& load : model_.formulas) remembers = remembers || load.formula.lags() > 0;
  if (!remembers) return;
  const std::size_t n = q.size();
  const std::vector<double> now[] = {q, dq, drive_.elastic};
  std::vector<double>* const values[] = {&q, &dq, &drive_.elastic};
  for (auto sample = samples.begin(); sample != samples.end();) {
    symbols[of_time] = *sample++;
    for (auto* own : values) {
      std::copy_n(sample, n, own->begin());
      sample += n;
    }
    update_kinematics();
    update_symbols();
    for (std::size_t i = 0; i < model_.formulas.size(); ++i)
      if (model_.formulas[i].formula.lags() > 0) value(i);
  }
  for (int i = 0; i < 3; ++i) *values[i] = now[i];
}

void TwinArm::update_loads() {
  if (!model_.spring && model_.formulas.empty() && !model_.python) return;
  const int n = joints();
  std::fill(on_links_.begin(), on_links_.end(), 0.0);
  std::fill(on_motors_.begin(), on_motors_.end(), 0.0);
  update_kinematics();
  update_symbols();
  const Vector& position = end();
  Vector force{};
  if (model_.spring) force = model_.spring->force + -model_.spring->stiffness * (position - model_.spring->position);
  for (std::size_t i = 0; i < model_.formulas.size(); ++i) {
    const FormulaLoad& load = model_.formulas[i];
    if (load.acts == Acts::on_end_effector) {
      force[load.index] += value(i);
    } else if (load.acts == Acts::on_link || load.acts == Acts::on_motor) {
      (load.acts == Acts::on_link ? on_links_ : on_motors_)[load.index] += value(i);
    }
  }
  for (int i = 0; i < n; ++i) on_links_[i] += dot(axis(i).linear + cross(axis(i).angular, position), force);
  if (model_.python) {
    model_.python(symbols.data(), q.data(), dq.data(), drive_.elastic.data(), on_links_.data(), on_motors_.data());
  }
}

void TwinArm::apply_force(const Vector& position, const Vector& force) {
  for (int i = 0; i < joints(); ++i) net_torque[i] += dot(axis(i).linear + cross(axis(i).angular, position), force);
  for (int i = 0; i < tool_freedoms(); ++i) {
    const Spatial own = tool_motion(i);
    tool_load_[i] += dot(own.linear + cross(own.angular, position), force);
  }
}

void TwinArm::set_desired_torque(const double* torque, std::int64_t period) {
  if (model_.delay <= 0.0 || model_.joint_torque) {
    std::copy_n(torque, joints(), desired_torque_.begin());
    return;
  }
  commands_.push_back({period * period_, {torque, torque + joints()}});
}

// `desired_torque_`: mean of the commands (zero-order hold) over the period that began `delay` before.
void TwinArm::delay_commands(double begin) {
  const double end = begin + period_;
  while (commands_.size() > 1 && commands_[1].since <= begin) commands_.pop_front();
  std::fill(desired_torque_.begin(), desired_torque_.end(), 0.0);
  for (std::size_t number = 0; number < commands_.size(); ++number) {
    const double from = number == 0 ? begin : commands_[number].since;
    const double until = number + 1 < commands_.size() ? std::min(commands_[number + 1].since, end) : end;
    if (until <= from) continue;
    for (int i = 0; i < joints(); ++i) desired_torque_[i] += (until - from) / period_ * commands_[number].torque[i];
  }
}

void TwinArm::command(std::int64_t period) {
  const int n = joints();
  if (model_.joint_torque) {
    for (int i = 0; i < n; ++i) {
      torque_rate_[i] = (desired_torque_[i] - drive_.elastic[i]) / period_;
      link_torque_[i] = desired_torque_[i] + model_.damping[i] / model_.stiffness[i] * torque_rate_[i] + on_links_[i];
      drive_.elastic[i] = desired_torque_[i];
    }
    return;
  }
  if (model_.delay > 0.0) delay_commands(period * period_ - model_.delay);
  for (int i = 0; i < n; ++i)
    shaped_[i] = model_.shaping[i] * (model_.gain[i] * desired_torque_[i] + model_.offset[i] + on_motors_[i]);
  drive_.update_actuation(shaped_.data());
}

void TwinArm::equations() {
  const int n = joints();
  if (!model_.joint_torque) {
    for (int i = 0; i < n; ++i) link_torque_[i] = drive_.transmission[i] + on_links_[i];
  }
  links_.equations(dq.data(), link_torque_.data(), mass.data(), net_torque.data());
  std::fill(tool_load_.begin(), tool_load_.end(), 0.0);
}

bool TwinArm::free_step(double velocity_step) {
  const int n = joints();
  factor_ = mass;
  acceleration_ = net_torque;
  if (!factorise(factor_.data(), n)) return false;
  forward(factor_.data(), n, acceleration_.data(), 1);
  backward(factor_.data(), n, acceleration_.data(), 1);
  for (int i = 0; i < n; ++i) dq[i] += velocity_step * acceleration_[i];
  return true;
}

void TwinArm::integrate(double velocity_step, double position_step, bool in_contact) {
  const int n = joints();
  for (int i = 0; i < tool_freedoms(); ++i) {
    tool_before_[i] = tool[i];
    if (in_contact) {
      tool[i] += position_step * tool_rate[i];
    } else {
      tool[i] *= model_.tool.lag > 0.0 ? std::exp(-position_step / model_.tool.lag) : 0.0;
      tool_rate[i] = (tool[i] - tool_before_[i]) / position_step;
    }
  }
  for (int i = 0; i < n; ++i) q[i] += position_step * dq[i];
  if (model_.joint_torque) {
    for (int i = 0; i < n; ++i) {
      drive_.position[i] = q[i] + drive_.elastic[i] / model_.stiffness[i];
      drive_.velocity[i] = dq[i] + torque_rate_[i] / model_.stiffness[i];
    }
    return;
  }
  drive_.integrate(velocity_step, position_step);
  drive_.sense(q.data(), dq.data());
}

}  // namespace impact_rs
