// SPDX-License-Identifier: Apache-2.0
// Laws of one contact point over one step of the twin; equations in docs/physics.md, "The twin".
//
// Velocities are those of the object against its partner, forces act on the object, normals point into it.

#pragma once

#include "dense.hpp"

namespace impact_rs {

using Matrix6 = std::array<double, 36>;  // row by row

struct ContactPoint {
  Vector position;        // from the object's centre of mass [m]
  Vector normal;
  double gap;          // now [m]; negative: overlap
  double speed;        // at which it opened in the step before [m/s]
  bool rigid;
  double share;        // of the partner's stiffness and damping that this point has

  // Normal force. Compliant: spring and damper over the step. Rigid: a damper that stops the point.
  double stiffness;    // [N/m]
  double damping;      // [N s/m]
  double implicit;     // share of the damper that acts on the velocity after the step, 0.5 to 1
  double rigid_damping;         // [N s/m]

  // Friction: the projection of -(stick_damping u_t + friction_offset) onto Coulomb's cone.
  double stick_damping;        // [N s/m]
  Vector friction_offset;         // [N]
  double friction;     // [-]
  double augmented;    // rho over stick_damping, 0 to 1

  // Rolling: the moment -rolling_damping w_t, not larger than rolling_arm times the normal force.
  double rolling_damping;   // [N m s]
  double rolling_arm;        // [m]
};

// Length of the step before and of this one [s].
struct StepLengths {
  double before, now;
};

struct NormalForce {
  double force;  // [N]
  double slope;  // -d force / d velocity [N s/m]
};

// Force at the normal velocity after the step.
NormalForce normal_force(const ContactPoint& point, const StepLengths& lengths, double speed);

// Force of a point as a linear function of its velocity, force - derivative (u - velocity).
struct LinearForce {
  Vector force, velocity;
  Matrix derivative;
};

// Force and moment of a point, about the object's centre of mass, added to a wrench (moment, force). Friction is limited
// by the normal force, or by `fixed_load` [N] where that is not negative. The normal force is returned.
double add_contact(const ContactPoint& point, const StepLengths& lengths, const Vector& angular,
                   const Vector& linear, double fixed_load, double* wrench);

// Guess of a step of Newton's method at a point.
struct Guess {
  Vector friction;     // its friction [N]
  double normal_force;     // its normal force in the step before [N]; negative: not known
  bool augmented;  // whether friction has the direction of friction - rho u_t (the projection of Alart and Curnier)
  bool as_before;  // whether a rigid point is open or closed as in the step before
};

// The same for a step of Newton's method: wrench and minus its derivative by the twist (angular, linear). At the root the
// forces are those above, whatever the guess is.
double add_linear_contact(const ContactPoint& point, const StepLengths& lengths, const Vector& angular,
                          const Vector& linear, double fixed_load, const Guess& guess, double* wrench,
                          Matrix6& derivative, LinearForce& own);

}  // namespace impact_rs
