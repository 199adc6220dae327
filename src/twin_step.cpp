// SPDX-License-Identifier: Apache-2.0
#include "twin_step.hpp"

#include <algorithm>

namespace impact_rs {

namespace {

constexpr int NEWTON_STEPS = 8;                 // two are usual
constexpr int ROUNDS = 60;                      // of fixed and released friction limits
constexpr int EARLY_ROUNDS = 6;                 // of them, for a guess only
constexpr int CONVEX_STEPS = 60;                // of Newton's method with fixed friction limits
constexpr double FIXED_LIMIT_TOLERANCE = 1e-6;  // m/s, of such a guess
constexpr std::array<double, 6> EVERY_WAY{1.0, 1.0, 1.0, 1.0, 1.0, 1.0};

}  // namespace

// Twist of the object against a partner, about its centre of mass.
void StepSolver::twist_against(const Partner& partner, const std::vector<double>& x, double* twist) const {
  for (int i = 0; i < 6; ++i) twist[i] = guided ? along[i] * x[partner.object] : x[partner.object + i];
  for (int j = 0; j < partner.joints; ++j)
    for (int i = 0; i < 6; ++i) twist[i] -= partner.motions[6 * j + i] * x[partner.offset + j];
}

void StepSolver::evaluate(const std::vector<double>& x, bool with_derivative) {
  const int n = size;
  const auto multiply = [&](int first, int count) {  // a block of A
    for (int i = first; i < first + count; ++i) {
      double sum = -impulse[i];
      for (int j = first; j < first + count; ++j) sum += mass[i * n + j] * x[j];
      residual_[i] = sum;
    }
  };
  for (const Partner& partner : partners)
    if (partner.joints > 0) multiply(partner.offset, partner.joints);
  for (const int object : objects) multiply(object, freedoms());
  const std::array<double, 6>& ways = guided ? along : EVERY_WAY;  // of the object's unknowns, which are `next` apart
  const int next = guided ? 0 : 1;
  if (with_derivative) std::copy(mass.begin(), mass.end(), matrix_.begin());
  wrenches_.assign(6 * partners.size(), 0.0);
  for (std::size_t k = 0; k < partners.size(); ++k) {
    const Partner& partner = partners[k];
    const int o = partner.object;
    double twist[6];
    twist_against(partner, x, twist);
    double* wrench = &wrenches_[6 * k];
    Matrix6 z{};
    const Vector angular = vector(twist), linear = vector(twist + 3);
    bool loaded = false;
    for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
      const double fixed_load = limits_fixed_ ? fixed_loads_[i] : -1.0;
      normal_forces_[i] = with_derivative ? add_linear_contact(points[i], lengths, angular, linear, fixed_load, guesses[i],
                                                               wrench, z, forces_[i])
                                          : add_contact(points[i], lengths, angular, linear, fixed_load, wrench);
      loaded = loaded || normal_forces_[i] > 0.0 || fixed_load > 0.0;
    }
    if (!loaded) continue;
    for (int i = 0; i < 6 && !fixed; ++i) residual_[o + next * i] -= ways[i] * velocity_step * wrench[i];
    for (int j = 0; j < partner.joints; ++j) {
      double sum = 0.0;
      for (int i = 0; i < 6; ++i) sum += partner.motions[6 * j + i] * wrench[i];
      residual_[partner.offset + j] += velocity_step * sum;
    }
    if (!with_derivative) continue;
    for (int i = 0; i < 6 && !fixed; ++i)
      for (int j = 0; j < 6; ++j)
        matrix_[(o + next * i) * n + o + next * j] += ways[i] * ways[j] * velocity_step * z[6 * i + j];
    product_.resize(6 * partner.joints);
    for (int j = 0; j < partner.joints; ++j) {
      const double* own = partner.motions + 6 * j;
      for (int i = 0; i < 6; ++i) {
        double right = 0.0, left = 0.0;  // of z s and s^T z
        for (int l = 0; l < 6; ++l) {
          right += z[6 * i + l] * own[l];
          left += own[l] * z[6 * l + i];
        }
        product_[6 * j + i] = velocity_step * right;
        if (fixed) continue;
        matrix_[(o + next * i) * n + partner.offset + j] -= ways[i] * velocity_step * right;
        matrix_[(partner.offset + j) * n + o + next * i] -= ways[i] * velocity_step * left;
      }
    }
    for (int i = 0; i < partner.joints; ++i)
      for (int j = 0; j < partner.joints; ++j) {
        double sum = 0.0;
        for (int l = 0; l < 6; ++l) sum += partner.motions[6 * i + l] * product_[6 * j + l];
        matrix_[(partner.offset + i) * n + partner.offset + j] += sum;
      }
  }
}

