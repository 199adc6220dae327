// SPDX-License-Identifier: Apache-2.0
#include "drive.hpp"

namespace impact_rs {

double Friction::torque(std::size_t i, double velocity) const {
  const double ratio = velocity / stribeck_velocity[i];
  double torque = -(coulomb[i] + stribeck[i] * std::exp(-ratio * ratio)) * std::tanh(velocity / smoothing) -
                  viscous[i] * velocity;
  if (!a.empty()) torque -= a[i] / (1.0 + std::exp(-b[i] * (velocity + c[i]))) - a[i] / (1.0 + std::exp(-b[i] * c[i]));
  return torque;
}

void Drive::sense(const double* q, const double* dq) {
  for (std::size_t i = 0; i < joints(); ++i) {
    elastic[i] = (position[i] - q[i]) * stiffness_[i];
    transmission[i] = (velocity[i] - dq[i]) * damping_[i] + elastic[i];
  }
}

void Drive::step(const double* shaped) {
  act(shaped);
  move(period_, period_);
}

void Drive::act(const double* shaped) {
  for (std::size_t i = 0; i < joints(); ++i) actuation[i] = feedback_[i] * transmission[i] + shaped[i];
}

void Drive::move(double kick, double drift) {
  for (std::size_t i = 0; i < joints(); ++i) {
    double net = actuation[i] - transmission[i];
    if (!law_.coulomb.empty()) net += friction[i] = law_.torque(i, velocity[i]);
    velocity[i] += net * rotor_inverse_[i] * kick;
    position[i] += velocity[i] * drift;
  }
}

}  // namespace impact_rs
