// SPDX-License-Identifier: Apache-2.0
#include "control.hpp"

#include <algorithm>
#include <utility>

namespace impact_rs {
namespace {

// y = A x, A row by row.
void multiply(const double* a, const double* x, double* y, int rows, int columns) {
  for (int i = 0; i < rows; ++i) {
    double sum = 0.0;
    for (int j = 0; j < columns; ++j) sum += a[i * columns + j] * x[j];
    y[i] = sum;
  }
}

// Solve a x = b in place; false: a is not positive definite, and x stays b.
bool solve(std::vector<double>& a, int n, double* x, int columns) {
  if (!factorise(a.data(), n)) return false;
  forward(a.data(), n, x, columns);
  backward(a.data(), n, x, columns);
  return true;
}

// Solve a x = b in place for a mobility a, (6, 6), three forces first. A row without leverage, or that the rows before
// it explain, is left out, and its x is 0.
void solve_separable(double* a, double* x) {
  const double least = MOVABLE * (a[0] + a[7] + a[14]);
  double own[6];
  for (int i = 0; i < 6; ++i) own[i] = a[7 * i];
  for (int i = 0; i < 6; ++i) {
    if (!(own[i] > least && a[7 * i] > SEPARABLE * own[i])) {
      for (int k = i; k < 6; ++k) a[6 * i + k] = a[6 * k + i] = 0.0;
      a[7 * i] = 1.0;
      x[i] = 0.0;
    }
    for (int k = i + 1; k < 6; ++k) {
      const double share = a[6 * k + i] / a[7 * i];
      for (int j = i; j < 6; ++j) a[6 * k + j] -= share * a[6 * i + j];
      x[k] -= share * x[i];
    }
  }
  for (int i = 5; i >= 0; --i) {
    for (int k = i + 1; k < 6; ++k) x[i] -= a[6 * i + k] * x[k];
    x[i] /= a[7 * i];
  }
}

// Orthonormal axes, row by row, of which the first is n; those of A where n is zero.
Matrix axes_along(const Vector& n) {
  if (!(norm(n) > 0.0)) return {1, 0, 0, 0, 1, 0, 0, 0, 1};
  int least = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(n[i]) < std::abs(n[least])) least = i;
  Vector across{};
  across[least] = 1.0;
  across = cross(n, across);
  across = (1.0 / norm(across)) * across;
  const Vector third = cross(n, across);
  return {n[0], n[1], n[2], across[0], across[1], across[2], third[0], third[1], third[2]};
}

// Rotation vector of a rotation, by its quaternion: exact for small and for large angles.
Vector rotation_vector(const Matrix& r) {
  const double trace = r[0] + r[4] + r[8];
  double w;
  Vector v;
  if (trace > 0.0) {
    const double s = 2.0 * std::sqrt(1.0 + trace);
    w = 0.25 * s;
    v = {(r[7] - r[5]) / s, (r[2] - r[6]) / s, (r[3] - r[1]) / s};
  } else {
    const int i = r[0] >= r[4] && r[0] >= r[8] ? 0 : (r[4] >= r[8] ? 1 : 2), j = (i + 1) % 3, k = (i + 2) % 3;
    const double s = 2.0 * std::sqrt(1.0 + r[4 * i] - r[4 * j] - r[4 * k]);
    v[i] = 0.25 * s;
    v[j] = (r[3 * j + i] + r[3 * i + j]) / s;
    v[k] = (r[3 * k + i] + r[3 * i + k]) / s;
    w = (r[3 * k + j] - r[3 * j + k]) / s;
    if (w < 0.0) {
      w = -w;
      v = -1.0 * v;
    }
  }
  const double sine = norm(v);
  return (sine > 0.0 ? 2.0 * std::atan2(sine, w) / sine : 2.0) * v;
}

Matrix transposed(const double* m) { return {m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]}; }

}  // namespace

Observer::Observer(int joints, double gain, double period, double threshold, double forgetting, const Vector& direction)
    : joints_(joints),
      gain_(gain),
      period_(period),
      threshold_(threshold),
      forgetting_(forgetting),
      direction_(direction),
      axes_(axes_along(direction)),
      residual_(joints, 0.0) {}

