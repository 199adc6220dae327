// SPDX-License-Identifier: Apache-2.0
// One arm of the twin: links, drive, delayed command, loads and pad. Equations in impact_rs_sim/drive.py and physics.py.

#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "boxes.hpp"
#include "chain.hpp"
#include "drive.hpp"
#include "twin_formula.hpp"

namespace impact_rs {

// A compliant or rigid body on the last link.
struct Pad {
  Vector centre;    // in axes of the last joint
  Matrix rotation;
  Vector half;      // half extents [m]
  bool rigid;
  double stiffness, damping;         // of the whole face [N/m, N s/m]
  double shear_compliance, creep;    // [m/N], [m/(s N)]
  Shape shape;                         // its shape
};

// Spring and damper between flange and pad, whose tip has no mass: z + lag dz/dt = B^T w under the wrench w of the
// contacts at frame E, which displaces the pad by the twist B z; its compliance matrix is B B^T.
struct ToolSpring {
  std::vector<Spatial> motions;  // columns of B at frame E, in axes of the last joint
  double lag;                    // [s]
};

// f_0 - k (p - p_impact) on frame E.
struct CartesianSpring {
  Vector force;      // f_0 [N]
  double stiffness;  // k [N/m]
  Vector position;      // p_impact [m]
};

// Torque on links and motors that Python computes: symbols of the scene, q, dq, tau_J, and the two torques, added to.
using PythonLoad = std::function<void(const double*, const double*, const double*, const double*, double*, double*)>;

// What does not change over a simulation.
struct ArmModel {
  Chain links;
  Drive drive;
  std::vector<double> shaping, gain, offset, stiffness, damping;  // per joint
  double delay;        // of the desired torque [s]
  bool joint_torque;   // the torques are measured joint torques; there is no motor
  Pad pad;
  ToolSpring tool;
  std::optional<CartesianSpring> spring;
  std::vector<FormulaLoad> formulas;
  PythonLoad python;
};

// A desired torque, and the time from which it is desired [s].
struct Command {
  double since;
  std::vector<double> torque;
};

// Initial state.
struct ArmStart {
  std::vector<double> position, velocity, torque, torque_rate;  // q, dq, tau_J, dtau_J
  std::deque<Command> earlier;  // commands before the start, one or more; the first acts from ever
  std::vector<double> before;   // time, q, dq and tau_J of samples before the start, in the order of time
};

// Shear of a pad against its flange, in axes of the last joint.
struct Shear {
  Vector shift{};      // at frame E [m]
  double twist = 0.0;  // about the normal [rad]
};

class TwinArm {
 public:
  TwinArm(const ArmModel& model, const ArmStart& start, double period);

  int joints() const { return static_cast<int>(q.size()); }
  ConvexBody pad_box() const;  // by the last update of the kinematics, displaced by the tool's spring

  // Degrees of freedom of the tool's spring, unknowns of a step in contact like the joint velocities: motion of the pad at
  // unit speed about the origin of A, and their block of the equations and impulse of a step.
  int tool_freedoms() const { return static_cast<int>(model_.tool.motions.size()); }
  Spatial tool_motion(int freedom) const;
  double tool_inertia(double velocity_step, double position_step) const;
  double tool_impulse(int freedom, double velocity_step) const;

  // Update the symbols of formulas that belong to the arm; those of time, object and contact stay.
  void update_symbols();

  // Initialise the lags of formulas from samples before the start, at the present symbols of the scene.
  void initialise_memory(const std::vector<double>& samples);

  // Compute loads, constant until the next call; std::runtime_error where a formula is not finite.
  void update_loads();

  // A force on the pad's link at a position in A, over the coming step [N]; after equations().
  void apply_force(const Vector& position, const Vector& force);

  // Desired torque from the begin of a period on (or measured joint torque, which then is that of its end).
  void set_desired_torque(const double* torque, std::int64_t period);

  // Torque law at the begin of a period of the torque loop.
  void command(std::int64_t period);

  // Kinematics at q; then M (n, n) and the generalised force tau - h without contact.
  void update_kinematics() { links_.update_kinematics(q.data()); }
  void equations();

  // Free motion: velocities after `velocity_step` [s] without contact; false where M is not positive definite.
  bool free_step(double velocity_step);

  // Integrate motors (velocities by `velocity_step`, positions by `position_step` [s]) and joint positions, then update the
  // joint springs; the tool's spring follows its velocities if the pad is in contact.
  void integrate(double velocity_step, double position_step, bool in_contact);

  const Spatial& axis(int joint) const { return links_.axis(joint); }
  const Vector& end() const { return links_.end(); }
  const Matrix& last_joint_axes() const { return links_.last_joint_axes(); }
  const Pad& pad() const { return model_.pad; }
  const std::vector<FormulaLoad>& formulas() const { return model_.formulas; }

  // A formula's value now; std::runtime_error where it is not finite.
  double value(std::size_t formula) { return model_.formulas[formula].at(symbols, memory_[formula]); }

  std::vector<double> q, dq;
  std::vector<double> tool, tool_rate;  // z and dz/dt of the tool's spring
  std::vector<double> mass, net_torque;  // of equations()
  std::vector<double> symbols;  // of formulas
  Shear shear;

  const std::vector<double>& elastic() const { return drive_.elastic; }
  const std::vector<double>& motor_position() const { return drive_.position; }
  const std::vector<double>& motor_velocity() const { return drive_.velocity; }

 private:
  void delay_commands(double begin);

  const ArmModel& model_;
  Memory memory_;
  double period_;
  Chain links_;
  Drive drive_;
  std::vector<double> desired_torque_, shaped_, torque_rate_, link_torque_, on_links_, on_motors_, factor_, acceleration_;
  std::vector<double> tool_before_, tool_load_;  // z a step ago; loads of formulas along z
  std::deque<Command> commands_;  // that the delay may still deliver
};

}  // namespace impact_rs
