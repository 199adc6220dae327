// SPDX-License-Identifier: Apache-2.0
// The twin: arms with drives, objects and their support, from a measured state under recorded torque. Equations and step
// method in docs/physics.md, "The twin".

#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "twin_arm.hpp"
#include "twin_step.hpp"

namespace impact_rs {

struct BoxModel {
  double mass;     // [kg]; infinite: the box is fixed
  Vector half;     // half extents [m]
  Vector inertia;  // principal moments about the centre of mass [kg m^2]
  Vector offset;   // centre of mass from the middle, in axes of the box [m]
  Shape shape;       // its shape; half extents are those of its bounding box
  std::optional<Spatial> guide;  // motion of its middle at unit speed of hinge or slide, in its own axes
};

struct SupportModel {
  double height;       // of its surface in A, below the object that stands on it [m]
  double half_x, half_y;  // half extents [m]
  double friction;     // [-]
  double compliance;   // 0: rigid [m/N]
};

// What does not change over a simulation.
struct TwinModel {
  std::vector<ArmModel> arms;
  std::vector<BoxModel> boxes;  // the object, then its neighbours; only the object may be fixed, or, alone, have a guide
  std::optional<SupportModel> support;
  double pad_friction;  // [-]
  double box_friction;  // between objects [-]
  double rolling_arm;   // [m]
  Vector gravity;       // [m/s^2]
  double period;        // of the torque loop [s]
  int refinement;       // steps in a period in which a pad hits the object
  std::vector<FormulaLoad> formulas;  // on the object, and between it and the support
};

struct BoxStart {
  Vector centre;     // [m]
  Matrix rotation;
  Vector velocity;   // of the centre [m/s]
  Vector angular;    // [rad/s]
};

struct TwinStart {
  std::vector<ArmStart> arms;
  std::vector<BoxStart> boxes;  // empty: the arms are alone
};

// Joint torques of an arm in the order in which they act, (m, n), and the row for every period. Not owned.
struct TorqueInput {
  const double* torques;
  const int* row_by_period;
};

// Ticks of an open-loop run and its torques.
struct TorqueTrajectory {
  std::vector<double> time;  // ticks [s]
  int substeps;              // periods of the torque loop from tick to tick
  std::vector<TorqueInput> arms;
};

// How well the steps were solved.
struct TwinReport {
  std::int64_t steps = 0, contact_steps = 0, iterations = 0, fallbacks = 0;
  double residual = 0.0;       // largest of all steps [m/s]
  std::vector<double> failed;  // times of the steps that were not solved [s]
};

// Resultant contact force of a partner on the object in the last step, and where it acts.
struct ContactResultant {
  double force = 0.0;        // normal, on the object; 0: no contact [N]
  double penetration = 0.0;  // mean over its points, weighted with their forces [m]
  double closing = 0.0, slip = 0.0;  // rate of the penetration, and sliding speed of the object there [m/s]
  double onset = -1.0;       // time of the first contact; negative: none yet [s]
  Vector position{}, normal{};  // of the force; into the object
  Vector along{};            // direction of sliding, shorter where it is slow
};

constexpr std::size_t BOX_ROW = 13;  // numbers of a box in a row

class Twin {
 public:
  Twin(const TwinModel& model, const TwinStart& start);

  // Numbers of a state: q, dq, tau_J, theta, dtheta (n each) of every arm; then middle, quaternion x y z w, velocity of
  // the middle and angular velocity of every box. The quaternion has the sign nearer to that of
  // `before` (a state as well), unless that is null.
  std::size_t state_size() const;
  void state(double* out, const double* before) const;

  // States at all ticks of a trajectory, (ticks, row()).
  void run(const TorqueTrajectory& trajectory, double* out);

  // One tick from `time` [s]: `substeps` periods with a desired torque by arm. False: a state is not finite.
  bool tick(double time, int substeps, const std::vector<const double*>& torques);

  // Whether all boxes rest on their support without a contact with arms.
  bool asleep() const {
    return !bodies_.empty() && std::none_of(bodies_.begin(), bodies_.end(), [](const RigidBody& one) { return one.awake; });
  }

