// SPDX-License-Identifier: Apache-2.0
// The twin: arms with drives, a box and its support, from a measured state under recorded torque. Equations and step
// method in docs/physics.md, "The twin".

#pragma once

#include "twin_arm.hpp"
#include "twin_step.hpp"

namespace impact_rs {

struct BoxModel {
  double mass;     // [kg]; infinite: the box is fixed
  Vector half;     // half extents [m]
  Vector inertia;  // principal moments about the centre of mass [kg m^2]
  Vector offset;   // centre of mass from the middle, in axes of the box [m]
  Form form;       // its shape; half extents are those of its bounding box
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
  BoxModel box;
  std::optional<SupportModel> support;
  double pad_friction;  // [-]
  double rolling_arm;   // [m]
  Vector gravity;       // [m/s^2]
  double period;        // of the torque loop [s]
  int refinement;       // steps in a period in which a pad meets the object
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
  std::optional<BoxStart> box;  // none: the arms are alone
};

// Driving torques of an arm in the order in which they act, (m, n), and the row that acts in every period. The caller's.
struct Driving {
  const double* torques;
  const int* acting;
};

// Ticks and torques of a run that are known beforehand.
struct Course {
  std::vector<double> time;  // ticks [s]
  int substeps;              // periods of the torque loop from tick to tick
  std::vector<Driving> arms;
};

// How well the steps were solved.
struct TwinReport {
  long steps = 0, contact_steps = 0, iterations = 0, fallbacks = 0;
  double residual = 0.0;       // largest of all steps [m/s]
  std::vector<double> failed;  // times of the steps that were not solved [s]
};

// How the object touched a partner in the last step.
struct Touching {
  double force = 0.0;        // normal, on the object; 0: it does not touch [N]
  double penetration = 0.0;  // mean over its points, weighted with their forces [m]
  double closing = 0.0, slip = 0.0;  // rate of the penetration, and sliding speed of the object there [m/s]
  double begin = -1.0;       // time of the first touch; negative: none yet [s]
  Vector place{}, normal{};  // of the force; into the object
  Vector along{};            // direction of sliding, shorter where it is slow
};

constexpr std::size_t BOX_ROW = 13;  // numbers of the box in a row

class Twin {
 public:
  Twin(const TwinModel& model, const TwinStart& start);

  // Numbers of a state: q, dq, tau_J, theta, dtheta (n each) of every arm; then middle, quaternion x y z w, velocity of
  // the middle and angular velocity of the box, where there is one. The quaternion has the sign nearer to that of
  // `before` (a state as well), unless that is null.
  std::size_t row() const;
  void state(double* out, const double* before) const;

  // States at all ticks of a course, (ticks, row()).
  void run(const Course& course, double* out);

  // One tick from `time` [s]: `substeps` periods with a desired torque by arm. False: a state is not finite.
  bool tick(double time, int substeps, const std::vector<const double*>& torques);

  // Whether the box rests on its support until it is touched.
  bool asleep() const { return has_box_ && !awake_; }

  // Force of the box on the pad of an arm in the last step [N].
  const Vector& pad_force(int arm) const { return pad_forces_[arm]; }

  const TwinReport& report() const { return report_; }

 private:
  void place(const BoxStart& box);
  bool rests();
  void load(double time);
  void period(double time);
  bool look();  // contact points now; whether a pad meets the object faster than a step of a period resolves
  void look_at_pad(int arm);
  void look_at_support();
  void step(double length, double time);
  void look_around(double time);
  void push(double time);
  void touch_step(double kick, double time);
  void note(std::size_t partner, double time);
  void prepare(std::size_t partner, double kick);
  void soften(std::size_t partner);
  void remember(std::size_t partner);
  void recall();
  void move_box(double drift);
  Body box() const;
  Body table() const;
  Matrix inertia() const;
  bool is_finite() const;

  const TwinModel& model_;
  TwinReport report_;
  std::vector<TwinArm> arms_;
  bool has_box_, fixed_, awake_;
  double mass_;  // of the object, or in its place [kg]
  double last_;  // length of the step before [s]
  long periods_ = 0;  // of the torque loop so far

  // Change of the velocities in the step before and its kick, as a first guess while the partners are the same.
  std::vector<double> change_;
  std::vector<int> partners_before_;
  double kick_before_ = 1.0;

  // The box: centre of mass, axes, velocities; angular momentum about the centre of mass.
  Vector centre_, velocity_, angular_, momentum_;
  Matrix rotation_;

  // Contacts of this step. Partners are arms by number, then the support.
  std::vector<Touch> touches_;
  std::vector<int> partners_;
  std::vector<std::vector<double>> motions_;  // by arm
  std::vector<Vector> pad_forces_;            // by arm
  std::vector<std::vector<Guess>> guesses_;  // by partner and point, of the step before
  StepSolver solver_;

  // Formulas: how every partner is touched, and force and moment about its centre of mass that act on the object.
  bool pushes_;
  Memory memory_;                   // of those of the object
  std::vector<Touching> touching_;  // by arm, then the support
  std::vector<double> symbols_;     // of the object
  Vector force_{}, moment_{};

  // Shear of the pad that is being prepared.
  struct Softened {
    Vector centre{};              // of the load, from the object's centre of mass [m]
    std::vector<double> weights;  // share of the load by point
    double lag = 0.0;             // time constant of the damper [s]
    bool yields = false;
  };
  std::vector<Softened> softened_;  // by arm
};

}  // namespace impact_rs
