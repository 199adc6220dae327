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

void Drive::resize(std::size_t size) {
  for (auto* state : {&position, &velocity, &elastic, &transmission, &actuation, &friction}) state->assign(size, 0.0);
}

void Drive::sense(const double* q, const double* dq) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) {
    elastic[i] = (position[i] - q[i]) * stiffness_[i % n];
    transmission[i] = (velocity[i] - dq[i]) * damping_[i % n] + elastic[i];
  }
}

void Drive::step(const double* shaped) {
  act(shaped);
  move(period_, period_);
}

void Drive::act(const double* shaped) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) actuation[i] = feedback_[i % n] * transmission[i] + shaped[i];
}

void Drive::move(double kick, double drift) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) {
    double net = actuation[i] - transmission[i];
    if (!law_.coulomb.empty()) net += friction[i] = law_.torque(i % n, velocity[i]);
    velocity[i] += net * rotor_inverse_[i % n] * kick;
    position[i] += velocity[i] * drift;
  }
}

void Drive::coast(Chain& links, const double* shaped, const double* load, double* q, double* dq) {
  link_torque_.resize(size());
  for (std::size_t i = 0; i < size(); ++i) link_torque_[i] = transmission[i] + load[i];
  step(shaped);
  for (std::size_t first = 0; first < size(); first += joints())
    links.advance(q + first, dq + first, link_torque_.data() + first, period_);
  sense(q, dq);
}

}  // namespace impact_rs
