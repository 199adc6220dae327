// SPDX-License-Identifier: Apache-2.0
#include "drive.hpp"

#include <utility>

namespace impact_rs {

double Friction::torque(std::size_t i, double velocity, double transmitted) const {
  const double ratio = velocity / stribeck_velocity[i], direction = std::tanh(velocity / smoothing[i]);
  const double sliding = coulomb[i] + stribeck[i] * std::exp(-ratio * ratio);
  double torque = -(sliding + asymmetry[i] * direction + load[i] * std::abs(transmitted)) * direction -
                  viscous[i] * velocity;
  if (!a.empty()) torque -= a[i] / (1.0 + std::exp(-b[i] * (velocity + c[i]))) - a[i] / (1.0 + std::exp(-b[i] * c[i]));
  return torque;
}

void Friction::add_shafts(const std::vector<double>& velocity, std::vector<double>& torque) const {
  for (std::size_t shaft = 0; shaft < shaft_coulomb.size(); ++shaft) {
    const std::size_t i = shaft % (velocity.size() - 1);
    const double speed = velocity[i] + shaft_ratio[shaft] * velocity[i + 1];
    const double own = -shaft_coulomb[shaft] * std::tanh(speed / smoothing[i]) - shaft_viscous[shaft] * speed;
    torque[i] += shaping[i] * own;
    torque[i + 1] += shaping[i + 1] * shaft_ratio[shaft] * own;
  }
}

void Drive::sense(const double* q, const double* dq) {
  for (std::size_t i = 0; i < joints(); ++i) {
    elastic[i] = (position[i] - q[i]) * stiffness_[i];
    transmission[i] = (velocity[i] - dq[i]) * damping_[i] + elastic[i];
  }
}

void Drive::step(const double* shaped) {
  update_actuation(shaped);
  integrate(period_, period_);
}

void Drive::update_actuation(const double* shaped) {
  for (std::size_t i = 0; i < joints(); ++i) actuation[i] = feedback_[i] * transmission[i] + shaped[i];
}

void Drive::integrate(double velocity_step, double position_step) {
  if (!law_.coulomb.empty()) {
    for (std::size_t i = 0; i < joints(); ++i) friction[i] = law_.torque(i, velocity[i], transmission[i]);
    law_.add_shafts(velocity, friction);
  }
  for (std::size_t i = 0; i < joints(); ++i) {
    double net = actuation[i] - transmission[i];
    if (!law_.coulomb.empty()) net += friction[i];
    velocity[i] += net * rotor_inverse_[i] * velocity_step;
    position[i] += velocity[i] * position_step;
  }
}

}  // namespace impact_rs
