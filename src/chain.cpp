// SPDX-License-Identifier: Apache-2.0
#include "chain.hpp"

#include <algorithm>
#include <utility>

namespace impact_rs {
Chain::Chain(std::vector<Joint> joints, std::vector<Link> links, const Vector& gravity, const Vector& tip)
    : joints_(std::move(joints)),
      links_(std::move(links)),
      gravity_(gravity),
      tip_(tip),
      axes_(joints_.size()),
      inertias_(joints_.size()),
      end_{},
      last_{},
      velocities_(joints_.size()),
      forces_(joints_.size()) {}

Spatial Chain::times(const SpatialInertia& body, const Spatial& motion) {
  return {body.inertia * motion.angular + cross(body.moment, motion.linear),
          body.mass * motion.linear + cross(motion.angular, body.moment)};
}

void Chain::update_kinematics(const double* q) {
  Matrix rotation = IDENTITY;
  Vector origin{};
  for (std::size_t i = 0; i < joints(); ++i) {
    origin = origin + rotation * joints_[i].origin;
    rotation = rotation * joints_[i].rotation;
    const Vector z = column(rotation, 2);
    if (joints_[i].prismatic) {
      origin = origin + q[i] * z;
      axes_[i] = {Vector{}, z};
    } else {
      const Vector x = column(rotation, 0), y = column(rotation, 1);
      const double c = std::cos(q[i]), s = std::sin(q[i]);
      for (int row = 0; row < 3; ++row) {
        rotation[3 * row] = c * x[row] + s * y[row];
        rotation[3 * row + 1] = c * y[row] - s * x[row];
      }
      axes_[i] = {z, cross(origin, z)};
    }
    const Vector com = origin + rotation * links_[i].com;
    SpatialInertia& body = inertias_[i];
    body.mass = links_[i].mass;
    body.moment = body.mass * com;
    body.inertia = rotation * links_[i].inertia * transposed(rotation);
    const double square = dot(com, com);
    for (int row = 0; row < 3; ++row) {
      for (int j = 0; j < 3; ++j) body.inertia[3 * row + j] -= body.mass * com[row] * com[j];
      body.inertia[4 * row] += body.mass * square;
    }
  }
  end_ = origin + rotation * tip_;
  last_ = rotation;
}

void Chain::equations(const double* dq, const double* tau, double* mass, double* net_torque) {
  const int n = static_cast<int>(joints());
  Spatial velocity{}, acceleration{Vector{}, -1.0 * gravity_};
  for (int i = 0; i < n; ++i) {
    const Spatial own = dq[i] * axes_[i];
    velocity = velocity + own;
    acceleration = acceleration + cross_motion(velocity, own);
    forces_[i] = times(inertias_[i], acceleration) + cross_force(velocity, times(inertias_[i], velocity));
  }
  Spatial force{};
  SpatialInertia composite{};  // all links from this one on
  for (int i = n - 1; i >= 0; --i) {
    force = force + forces_[i];
    net_torque[i] = tau[i] - dot(axes_[i], force);
    composite.mass += inertias_[i].mass;
    composite.moment = composite.moment + inertias_[i].moment;
    for (int k = 0; k < 9; ++k) composite.inertia[k] += inertias_[i].inertia[k];
    const Spatial moved = times(composite, axes_[i]);
    for (int j = 0; j <= i; ++j) mass[i * n + j] = dot(axes_[j], moved);
  }
}

void Chain::momentum(const double* q, const double* dq, double* momentum, double* known, double* twist) {
  const int n = static_cast<int>(joints());
  update_kinematics(q);
  Spatial velocity{};
  for (int i = 0; i < n; ++i) {
    velocities_[i] = velocity;  // of the link before
    velocity = velocity + dq[i] * axes_[i];
    forces_[i] = times(inertias_[i], velocity);
  }
  Spatial moved{}, weight{};  // momentum and weight of all links from this one on
  for (int i = n - 1; i >= 0; --i) {
    moved = moved + forces_[i];
    weight = weight + Spatial{cross(inertias_[i].moment, gravity_), inertias_[i].mass * gravity_};
    momentum[i] = dot(axes_[i], moved);
    // Rotating the joint rotates all later links, as if the link before rotated the other way.
    known[i] = dot(cross_motion(velocities_[i], axes_[i]), moved) + dot(axes_[i], weight);
  }
  const Vector speed = velocity.linear + cross(velocity.angular, end_);
  std::copy(speed.begin(), speed.end(), twist);
  std::copy(velocity.angular.begin(), velocity.angular.end(), twist + 3);
}

}  // namespace impact_rs