  // Force of the boxes on the pad of an arm in the last step [N].
  const Vector& pad_force(int arm) const { return pad_forces_[arm]; }

  const TwinReport& report() const { return report_; }

 private:
  // State of a box: centre of mass, axes, velocities; angular momentum about the centre of mass.
  struct RigidBody {
    const BoxModel& model;
    bool fixed, awake;
    double mass;  // or what stands in its place [kg]
    Vector centre{}, velocity{}, angular{}, momentum{};
    Matrix rotation;
    int offset = 0;  // of its velocities among the unknowns of a step

    // On a hinge or slide: travel along it from the pose at the start, speed, and inertia s^T M s.
    double travel = 0.0, speed = 0.0, guided_inertia = 0.0;
    Vector first_centre{};
    Matrix first_rotation;

    explicit RigidBody(const BoxModel& box);
    ConvexBody geometry() const { return {centre - rotation * model.offset, rotation, model.half, model.shape}; }
    Matrix inertia() const;
    Spatial guide_motion() const;  // of the centre of mass at unit speed of hinge or slide
    void integrate_guide(double length);
  };

  // A contact pair: a box and an arm, the support, or a box before it.
  struct Pair {
    int box, arm, other;  // -1: it is another one
  };

  void set_state(RigidBody& body, const BoxStart& start);
  bool in_equilibrium(const RigidBody& body);
  void update_loads(double time);
  void advance_period(double time);
  bool find_contacts();  // whether a pad hits an object faster than a step of a period resolves
  void find_pad_contacts(int number);
  bool find_object_contacts(int number);
  void find_support_contacts(int number);
  void step(double length, double time);
  void update_symbols(double time);
  const ContactResultant& object_on_support() const { return resultants_[arms_.size()]; }
  void apply_formulas(double time);
  void contact_step(double velocity_step, double time);
  void assemble_arm(const Partner& partner, const TwinArm& arm);
  void assemble_object(RigidBody& body, const Vector& force, const Vector& moment);
  void assemble_guided(const RigidBody& body, const Vector& force, const Vector& moment);
  void record_resultant(std::size_t partner, double time);
  void set_contact_laws(std::size_t partner, double velocity_step);
  void set_shear_law(std::size_t partner);
  void update_shear(std::size_t partner);
  void warm_start();
  bool any_awake() const;
  ConvexBody support_box(const RigidBody& body) const;
  bool is_finite() const;

  const TwinModel& model_;
  TwinReport report_;
  std::vector<TwinArm> arms_;
  std::vector<RigidBody> bodies_;  // empty: the arms are alone
  std::vector<Pair> pairs_;    // by number: of every box the arms, then the support; then boxes with boxes before them
  double last_;  // length of the step before [s]
  std::int64_t periods_ = 0;  // of the torque loop so far

  // Change of the velocities in the step before and its length, as a first guess while the partners are the same.
  std::vector<double> change_;
  std::vector<int> partners_before_;
  double velocity_step_before_ = 1.0;

  // Contacts of this step. Partners are numbers of pairs.
  std::vector<ManifoldPoint> manifold_;
  std::vector<int> partners_;
  std::vector<std::vector<double>> motions_;  // by pair
  std::vector<Vector> pad_forces_;            // by arm
  std::vector<std::vector<Guess>> guesses_;   // by pair and point, of the step before
  StepSolver solver_;

  // Formulas: contact resultants, and force and moment about its centre of mass that act on the object.
  bool formulas_act_;
  Memory memory_;                   // of those of the object
  std::vector<ContactResultant> resultants_;  // by pair
  std::vector<double> symbols_;     // of the object
  Vector force_{}, moment_{};

  // Shear law of a pad in this step.
  struct PadShear {
    Vector centre{};              // of the load, from the object's centre of mass [m]
    std::vector<double> weights;  // share of the load by point
    double lag = 0.0;             // time constant of the damper [s]
    bool compliant = false;
  };
  std::vector<PadShear> pad_shears_;  // by arm
};

}  // namespace impact_rs
