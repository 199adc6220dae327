// SPDX-License-Identifier: Apache-2.0
#include "drive.hpp"

#include <algorithm>
#include <cmath>

namespace impact_rs {

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

void Drive::step(const double* shaped, const double* smooth, const double* dry) {
  const std::size_t n = joints();
  for (std::size_t i = 0; i < size(); ++i) {
    actuation[i] = feedback_[i % n] * transmission[i] + shaped[i];
    const double gain = rotor_inverse_[i % n] * period_;
    friction[i] = smooth != nullptr ? smooth[i] : 0.0;
    velocity[i] += (actuation[i] - transmission[i] + friction[i]) * gain;
    if (dry != nullptr) {
      const double stopping = -velocity[i] / gain, held = std::copysign(std::min(std::abs(stopping), dry[i]), stopping);
      velocity[i] = held == stopping ? 0.0 : velocity[i] + held * gain;
      friction[i] += held;
    }
    position[i] += velocity[i] * period_;
  }
}

}  // namespace impact_rs
