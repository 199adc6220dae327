// SPDX-License-Identifier: Apache-2.0
// One impact problem, from the kinematics of the arms to the velocities after the impact.

#pragma once

#include <cmath>
#include <vector>

#include "boxes.hpp"
#include "laws.hpp"

namespace impact_rs {

// Constants set by Python; units in impact_rs_sim/impact_map.
struct Rules {
  double aligned;      // ALIGNED of contacts.py [m]
  double gap;          // GAP_TOLERANCE of contacts.py [m]
  double penetration;  // PENETRATION_TOLERANCE of problem.py [m]
  double compliance;   // COMPLIANCE of laws.py [-]
};

struct ArmState {
  int joints;
  const double* position;   // q, (n)
  const double* velocity;   // dq, (n)
  const double* motor;      // diagonal of B, (n)
  const double* low;        // least q, (n)
  const double* high;       // largest q, (n)
  const double* fastest;    // largest |dq|, (n)
  const double* inertia;    // M, of which the upper triangle is read, (n, n)
  const double* jacobian;   // of frame E in E[A], (6, n)
  const double* origin;      // origin of E in A, (3)
  const double* axes;       // axes of E in A, (3, 3)
  const double* pad_centre;  // middle of the pad in E, (3)
  const double* pad_axes;   // its axes in E, (3, 3)
  const double* pad_half;   // its half extents, (3)
  Shape pad_shape;            // its shape
  int carrier;              // index of the arm whose velocities it has: its own, but for a further pad of a robot
};

struct ObjectState {
  const double* position;  // geometric centre in A, (3)
  const double* axes;      // in A, (3, 3)
  const double* twist;     // (6)
  const double* mass;      // (1); infinite: a fixed body, which no impulse moves
  const double* half;      // half extents, (3)
  const double* moments;   // principal, about the centre of mass, (3)
  const double* offset;    // of the centre of mass, in its axes, (3)
  Shape shape;               // its shape

  bool fixed() const { return std::isinf(*mass); }
};

struct ContactState {
  const double* pad_friction;      // (1)
  const double* support_friction;  // (1)
  const double* restitution;       // (1)
  const double* support;           // centre, then half extents of the support's box in A, (6); null: there is none
  const double* object_friction;   // between objects, (1)
};

enum class Status : char { solved, invalid, unsolved };  // unsound: invalid data, reported by Python

// The laws of one contact point.
struct ContactLaw {
  double friction = 0.0;               // Coulomb coefficient [-]
  double restitution = 0.0;            // of the normal velocity [-]
  double tangential_restitution = 0.0;  // of the sliding velocity [-]
  double drilling_arm = 0.0;           // moment about the normal over the normal impulse, at most [m]
  double rolling_arm = 0.0;            // moment across the normal, likewise [m]
  double spin_restitution = 0.0;       // of the angular velocity about the normal [-]
};

struct Point {
  int partner;  // index of the arm; number of arms: the support; beyond it: the objects
  Vector position, normal, impulse;
  double gap;
  State state;
  ContactLaw law;
  int body = 0;  // index of the object that the impulse acts on
};

class Impact {
 public:
  explicit Impact(const Rules& rules) : rules_(rules) {}

  // Solve one problem; the result is in the members below. Contact points are found by geometry, or given with their
  // laws: those from `begin` to `end`, with impulses near the answer where `resumed`.
  Status solve(const std::vector<ArmState>& arms, const std::vector<ObjectState>& objects, const ContactState& contact,
               const Point* begin = nullptr, const Point* end = nullptr, bool resumed = false);

  std::vector<double> velocity;  // u^+, joints of all arms and the twists of the objects
  std::vector<double> twists;    // of frame E of every arm after the impact, (6) each
  std::vector<Point> points;
  LawResiduals laws;
  double momentum = 0.0;            // |H^-1 (H (u^+ - u^-) - J_c^T L)|
  double energy = 0.0, gain = 0.0;  // kinetic, before and what the impact adds [J]
  int steps = 0;

 private:
  struct Block {  // of H: an arm, or an object
    int start, size;
    std::vector<double> inertia, factor;
  };

  using Arms = std::vector<ArmState>;
  using Objects = std::vector<ObjectState>;

  // One of two bodies in contact: its twist at a point is a Jacobian times its velocities.
  struct Side {
    const double* jacobian;
    int size;  // of its velocities; 0: it does not move
    Vector origin;
    int block;
  };

  bool is_valid(const Arms& arms, const Objects& objects) const;
  bool find_points(const Arms& arms, const Objects& objects, const ContactState& contact);
  bool assemble(const Arms& arms, const Objects& objects);
  void add_object(const ObjectState& object, Block& block);
  Side object_side(const Objects& objects, int number) const;
  Side partner_side(const Arms& arms, const Objects& objects, int partner) const;
  int block_of(const Arms& arms, int partner) const;
  const Point& point_of(int contact) const { return points[turns(contact) ? turning_[contact - points.size()] : contact]; }
  bool turns(int contact) const { return contact >= static_cast<int>(points.size()); }
  void build_root(const Arms& arms);
  void finish(const Arms& arms, const Objects& objects);
  void impulses_to_momenta(const Arms& arms, const Objects& objects, std::vector<double>& momenta);
  void relative_velocities(const Arms& arms, const Objects& objects, const double* of_arms, const double* of_objects,
                           double* found) const;

  Rules rules_;
  Solver solver_;
  Terms terms_;
  std::vector<ManifoldPoint> manifold_;
  std::vector<Vector> origins_;  // origins of E
  std::vector<Block> blocks_;
  std::vector<int> turning_;  // points that resist turning; each is one more contact of the terms
  double length_ = 1.0;       // of turnings, see laws.hpp [m]
  std::vector<double> before_, before_twists_, impulses_, after_, momenta_, work_;
  std::vector<double> object_columns_, arm_columns_;
};

}  // namespace impact_rs