bool Observer::update(const double* dq, const double* torque, const RigidTerms& terms, const double* coriolis,
                      int steps) {
  const int n = joints_;
  momentum_before_ = momentum_;
  momentum_.resize(n);
  multiply(terms.inertia, dq, momentum_.data(), n, n);
  if (!started_) {
    integral_ = momentum_before_ = momentum_;
    started_ = true;
  }
  right_.resize(7 * n);
  rows_.resize(6 * n);  // J, its forces along axes_
  for (int i = 0; i < n; ++i) {
    double transposed = 0.0, straight = 0.0;
    for (int j = 0; j < n; ++j) {
      transposed += coriolis[n * j + i] * dq[j];
      straight += coriolis[n * i + j] * dq[j];
    }
    const double known = torque[i] + transposed - (terms.bias[i] - straight);
    for (int left = steps - 1; left >= 0; --left) {  // the momentum is interpolated over periods without a measurement
      const double momentum = momentum_[i] - left * (momentum_[i] - momentum_before_[i]) / steps;
      integral_[i] += period_ * (known + residual_[i]);
      residual_[i] = gain_ * (momentum - integral_[i]);
    }
    const double* column = terms.jacobian + i;
    const Vector along = axes_ * Vector{column[0], column[n], column[2 * n]};
    for (int row = 0; row < 6; ++row) {
      rows_[n * row + i] = row < 3 ? along[row] : column[n * row];
      right_[7 * i + row] = rows_[n * row + i];
    }
    right_[7 * i + 6] = residual_[i];
  }
  factor_.assign(terms.inertia, terms.inertia + n * n);
  solve(factor_, n, right_.data(), 7);  // M^-1 J^T, and of the residual
  std::array<double, 36> mobility{};    // J M^-1 J^T
  wrench.fill(0.0);                     // J M^-1 r
  for (int row = 0; row < 6; ++row)
    for (int i = 0; i < n; ++i) {
      for (int c = 0; c < 6; ++c) mobility[6 * row + c] += rows_[n * row + i] * right_[7 * i + c];
      wrench[row] += rows_[n * row + i] * right_[7 * i + 6];
    }
  solve_separable(mobility.data(), wrench.data());
  const Vector linear = transposed_times(axes_, vector(wrench.data()));
  std::copy_n(linear.data(), 3, wrench.data());
  force = -dot(direction_, linear) - baseline_;
  if (force < threshold_) baseline_ += std::min(1.0, steps * forgetting_) * force;
  return force > threshold_;
}

TaskLaw::TaskLaw(std::vector<double> motor_inertia, std::vector<int> posture, Phase ante, Phase post,
                 std::vector<double> orientation, std::vector<double> wrench, double idle_rate, bool idle)
    : motor_inertia_(std::move(motor_inertia)),
      posture_(std::move(posture)),
      phases_{std::move(ante), std::move(post)},
      orientation_(std::move(orientation)),
      wrench_(std::move(wrench)),
      idle_rate_(idle_rate) {
  const int n = joints(), t = tasks(), all = t + (idle ? n : 0);
  feedback.assign(t, 0.0);
  targets.assign(all, 0.0);
  inertia.assign(n * n, 0.0);
  matrix.assign(all * n, 0.0);
  for (int k = 6; k < t; ++k) matrix[k * n + posture_[k - 6]] = 1.0;
  for (int k = t; k < all; ++k) matrix[k * n + (k - t)] = 1.0;
}

