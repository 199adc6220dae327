// SPDX-License-Identifier: Apache-2.0
#include "twin_contact.hpp"

#include <algorithm>

namespace impact_rs {

namespace {

// Projection of a force onto a disc of radius `bound`, and the derivatives of the projection.
struct Projection {
  Vector force;
  Vector along;    // unit vector of a force on the rim, else zero
  double stretch;  // derivative across `along`; of a force inside the disc, in every direction
};

Projection onto_disc(const Vector& trial, double bound) {
  const double size = norm(trial);
  if (size <= bound) return {trial, {}, 1.0};
  const Vector along = (1.0 / size) * trial;
  return {bound * along, along, bound / size};
}

// z += [[-[r] G [r], [r] G], [-G [r], G]] with G the 3 x 3 derivative of a force at r by the velocity there.
void add_at(const Vector& r, const Matrix& g, Matrix6& z) {
  Matrix turned;  // G [r]
  for (int i = 0; i < 3; ++i) {
    turned[3 * i] = g[3 * i + 1] * r[2] - g[3 * i + 2] * r[1];
    turned[3 * i + 1] = g[3 * i + 2] * r[0] - g[3 * i] * r[2];
    turned[3 * i + 2] = g[3 * i] * r[1] - g[3 * i + 1] * r[0];
  }
  for (int j = 0; j < 3; ++j) {
    const Vector linear = column(g, j), angular = column(turned, j);
    const Vector moment = cross(r, linear), turning = cross(r, angular);
    for (int i = 0; i < 3; ++i) {
      z[6 * i + j] -= turning[i];
      z[6 * i + 3 + j] += moment[i];
      z[6 * (3 + i) + j] -= angular[i];
      z[6 * (3 + i) + 3 + j] += linear[i];
    }
  }
}

// Normal speed that a rigid point is stopped at: an open one may close, a fifth of an overlap is removed in a step.
double free_speed(const ContactPoint& point, const StepLengths& lengths) {
  return (point.gap > 0.0 ? -1.0 : -0.2) * point.gap / lengths.now;
}

}  // namespace

NormalForce normal_force(const ContactPoint& point, const StepLengths& lengths, double speed) {
  if (point.rigid) {
    const double force = point.rigid_damping * (free_speed(point, lengths) - speed);
    return force > 0.0 ? NormalForce{force, point.rigid_damping} : NormalForce{0.0, 0.0};
  }
  // Depths a step before, now and after the step. The spring's force is its work over the travel between the first and the
  // last, so that no energy is lost or made, whenever in the step the contact begins or ends.
  const double before = lengths.before * point.speed - point.gap, after = -point.gap - lengths.now * speed;
  const double deep_before = std::max(before, 0.0), deep = std::max(-point.gap, 0.0), deep_after = std::max(after, 0.0);
  const double travel = after - before, k = point.stiffness, d = point.damping;
  double force, slope;
  if (std::abs(travel) > 1e-14) {
    force = 0.5 * k * (deep_after + deep_before) * ((deep_after - deep_before) / travel);
    slope = (k * deep_after - force) / travel;
  } else {
    force = k * deep_before;
    slope = before > 0.0 ? 0.5 * k : 0.0;
  }
  force += d * (point.implicit * (deep_after - deep) / lengths.now +
                (1.0 - point.implicit) * (deep - deep_before) / lengths.before);
  if (after > 0.0) slope += d * point.implicit / lengths.now;
  return force > 0.0 ? NormalForce{force, slope * lengths.now} : NormalForce{0.0, 0.0};
}

double add_contact(const ContactPoint& point, const StepLengths& lengths, const Vector& angular,
                   const Vector& linear, double fixed_load, double* wrench) {
  const Vector &r = point.position, &n = point.normal;
  const Vector u = linear + cross(angular, r);
  const double speed = dot(n, u), normal = normal_force(point, lengths, speed).force;
  const double load = fixed_load < 0.0 ? normal : fixed_load;
  if (load <= 0.0 && normal <= 0.0) return 0.0;
  const Vector trial = -point.stick_damping * (u + -speed * n) + -1.0 * point.friction_offset;
  const Vector force = normal * n + onto_disc(trial, point.friction * load).force;
  Vector moment = cross(r, force);
  if (point.rolling_arm > 0.0)
    moment = moment + onto_disc(-point.rolling_damping * (angular + -dot(n, angular) * n), point.rolling_arm * load).force;
  for (int i = 0; i < 3; ++i) {
    wrench[i] += moment[i];
    wrench[3 + i] += force[i];
  }
  return normal;
}

double add_linear_contact(const ContactPoint& point, const StepLengths& lengths, const Vector& angular,
                          const Vector& linear, double fixed_load, const Guess& guess, double* wrench,
                          Matrix6& derivative, LinearForce& own) {
  const Vector &r = point.position, &n = point.normal;
  const Vector u = linear + cross(angular, r);
  const double speed = dot(n, u);
  NormalForce normal = normal_force(point, lengths, speed);
  const bool coulomb = fixed_load < 0.0, assumes = guess.as_before && point.rigid && guess.normal_force >= 0.0;
  double load = coulomb ? normal.force : fixed_load;
  if (assumes) {
    load = guess.normal_force;
    normal = load > 0.0 ? NormalForce{point.rigid_damping * (free_speed(point, lengths) - speed), point.rigid_damping}
                        : NormalForce{0.0, 0.0};
  }
  own = {{}, u, {}};
  if (load <= 0.0 && normal.force <= 0.0) return 0.0;

  const double rho = guess.augmented ? point.augmented : 1.0, bound = point.friction * load;
  const Vector trial = -point.stick_damping * (u + -speed * n) + -1.0 * point.friction_offset;
  const Vector augmented_trial = rho * trial + (1.0 - rho) * guess.friction;
  const double size = norm(augmented_trial);
  Vector along{}, friction = trial;
  double across = point.stick_damping;
  if (size > bound) {
    along = (1.0 / size) * augmented_trial;
    const double share = bound / size, kept = share * rho / (1.0 - share * (1.0 - rho));
    friction = (coulomb ? point.friction * normal.force : bound) * along + kept * (trial + -dot(along, trial) * along);
    across = kept * point.stick_damping;
  }
  const double grows = coulomb ? point.friction * normal.slope : 0.0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      own.derivative[3 * i + j] = (normal.slope * n[i] + grows * along[i]) * n[j] +
                                  across * ((i == j ? 1.0 : 0.0) - n[i] * n[j] - along[i] * along[j]);
  own.force = normal.force * n + friction;
  add_at(r, own.derivative, derivative);
  const Vector moment = cross(r, own.force);
  for (int i = 0; i < 3; ++i) {
    wrench[i] += moment[i];
    wrench[3 + i] += own.force[i];
  }
  if (point.rolling_arm > 0.0) {
    const Projection rolling =
        onto_disc(-point.rolling_damping * (angular + -dot(n, angular) * n), point.rolling_arm * load);
    const double turns = rolling.stretch * point.rolling_damping, more = coulomb ? point.rolling_arm * normal.slope : 0.0;
    const Vector arm = cross(r, n);  // d speed / d angular velocity
    for (int i = 0; i < 3; ++i) {
      wrench[i] += rolling.force[i];
      for (int j = 0; j < 3; ++j) {
        derivative[6 * i + j] += turns * ((i == j ? 1.0 : 0.0) - n[i] * n[j] - rolling.along[i] * rolling.along[j]) +
                                 more * rolling.along[i] * arm[j];
        derivative[6 * i + 3 + j] += more * rolling.along[i] * n[j];
      }
    }
  }
  return normal.force;
}

}  // namespace impact_rs
