// SPDX-License-Identifier: Apache-2.0
// Arithmetic of a control tick of one arm. Equations in impact_rs_control: detection.py for the Observer, controller.py
// for the TaskLaw, qp.py for the Program. Matrices are stored row by row.

#pragma once

#include <vector>

#include "dense.hpp"

namespace impact_rs {

// Rigid-body terms of n joints, as Pinocchio has them.
struct RigidTerms {
  const double* inertia;   // M, (n, n)
  const double* bias;      // h, (n)
  const double* jacobian;  // J of frame E in E[A], (6, n)
};

// Least mobility of a row of J, over the trace of the three linear ones; moments at a lever of 1 m [-]. Below it E has a
// hundredth of its leverage there: a torque noise of 0.05 N m would be a force of 10 N.
constexpr double MOVABLE = 1e-4;
// Least share of the mobility of a row that the rows before it do not explain [-]; its variance inflation is 50 there. The
// trials of the shipped scenarios have 0.034 and more, a UR5e with its elbow at 0.3 rad 0.0009.
constexpr double SEPARABLE = 0.02;

// Momentum observer: estimates the external wrench on E and detects a sudden force against a direction.
class Observer {
 public:
  Observer(int joints, double gain, double period, double threshold, double forgetting, const Vector& direction);

  int joints() const { return joints_; }

  // Take a measurement `steps` periods after the last one; `coriolis` is C, (n, n). True: the force is above the
  // threshold.
  bool update(const double* dq, const double* torque, const RigidTerms& terms, const double* coriolis, int steps);

  std::array<double, 6> wrench{};  // on E, in E[A] [N, N m]
  double force = 0.0;              // sudden part against the direction [N]

 private:
  int joints_;
  double gain_, period_, threshold_, forgetting_;
  Vector direction_;
  Matrix axes_;  // of forces, the direction first
  bool started_ = false;
  double baseline_ = 0.0;
  std::vector<double> integral_, residual_, momentum_, momentum_before_, factor_, rows_, right_;
};

// References of one phase at all ticks; t = 6 + k tasks.
struct Phase {
  std::vector<double> position;      // of E, then of the k posture joints, (ticks, 3 + k)
  std::vector<double> velocity;      // of the tasks, (ticks, t)
  std::vector<double> acceleration;  // of the tasks, with friction compensation, (ticks, t)
  std::vector<double> gains;         // k_p of the tasks, (t)
};

// State of the arm in a tick, besides the terms.
struct ArmTick {
  const double *q, *dq;                         // (n)
  const double *bias_acceleration, *origin, *twist;          // dJ/dt dq, origin of E, J dq
  const double* columns;                        // axes of E, one after the other
};

// Feedback and desired accelerations of the tasks.
class TaskLaw {
 public:
  TaskLaw(std::vector<double> motor_inertia, std::vector<int> posture, Phase ante, Phase post,
          std::vector<double> orientation, std::vector<double> wrench, double idle_rate, bool idle);

  int joints() const { return static_cast<int>(motor_inertia_.size()); }
  int tasks() const { return 6 + static_cast<int>(posture_.size()); }
  int rows() const { return static_cast<int>(targets.size()); }

  // One tick; `after`: the post-impact phase, whose wrench is fed forward.
  void decide(int tick, bool after, double gamma, const ArmTick& state, const RigidTerms& terms);

  std::vector<double> feedback;          // a_fb, (t)
  std::vector<double> matrix, targets;   // A and b of the quadratic program, (rows, n) and (rows)
  std::vector<double> inertia;           // M + B_theta, (n, n)

 private:
  std::vector<double> motor_inertia_;
  std::vector<int> posture_;
  Phase phases_[2];
  std::vector<double> orientation_, wrench_;  // R_d (ticks, 3, 3) and f_d (ticks, 6)
  double idle_rate_;
  std::vector<double> factor_, feedforward_;
};

// The quadratic program of a tick, and its minimiser where no limit is near.
class Program {
 public:
  // Limits of the n joints: least and largest position, velocity, torque.
  Program(std::vector<double> low, std::vector<double> high, std::vector<double> fastest, std::vector<double> strongest,
          double period, double regularisation);

  int joints() const { return static_cast<int>(strongest_.size()); }

  // Set up min |A x - b|_W with `rows` rows.
  void set(int rows, const double* tasks, const double* targets, const double* weights, const double* inertia,
           const double* bias, const double* q, const double* dq);

  // Its minimiser without limits, in `x`; false: there is none, or it would break a limit.
  bool free(double* x);

  std::vector<double> hessian, gradient, lower, upper, inertia, torque_lower, torque_upper;

 private:
  std::vector<double> position_low_, position_high_, velocity_, strongest_;
  double per_period_, per_square_, lead_, regularisation_;
  std::vector<double> factor_, weighted_;
};

}  // namespace impact_rs