void TaskLaw::decide(int tick, bool after, double gamma, const ArmTick& state, const RigidTerms& terms) {
  const int n = joints(), t = tasks(), posture_tasks = t - 6;
  const Phase& phase = phases_[after];
  const double* position = phase.position.data() + tick * (3 + posture_tasks);
  const double* velocity = phase.velocity.data() + tick * t;
  const double* acceleration = phase.acceleration.data() + tick * t;

  const Matrix axes = transposed(state.columns);
  Matrix desired;
  std::copy_n(orientation_.data() + 9 * tick, 9, desired.begin());
  const Vector tilt = axes * rotation_vector(transposed(axes.data()) * desired);
  for (int i = 0; i < t; ++i) {
    const double error = i < 3   ? position[i] - state.origin[i]
                         : i < 6 ? tilt[i - 3]
                                 : position[i - 3] - state.q[posture_[i - 6]];
    const double moving = i < 6 ? state.twist[i] : state.dq[posture_[i - 6]];
    const double gain = phase.gains[i];
    feedback[i] = 2.0 * std::sqrt(gain) * gamma * (velocity[i] - moving) + gain * error;
    targets[i] = acceleration[i] + feedback[i];
  }
  std::copy_n(terms.inertia, n * n, inertia.data());
  for (int i = 0; i < n; ++i) inertia[i * n + i] += motor_inertia_[i];
  for (int row = 0; row < 6; ++row)
    for (int i = 0; i < n; ++i) matrix[row * n + i] = terms.jacobian[n * row + i];
  if (after) {
    feedforward_.assign(n, 0.0);
    for (int i = 0; i < n; ++i)
      for (int row = 0; row < 6; ++row) feedforward_[i] += terms.jacobian[n * row + i] * wrench_[6 * tick + row];
    factor_ = inertia;
    solve(factor_, n, feedforward_.data(), 1);
    for (int row = 0; row < 6; ++row)  // paper eq. a_p_f
      for (int i = 0; i < n; ++i) targets[row] += terms.jacobian[n * row + i] * feedforward_[i];
    // The same torque moves these joints as well, so posture feedback must not oppose it.
    for (int k = 0; k < posture_tasks; ++k) targets[6 + k] += feedforward_[posture_[k]];
  }
  for (int row = 0; row < 6; ++row) targets[row] -= state.bias_acceleration[row];
  for (int k = t; k < rows(); ++k) targets[k] = -idle_rate_ * state.dq[k - t];
}

Program::Program(std::vector<double> low, std::vector<double> high, std::vector<double> fastest,
                 std::vector<double> strongest, double period, double regularisation)
    : position_low_(std::move(low)),
      position_high_(std::move(high)),
      velocity_(std::move(fastest)),
      strongest_(std::move(strongest)),
      per_period_(1.0 / period),
      per_square_(2.0 / (period * period)),
      lead_(per_square_ * period),
      regularisation_(regularisation) {
  const int n = joints();
  // Bounds of eqs. const_q and const_dq are linear in q and dq; their constants are worked out once.
  for (int i = 0; i < n; ++i) {
    position_low_[i] *= per_square_;
    position_high_[i] *= per_square_;
    velocity_[i] *= per_period_;
  }
  for (auto* row : {&gradient, &lower, &upper, &torque_lower, &torque_upper}) row->assign(n, 0.0);
  for (auto* square : {&hessian, &inertia}) square->assign(n * n, 0.0);
}

void Program::set(int rows, const double* tasks, const double* targets, const double* weights, const double* mass,
                  const double* bias, const double* q, const double* dq) {
  const int n = joints();
  std::fill(hessian.begin(), hessian.end(), 0.0);
  std::fill(gradient.begin(), gradient.end(), 0.0);
  for (int k = 0; k < rows; ++k) {
    const double* row = tasks + k * n;
    for (int i = 0; i < n; ++i) {
      const double weighted = weights[k] * row[i];
      gradient[i] -= weighted * targets[k];
      for (int j = 0; j <= i; ++j) hessian[i * n + j] += weighted * row[j];
    }
  }
  for (int i = 0; i < n; ++i) {
    hessian[i * n + i] += regularisation_;
    for (int j = 0; j < i; ++j) hessian[j * n + i] = hessian[i * n + j];
    const double position = q[i] * per_square_ + dq[i] * lead_, velocity = dq[i] * per_period_;
    upper[i] = std::min(position_high_[i] - position, velocity_[i] - velocity);
    lower[i] = std::max(position_low_[i] - position, -velocity_[i] - velocity);
    torque_lower[i] = -strongest_[i] - bias[i];
    torque_upper[i] = strongest_[i] - bias[i];
  }
  inertia.assign(mass, mass + n * n);
}

bool Program::free(double* x) {
  const int n = joints();
  for (int i = 0; i < n; ++i) x[i] = -gradient[i];
  factor_ = hessian;
  if (!solve(factor_, n, x, 1)) return false;
  for (int i = 0; i < n; ++i) {  // written so that NaN fails the test
    double torque = 0.0;
    for (int j = 0; j < n; ++j) torque += inertia[i * n + j] * x[j];
    if (!(x[i] >= lower[i] && x[i] <= upper[i] && torque >= torque_lower[i] && torque <= torque_upper[i])) return false;
  }
  return true;
}

}  // namespace impact_rs
