// SPDX-License-Identifier: Apache-2.0
// Motor and spring of every joint, one period of the torque loop at a time; equations in impact_rs_sim/drive.py.

#pragma once

#include <utility>
#include <vector>

#include "dense.hpp"

namespace impact_rs {

// B_rho B_theta^-1 tau_fric of the n joints; parameters as in impact_rs_sim/physics.py. Empty: no friction.
struct Friction {
  std::vector<double> coulomb, viscous, stribeck, stribeck_velocity, smoothing;
  std::vector<double> asymmetry, load;
  std::vector<double> a, b, c;  // of the sigmoid
  std::vector<double> shaft_coulomb, shaft_viscous, shaft_ratio;  // of joints i and i + 1, in sets of n - 1; of tau_fric
  std::vector<double> shaping;                                    // B_rho B_theta^-1 of the joints

  // Of one joint alone, which transmits `transmitted` [N m].
  double torque(std::size_t joint, double velocity, double transmitted) const;

  // Of the shafts that turn with two joints, added to `torque`.
  void add_shafts(const std::vector<double>& velocity, std::vector<double>& torque) const;
};

class Drive {
 public:
  // Numbers of the n joints; feedback is I - B_rho B_theta^-1.
  Drive(std::vector<double> stiffness, std::vector<double> damping, std::vector<double> feedback,
        std::vector<double> rotor_inverse, Friction friction, double period)
      : stiffness_(std::move(stiffness)),
        damping_(std::move(damping)),
        feedback_(std::move(feedback)),
        rotor_inverse_(std::move(rotor_inverse)),
        law_(std::move(friction)),
        period_(period) {
    for (auto* state : {&position, &velocity, &elastic, &transmission, &actuation, &this->friction})
      state->assign(joints(), 0.0);
  }

  std::size_t joints() const { return stiffness_.size(); }

  // Spring and damper between the motors and links at `q` [rad] that move at `dq` [rad/s].
  void sense(const double* q, const double* dq);

  // One period with B_rho B_theta^-1 tau_d in `shaped` [N m]: act, then move by a period.
  void step(const double* shaped);

  // The torque law: `actuation` until it is called again.
  void update_actuation(const double* shaped);

  // The motors under their torques for `velocity_step`, then along their velocities for `position_step` [s].
  void integrate(double velocity_step, double position_step);

  std::vector<double> position, velocity;     // of the motors [rad, rad/s]
  std::vector<double> elastic, transmission;  // tau_J, and with the damper [N m]
  std::vector<double> actuation, friction;    // tau_act and tau_fric,m of the last step [N m]

 private:
  std::vector<double> stiffness_, damping_, feedback_, rotor_inverse_;
  Friction law_;
  double period_;
};

}  // namespace impact_rs
