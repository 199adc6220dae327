// SPDX-License-Identifier: Apache-2.0
// Arithmetic formulas of an arm's state, in postfix order; made by impact_rs_sim/twin.py.

#pragma once

#include <vector>

#include "dense.hpp"

namespace impact_rs {

// Symbols of a formula.
struct FormulaState {
  double time;            // since the start of the trial [s]
  const double *q, *dq;   // of the joints
  Vector place, velocity; // of frame E in A
};

class Formula {
 public:
  // The first five take the number that follows them: of a constant, an axis of A or a joint.
  enum Operation : int {
    constant, position, joint_position, joint_velocity, speed, time,
    add, subtract, multiply, divide, power, minimum, maximum,
    negate, sine, cosine, tangent, exponential, logarithm, root, hyperbolic, absolute, sign
  };
  // Their names in impact_rs_sim/twin.py: those of Python's syntax tree and functions.
  static constexpr const char* NAMES[] = {
      "constant", "position", "joint_position", "joint_velocity", "speed", "time",
      "Add", "Sub", "Mult", "Div", "Pow", "min", "max",
      "USub", "sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "abs", "sign"};
  static constexpr int DEEPEST = 64;

  // `code` is valid for an arm of `joints` joints, else std::invalid_argument.
  Formula(std::vector<int> code, std::vector<double> constants, int joints);

  // Its value; NaN where any part of it is not finite.
  double operator()(const FormulaState& state) const;

 private:
  std::vector<int> code_;
  std::vector<double> constants_;
};

}  // namespace impact_rs
