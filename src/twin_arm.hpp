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
  Form form;                         // its shape
};

// Spring and damper between flange and pad, whose tip has no mass: z + lag dz/dt = B^T w under the wrench w of the
// contacts at frame E, which displaces the pad by the twist B z; its compliance matrix is B B^T.
struct ToolSpring {
  std::vector<Spatial> motions;  // columns of B at frame E, in axes of the last joint
  double lag;                    // [s]
};

// f_0 - k (p - p_impact) on frame E.
struct Pull {
  Vector force;      // f_0 [N]
  double stiffness;  // k [N/m]
  Vector place;      // p_impact [m]
};

// Torque on links and motors that Python computes: time, q, dq, and the two torques, added to.
using PythonLoad = std::function<void(double, const double*, const double*, double*, double*)>;

// What does not change over a simulation.
struct ArmModel {
  Chain links;
  Drive drive;
  std::vector<double> shaping, gain, offset, stiffness, damping;  // per joint
  double delay;        // of the desired torque [s]
  bool joint_torque;   // the torques are measured joint torques; there is no motor
  Pad pad;
  ToolSpring tool;
  std::optional<Pull> pull;
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
  Body pad_box() const;  // where the links were placed, displaced by the tool's spring

  // Freedoms of the tool's spring, which are unknowns of a step in contact beside the joint velocities: motion of the pad
  // at unit speed about the origin of A, and their block of the equations and impulse of a step.
  int yields() const { return static_cast<int>(model_.tool.motions.size()); }
  Spatial yielding(int freedom) const;
  double tool_inertia(double kick, double drift) const;
  double tool_impulse(int freedom, double kick) const;

  // Values of the symbols of formulas: those of the arm now, beside those of time, object and contact as they are.
  void look_around();

  // What formulas remember of samples before the start, while the symbols of the scene are as they are.
  void look_back(const std::vector<double>& samples);

  // Loads that hold until they are computed again; std::runtime_error where a formula is not finite.
  void load();

  // A force on the pad's link at a place, over the coming step [N]; after equations().
  void push(const Vector& place, const Vector& force);

  // Desired torque from the begin of a period on (or measured joint torque, which then is that of its end).
  void desire(const double* torque, std::int64_t period);

  // Torque law at the begin of a period of the torque loop.
  void command(std::int64_t period);

  // Links in their places; then M (n, n) and the change of momentum per time without contact.
  void look() { links_.place(q.data()); }
  void equations();

  // Velocities after `kick` [s] without contact; false where M is not positive definite.
  bool coast(double kick);

  // Motors after a step, links along their velocities, and the spring between them; the tool's spring along its velocities
  // where the pad is touched.
  void move(double kick, double drift, bool touched);

  const Spatial& axis(int joint) const { return links_.axis(joint); }
  const Vector& end() const { return links_.end(); }
  const Matrix& axes_of_last() const { return links_.axes_of_last(); }
  const Pad& pad() const { return model_.pad; }
  const std::vector<FormulaLoad>& formulas() const { return model_.formulas; }

  // A formula's value now; std::runtime_error where it is not finite.
  double value(std::size_t formula) { return model_.formulas[formula].at(symbols, memory_[formula]); }

  std::vector<double> q, dq;
  std::vector<double> tool, tool_rate;  // z and dz/dt of the tool's spring
  std::vector<double> mass, driving;  // of equations()
  std::vector<double> symbols;  // of formulas
  Shear shear;

  const std::vector<double>& elastic() const { return drive_.elastic; }
  const std::vector<double>& motor_position() const { return drive_.position; }
  const std::vector<double>& motor_velocity() const { return drive_.velocity; }

 private:
  void deliver(double begin);

  const ArmModel& model_;
  Memory memory_;
  double period_;
  Chain links_;
  Drive drive_;
  std::vector<double> wanted_, shaped_, rate_, passed_, on_links_, on_motors_, factor_, acceleration_;
  std::vector<double> tool_before_, tool_load_;  // z a step ago; loads of formulas along z
  std::deque<Command> commands_;  // that the delay may still deliver
};

}  // namespace impact_rs
