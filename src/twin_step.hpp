// SPDX-License-Identifier: Apache-2.0
// Velocities after one step of the twin: the root of
//
//     R(x) = A x - p - h sum S_k^T w_k(S_k x),      A = blockdiag(M_1.., I, m),
//
// x the joint velocities of the arms in contact, then angular velocity and velocity of the centre of mass of every object;
// w_k the wrench of partner k on its object at its twist against it. An object on a hinge or slide has the twist s z with
// the one velocity z in x; its rows are multiplied by s^T, and its block of A is s^T diag(I, m) s. Newton's method; where
// it cycles, the friction limits are fixed for some rounds, for which the root is the minimum of a convex function.

#pragma once

#include <vector>

#include "twin_contact.hpp"

namespace impact_rs {

constexpr double STEP_TOLERANCE = 1e-9;  // m/s, of a step that is solved

// A partner of an object: an arm, another object, whose six velocities stand for those of joints, or the support.
struct Partner {
  int joints;           // 0: it is at rest
  int offset;           // of its joint velocities among the unknowns
  const double* motions;  // of its joints: twist (angular, linear) at the object's centre of mass, (joints, 6)
  std::size_t first, count;  // its points
  int object;           // offset of the velocities of the object, or of the one that its guide leaves
};

struct Solution {
  double residual;  // size of R, as a velocity of the object [m/s]
  int iterations;
  bool fallback;
  bool solved;
};

class StepSolver {
 public:
  // The problem; filled in by the caller, then solved.
  int size = 0;
  double velocity_step = 0.0;            // h in R [s]
  StepLengths lengths{};                  // of the contact laws
  double object_mass = 0.0;     // turns a residual into a velocity [kg]
  bool fixed = false;           // whether no wrench moves the object
  bool guided = false;          // whether it is on a hinge or slide, and there is no other
  std::array<double, 6> along{};  // s of that: twist of its centre of mass at unit speed
  std::vector<double> mass;     // A, (size, size)
  std::vector<double> impulse;  // p
  std::vector<double> velocity;  // x: first guess, then the root
  std::vector<int> objects;     // offsets of their velocities
  std::vector<Partner> partners;
  std::vector<ContactPoint> points;
  std::vector<Guess> guesses;   // of the points; friction is that of the last step of Newton's method afterwards

  Solution solve();

  // Normal force of every point and wrench (6) of every partner at the velocities of the last evaluation.
  const std::vector<double>& normal_forces() const { return normal_forces_; }
  const double* wrench(std::size_t partner) const { return &wrenches_[6 * partner]; }

 private:
  int freedoms() const { return guided ? 1 : 6; }
  void evaluate(const std::vector<double>& x, bool with_derivative);
  void twist_against(const Partner& partner, const std::vector<double>& x, double* twist) const;
  double residual() const;
  bool newton(bool augmented, bool as_before);
  void update_guesses();
  void fix_friction_limits(double tolerance);
  bool newton_step();
  double slope(double fraction);

  bool limits_fixed_ = false;  // whether friction is limited by fixed_loads_
  int iterations_ = 0;
  std::vector<LinearForce> forces_;
  std::vector<double> fixed_loads_, normal_forces_, wrenches_, residual_, matrix_, step_, trial_, before_, product_;
};

}  // namespace impact_rs
