// SPDX-License-Identifier: Apache-2.0
// Arithmetic formulas of the state of an arm and the object, in postfix order; made by impact_rs_sim/twin.py.

#pragma once

#include <string>
#include <vector>

#include "dense.hpp"

namespace impact_rs {

// Symbols of a formula that belong to no joint; q, dq and tau of every joint follow them, all q first.
enum Symbol : int {
  of_time, of_position, of_velocity = of_position + 3, of_speed = of_velocity + 3,
  of_object_position, of_object_velocity = of_object_position + 3, of_object_angular_velocity = of_object_velocity + 3,
  of_object_speed = of_object_angular_velocity + 3, of_normal_force, of_penetration, of_closing, of_slip, of_since_contact,
  of_support_force, of_support_slip, of_joints
};

// Their names in impact_rs_sim/effects/formula.py.
constexpr const char* SYMBOLS[of_joints] = {
    "t", "x", "y", "z", "vx", "vy", "vz", "speed",
    "object_x", "object_y", "object_z", "object_vx", "object_vy", "object_vz", "object_wx", "object_wy", "object_wz",
    "object_speed", "normal_force", "penetration", "closing", "slip", "since_contact", "support_force", "support_slip"};

// First-order lag: impact_rs_sim/memory.py.
struct Lag {
  double time = 0.0, input = 0.0, rate = 0.0, value = 0.0;  // of the last evaluation; rate: 1 over the constant
  bool begun = false;

  // Its value after a step to `now` [s] with the time constant `constant` [s]; at the first evaluation `start`.
  double step(double now, double u, double constant, double start);
};

class Formula {
 public:
  // The first two take the number that follows them: of a constant or a symbol.
  enum Operation : int {
    constant, symbol,
    add, subtract, multiply, divide, power, minimum, maximum, lag, lag_from,
    negate, sine, cosine, tangent, exponential, logarithm, root, hyperbolic, absolute, sign
  };
  // Their names in impact_rs_sim/twin.py: those of Python's syntax tree and functions.
  static constexpr const char* NAMES[] = {
      "constant", "symbol",
      "Add", "Sub", "Mult", "Div", "Pow", "min", "max", "lag", "lag_from",
      "USub", "sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "abs", "sign"};
  static constexpr int DEEPEST = 512;  // operands at once; formulas of 1000 characters need up to 334: 1**1**1**...

  // `code` is valid for an arm of `joints` joints, else std::invalid_argument.
  Formula(std::vector<int> code, std::vector<double> constants, int joints);

  // Its value for these symbols; NaN where any part of it is NaN. `memory` has an entry for each of its lags.
  double operator()(const std::vector<double>& symbols, std::vector<Lag>& memory) const;

  int lags() const { return lags_; }

 private:
  int lags_ = 0;
  std::vector<int> code_;
  std::vector<double> constants_;
};

// Where a formula acts: a torque on a joint, a force or moment along an axis of A, or a force at a surface.
enum class Acts {
  on_link, on_motor, on_end_effector, on_pad, along_pad, on_object, turning_object, on_support, along_support
};

struct FormulaLoad {
  std::string effect;  // its name
  Acts acts;
  int index;  // of the joint, or the axis of A
  Formula formula;

  // Its value [N or N m]; std::runtime_error where it is not finite.
  double at(const std::vector<double>& symbols, std::vector<Lag>& memory) const;
};

// States of the lags of formulas in one simulation, by formula.
using Memory = std::vector<std::vector<Lag>>;
Memory fresh_memory(const std::vector<FormulaLoad>& formulas);

}  // namespace impact_rs