double StepSolver::residual() const {
  double sum = 0.0;
  for (int i = 0; i < size; ++i) sum += residual_[i] * residual_[i] / mass[i * size + i];
  return std::sqrt(sum / object_mass);
}

// Newton step by elimination; false: the equations are singular.
bool StepSolver::newton_step() {
  step_ = residual_;
  ++iterations_;
  return eliminate(matrix_.data(), step_.data(), size);
}

// Newton's method from `velocity`, which is restored if it does not converge.
bool StepSolver::newton(bool augmented, bool as_before) {
  before_ = velocity;
  for (int k = 0; k < NEWTON_STEPS; ++k) {
    for (Guess& guess : guesses) {
      guess.augmented = augmented;
      guess.as_before = as_before && k == 0;
    }
    evaluate(velocity, true);
    if (!newton_step()) break;
    for (int i = 0; i < size; ++i) velocity[i] -= step_[i];
    update_guesses();
    evaluate(velocity, false);
    if (residual() < STEP_TOLERANCE) return true;
  }
  velocity = before_;
  evaluate(velocity, false);
  return false;
}

// Friction that the linear laws of the last step of Newton's method have after it.
void StepSolver::update_guesses() {
  for (const Partner& partner : partners) {
    double twist[6];
    twist_against(partner, velocity, twist);
    for (std::size_t i = partner.first; i < partner.first + partner.count; ++i) {
      const LinearForce& own = forces_[i];
      const Vector moved = vector(twist + 3) + cross(vector(twist), points[i].position) - own.velocity;
      const Vector force = own.force - own.derivative * moved;
      guesses[i].friction = force + -dot(force, points[i].normal) * points[i].normal;
    }
  }
}

// Derivative of the convex function along the step, at a fraction of it.
double StepSolver::slope(double fraction) {
  for (int i = 0; i < size; ++i) trial_[i] = velocity[i] - fraction * step_[i];
  evaluate(trial_, false);
  double sum = 0.0;
  for (int i = 0; i < size; ++i) sum -= step_[i] * residual_[i];
  return sum;
}

// The minimum for friction limited by the normal forces at the present velocities.
void StepSolver::fix_friction_limits(double tolerance) {
  for (Guess& guess : guesses) guess.augmented = guess.as_before = false;
  fixed_loads_ = normal_forces_;
  limits_fixed_ = true;
  for (int k = 0; k < CONVEX_STEPS; ++k) {
    evaluate(velocity, true);
    if (!(residual() > tolerance) || !newton_step()) break;
    double first = 0.0;
    for (int i = 0; i < size; ++i) first -= step_[i] * residual_[i];
    double fraction = 1.0, low = 0.0, high = 1.0, at_low = first, at_high = slope(1.0);
    if (at_high > -1e-3 * first) {  // beyond the minimum along the step: there by regula falsi and halving
      for (int tries = 0; tries < 30; ++tries) {
        fraction = tries % 3 == 2 ? 0.5 * (low + high) : low - at_low * (high - low) / (at_high - at_low);
        const double at = slope(fraction);
        if (std::abs(at) < 1e-2 * std::abs(first)) break;
        (at > 0.0 ? high : low) = fraction;
        (at > 0.0 ? at_high : at_low) = at;
      }
    }
    for (int i = 0; i < size; ++i) velocity[i] -= fraction * step_[i];
  }
  limits_fixed_ = false;
  evaluate(velocity, true);
  for (std::size_t i = 0; i < points.size(); ++i)
    guesses[i].friction = forces_[i].force + -dot(forces_[i].force, points[i].normal) * points[i].normal;
  evaluate(velocity, false);
}

// Newton's method; if it does not converge, again from the solution with fixed friction limits, updated round by round.
// These rounds converge by themselves where friction and normal forces are weakly coupled.
Solution StepSolver::solve() {
  iterations_ = 0;
  residual_.resize(size);
  matrix_.resize(size * size);
  trial_.resize(size);
  normal_forces_.resize(points.size());
  forces_.resize(points.size());
  bool solved = newton(true, true);
  const bool fallback = !solved;
  for (int round = 0; round < ROUNDS && !solved; ++round) {
    fix_friction_limits(round < EARLY_ROUNDS ? FIXED_LIMIT_TOLERANCE : 0.1 * STEP_TOLERANCE);
    solved = residual() < STEP_TOLERANCE || newton(true, false) || newton(false, false);
  }
  return {residual(), iterations_, fallback, solved};
}

}  // namespace impact_rs
