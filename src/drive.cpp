// SPDX-License-Identifier: Apache-2.0
#include "drive.hpp"

namespace impact_rs {

void Drive::resize(std::size_t size) {
  for (auto* state : {&position, &velocity, &elastic, &transmission, &actuation}) state->assign(size, 0.0);
}

void Drive::sense(const double* q, const double* dq) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) {
    elastic[i] = (position[i] - q[i]) * stiffness_[i % n];
    transmission[i] = (velocity[i] - dq[i]) * damping_[i % n] + elastic[i];
  }
}

void Drive::step(const double* shaped, const double* friction) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) {
    actuation[i] = feedback_[i % n] * transmission[i] + shaped[i];
    double net = actuation[i] - transmission[i];
    if (friction != nullptr) net += friction[i];
    velocity[i] += net * rotor_inverse_[i % n] * period_;
    position[i] += velocity[i] * period_;
  }
}

}  // namespace impact_rs
