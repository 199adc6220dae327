// SPDX-License-Identifier: Apache-2.0
// Serial chain of rigid links on a fixed base, evaluated thousands of times in a simulation of recorded runs.
//
// Recursive Newton-Euler and composite rigid bodies (Featherstone, Rigid Body Dynamics Algorithms, tables 5.1 and 6.2),
// with every spatial vector in axes of A about the origin of A, so that no transforms between links are needed.

#pragma once

#include <vector>

#include "dense.hpp"

namespace impact_rs {

struct Joint {
  Matrix rotation;  // axes and
  Vector origin;    // position [m] in the link before, of the first joint in A
  bool prismatic;      // along its z; else it turns about that
};

struct Link {
  double mass;     // [kg]
  Vector com;      // in the frame of its joint [m]
  Matrix inertia;  // about the centre of mass, in axes of that frame [kg m^2]
};

// A motion (angular velocity, velocity of the point at the origin) or a force (moment about the origin, force).
struct Spatial {
  Vector angular, linear;
};

inline Spatial operator+(const Spatial& a, const Spatial& b) { return {a.angular + b.angular, a.linear + b.linear}; }
inline Spatial operator*(double s, const Spatial& a) { return {s * a.angular, s * a.linear}; }

// Power of a force along a motion.
inline double dot(const Spatial& motion, const Spatial& force) {
  return dot(motion.angular, force.angular) + dot(motion.linear, force.linear);
}

// Spatial cross product of two motions.
inline Spatial cross_motion(const Spatial& by, const Spatial& motion) {
  return {cross(by.angular, motion.angular), cross(by.angular, motion.linear) + cross(by.linear, motion.angular)};
}

// Spatial cross product of a motion and a momentum (or force).
inline Spatial cross_force(const Spatial& by, const Spatial& momentum) {
  return {cross(by.angular, momentum.angular) + cross(by.linear, momentum.linear), cross(by.angular, momentum.linear)};
}

class Chain {
 public:
  // `tip` is the origin of the end effector in the frame of the last joint [m].
  Chain(std::vector<Joint> joints, std::vector<Link> links, const Vector& gravity, const Vector& tip);

  std::size_t joints() const { return joints_.size(); }

  // Axes, bodies and tip at these joint positions; the next four are about them.
  void update_kinematics(const double* q);

  // M in the lower triangle of (n, n), row by row, and tau - h.
  void equations(const double* dq, const double* tau, double* mass, double* net_torque);

  const Spatial& axis(int joint) const { return axes_[joint]; }  // motion at unit speed, about the origin of A
  const Vector& end() const { return end_; }                     // the tip in A [m]
  const Matrix& last_joint_axes() const { return last_; }           // of the last joint in A

  // M dq and C^T dq - g (n), and the twist of the tip about itself (6): linear, then angular.
  void momentum(const double* q, const double* dq, double* momentum, double* known, double* twist);

 private:
  // Spatial inertia about the origin.
  struct SpatialInertia {
    double mass;
    Vector moment;   // m c
    Matrix inertia;  // about the origin
  };

  static Spatial times(const SpatialInertia& body, const Spatial& motion);

  std::vector<Joint> joints_;
  std::vector<Link> links_;
  Vector gravity_;
  Vector tip_;

  std::vector<Spatial> axes_;  // of the joints: motion at unit speed
  std::vector<SpatialInertia> inertias_;
  Vector end_;
  Matrix last_;
  std::vector<Spatial> velocities_, forces_;
};

}  // namespace impact_rs
