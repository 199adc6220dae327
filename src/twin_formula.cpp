// SPDX-License-Identifier: Apache-2.0
#include "twin_formula.hpp"

#include <algorithm>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <utility>

namespace impact_rs {

Formula::Formula(std::vector<int> code, std::vector<double> constants, int joints)
    : code_(std::move(code)), constants_(std::move(constants)) {
  int depth = 0;
  for (std::size_t i = 0; i < code_.size(); ++i) {
    const int operation = code_[i];
    if (operation < 0 || operation > sign) throw std::invalid_argument("formula: unknown operation");
    if (operation <= symbol) {
      const int limit = operation == constant ? static_cast<int>(constants_.size()) : of_joints + 3 * joints;
      if (++i == code_.size() || code_[i] < 0 || code_[i] >= limit) throw std::invalid_argument("formula: unknown symbol");
    }
    lags_ += operation == lag || operation == lag_from;
    depth += operation <= symbol ? 1 : operation <= lag ? -1 : operation == lag_from ? -2 : 0;
    if (depth < 1 || depth > DEEPEST) throw std::invalid_argument("formula: too deep, or without operands");
  }
  if (depth != 1) throw std::invalid_argument("formula: not one value");
}

double Lag::step(double now, double u, double constant, double start) {
  if (begun && now <= time) return value;
  const double own = constant <= 0.0 ? std::numeric_limits<double>::infinity() : 1.0 / constant;
  if (begun) {
    const double ratio = 0.5 * (now - time) * (rate + own);
    const double passed = ratio > 0.0 ? -std::expm1(-ratio) / ratio : 1.0;
    value = u - (u - input) * passed + (value - input) * std::exp(-ratio);
  } else {
    value = start;
  }
  time = now;
  input = u;
  rate = own;
  begun = true;
  return value;
}

double Formula::operator()(const std::vector<double>& symbols, std::vector<Lag>& memory) const {
  double values[DEEPEST];
  int top = -1;
  auto next = memory.begin();
  for (std::size_t i = 0; i < code_.size(); ++i) {
    const auto operation = static_cast<Operation>(code_[i]);
    if (operation >= add && operation <= lag) --top;
    if (operation == lag_from) top -= 2;
    if (operation <= symbol) ++top;
    double& a = values[top];
    switch (operation) {
      case constant: a = constants_[code_[++i]]; break;
      case symbol: a = symbols[code_[++i]]; break;
      case add: a += values[top + 1]; break;
      case subtract: a -= values[top + 1]; break;
      case multiply: a *= values[top + 1]; break;
      case divide: a /= values[top + 1]; break;
      case power: a = std::pow(a, values[top + 1]); break;
      case minimum: a = std::min(a, values[top + 1]); break;
      case maximum: a = std::max(a, values[top + 1]); break;
      case lag: a = (next++)->step(symbols[of_time], a, values[top + 1], a); break;
      case lag_from: a = (next++)->step(symbols[of_time], a, values[top + 1], values[top + 2]); break;
      case negate: a = -a; break;
      case sine: a = std::sin(a); break;
      case cosine: a = std::cos(a); break;
      case tangent: a = std::tan(a); break;
      case exponential: a = std::exp(a); break;
      case logarithm: a = std::log(a); break;
      case root: a = std::sqrt(a); break;
      case hyperbolic: a = std::tanh(a); break;
      case absolute: a = std::abs(a); break;
      case sign: a = a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : 0.0; break;
    }
    if (std::isnan(a)) return a;  // min, max and sign would lose it
  }
  return values[0];
}

double FormulaLoad::at(const std::vector<double>& symbols, std::vector<Lag>& memory) const {
  const double value = formula(symbols, memory);
  if (!std::isfinite(value)) {
    char when[32];
    std::snprintf(when, sizeof when, "%.3f", symbols[of_time]);
    throw std::runtime_error("effect '" + effect + "' blows up at t = " + when + " s");
  }
  return value;
}

Memory fresh_memory(const std::vector<FormulaLoad>& formulas) {
  Memory memory;
  for (const FormulaLoad& load : formulas) memory.emplace_back(load.formula.lags());
  return memory;
}

}  // namespace impact_rs
