// SPDX-License-Identifier: Apache-2.0

#include "laws.hpp"

#include <algorithm>

namespace impact_rs {

namespace {

constexpr double TINY = 1e-300;
constexpr int SWEEPS = 4;                 // Gauss-Seidel sweeps before Newton's method
constexpr int PROXIMAL_STEPS = 3;         // each reduces the effect of the compliance by a factor of 1e8
constexpr double START_COMPLIANCE = 0.1;  // compliance at the start, in inverse masses of the point
constexpr double FIRST_REDUCTION = 0.1;   // first reduction of the compliance, where the final value fails at once
constexpr double MIN_REDUCTION = 0.98;    // a smaller reduction is no progress
constexpr double LARGE_REDUCTION = 0.05;  // below this factor the reduction is large, and Newton's method gets fewer steps
constexpr int LARGE_REDUCTION_STEPS = 8;  // number of Newton steps after a large reduction
constexpr int FEW_STEPS = 5;              // with at most so many Newton steps, the next reduction is larger
constexpr int RESUMED_STEPS = 12;         // Newton steps from impulses near the answer, at most; from zero some hundred
constexpr int REFINEMENTS = 2;            // of a step computed through the root; each removes seven digits of rounding error

// The inverse of a; false where it is singular.
bool invert(const Matrix& a, Matrix& inverse) {
  const Vector first = cross(row(a, 1), row(a, 2)), second = cross(row(a, 2), row(a, 0)),
               third = cross(row(a, 0), row(a, 1));
  const double determinant = dot(row(a, 0), first);
  const double scale = 1.0 / determinant;
  if (!std::isfinite(scale)) return false;
  for (int i = 0; i < 3; ++i) {
    inverse[3 * i] = scale * first[i];
    inverse[3 * i + 1] = scale * second[i];
    inverse[3 * i + 2] = scale * third[i];
  }
  return true;
}

Vector at(const std::vector<double>& values, int point) { return vector(values.data() + 3 * point); }

void put(std::vector<double>& values, int point, const Vector& value) {
  std::copy(value.begin(), value.end(), values.begin() + 3 * point);
}

}  // namespace

void Terms::resize(int points) {
  count = points;
  delassus.assign(9 * points * points, 0.0);
  approach.assign(3 * points, 0.0);
  normals.assign(3 * points, 0.0);
  friction.assign(points, 0.0);
  spin.assign(points, 0.0);
  host.assign(points, -1);
  rebound.assign(3 * points, 0.0);
  least.assign(points, 0.0);
  inverse_mass.assign(points, 0.0);
}

void Terms::compute_inverse_mass() {
  const int size = 3 * count;
  for (int i = 0; i < count; ++i) {
    double trace = 0.0;
    for (int k = 3 * i; k < 3 * i + 3; ++k) trace += delassus[k * size + k];
    inverse_mass[i] = trace / 3.0;
  }
}

PointLaw linearise(const Vector& impulse, const Vector& velocity, const Vector& normal, double friction,
                   double inverse_mass, double least) {
  const double ratio = 1.0 / inverse_mass;
  const double normal_impulse = dot(normal, impulse), normal_velocity = dot(normal, velocity);
  const Vector tangential = impulse - normal_impulse * normal, sliding = velocity - normal_velocity * normal;
  const double trial_normal = normal_impulse - ratio * normal_velocity;
  const bool closed = trial_normal > least;
  const Vector trial = tangential - ratio * sliding;
  const double length = norm(trial), normal_load = std::max(normal_impulse, 0.0), radius = friction * normal_load;
  const bool sticks = length <= radius;
  const Vector direction = (1.0 / std::max(length, TINY)) * trial;
  const double turning = radius / std::max(length, TINY);
  const double friction_slope = normal_impulse > 0.0 ? friction : 0.0;
  PointLaw law;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const double along = normal[i] * normal[j], across = (i == j ? 1.0 : 0.0) - along;
      const double turned = turning * (across - direction[i] * direction[j]);
      const double friction_coupling = friction_slope * direction[i] * normal[j];
      law.by_impulse[3 * i + j] = (closed ? 0.0 : along) + (sticks ? 0.0 : across - friction_coupling - turned);
      law.by_velocity[3 * i + j] = ratio * ((closed ? along : 0.0) + (sticks ? across : turned));
    }
    law.by_friction[i] = sticks ? 0.0 : -normal_load * direction[i];
    law.by_host[i] = 0.0;
  }
  const double held = closed ? trial_normal : least;
  law.defect = (normal_impulse - held) * normal + tangential - (sticks ? trial : radius * direction);
  const bool in_contact = closed || normal_load > 0.0;
  law.state = !in_contact ? State::open : sticks ? State::stick : State::slide;
  const double gap_normal = std::abs(trial_normal - least), gap_friction = std::abs(length - radius);
  law.margin = inverse_mass * (in_contact ? std::min(gap_normal, gap_friction) : gap_normal);
  law.independent = !closed && !sticks && radius == 0.0;
  return law;
}

PointLaw linearise_turning(const Vector& moment, const Vector& velocity, const Vector& normal, double friction,
                           double spin, double inverse_mass, double normal_impulse) {
  const double ratio = 1.0 / inverse_mass, normal_load = std::max(normal_impulse, 0.0);
  const Vector trial = moment - ratio * velocity;
  const double about = dot(normal, trial), most = spin * normal_load;
  const bool held = std::abs(about) <= most;
  const Vector across = trial - about * normal;
  const double length = norm(across), radius = friction * normal_load;
  const bool sticks = length <= radius;
  const Vector direction = (1.0 / std::max(length, TINY)) * across;
  const double turning = radius / std::max(length, TINY), side = about < 0.0 ? -1.0 : 1.0;
  PointLaw law;
  law.defect = moment - (held ? about : side * most) * normal - (sticks ? across : radius * direction);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const double along = normal[i] * normal[j], plane = (i == j ? 1.0 : 0.0) - along;
      const double passed =
          (held ? along : 0.0) + (sticks ? plane : turning * (plane - direction[i] * direction[j]));
      law.by_impulse[3 * i + j] = (i == j ? 1.0 : 0.0) - passed;
      law.by_velocity[3 * i + j] = ratio * passed;
    }
    law.by_friction[i] = sticks ? 0.0 : -normal_load * direction[i];
    law.by_host[i] =
        normal_impulse > 0.0 ? -(held ? 0.0 : side * spin * normal[i]) - (sticks ? 0.0 : friction * direction[i]) : 0.0;
  }
  law.state = normal_load > 0.0 ? (held && sticks ? State::stick : State::slide) : State::open;
  law.margin = inverse_mass * std::min(std::abs(std::abs(about) - most), std::abs(length - radius));
  law.independent = !held && !sticks && normal_load == 0.0;
  return law;
}

PointLaw Solver::law_of(const Terms& terms, const std::vector<double>& impulses, int i) const {
  const Vector impulse = at(impulses, i), velocity = at(velocity_, i), normal = at(terms.normals, i);
  const int host = terms.host[i];
  if (host < 0) return linearise(impulse, velocity, normal, terms.friction[i], terms.inverse_mass[i], terms.least[i]);
  return linearise_turning(impulse, velocity, normal, terms.friction[i], terms.spin[i], terms.inverse_mass[i],
                           dot(at(terms.normals, host), at(impulses, host)));
}

// s, with the compliance as a spring about the impulses `origin`.
void Solver::velocities(const Terms& terms, const std::vector<double>& impulses, double regularisation) {
  const int size = 3 * terms.count;
  velocity_.resize(size);
  for (int i = 0; i < size; ++i)
    velocity_[i] = terms.approach[i] + regularisation * (impulses[i] - origin_[i]) + terms.rebound[i];
  for (int j = 0; j < size; ++j) {  // row by row, as G is symmetric
    const double* row = terms.delassus.data() + j * size;
    for (int i = 0; i < size; ++i) velocity_[i] += impulses[j] * row[i];
  }
}

// The same step as newton_step, where there are more impulses than velocities. With A and V the derivatives of F by
// impulse and velocity, D = A + yield V and P = D^-1 V, which are blocks of single points,
//     (D + V Y^T Y) x = b    is    x = D^-1 b - P Y^T z    with    (1 + Y P Y^T) z = Y D^-1 b.
// At sticking points D is small and x is a small difference of large numbers; refinement restores its digits.
bool Solver::step_by_root(const Terms& terms, double regularisation) {
  const int size = 3 * terms.count, rank = terms.rank;
  const double* root = terms.root.data();
  const auto gathered = [root, size](int r, int point) { return vector(root + r * size + 3 * point); };
  inverses_.resize(terms.count);
  matrix_.assign(rank * rank, 0.0);
  for (int i = 0; i < terms.count; ++i) {
    Matrix block = laws_[i].by_impulse;
    for (int k = 0; k < 9; ++k) block[k] += regularisation * laws_[i].by_velocity[k];
    if (!invert(block, inverses_[i])) return false;
    const Matrix passed = inverses_[i] * laws_[i].by_velocity;
    for (int r = 0; r < rank; ++r) {
      const Vector left = transposed_times(passed, gathered(r, i));
      if (left[0] == 0.0 && left[1] == 0.0 && left[2] == 0.0) continue;
      for (int c = 0; c < rank; ++c) matrix_[r * rank + c] += dot(left, gathered(c, i));
    }
  }
  for (int r = 0; r < rank; ++r) matrix_[r * rank + r] += 1.0;
  step_.assign(size, 0.0);
  for (int round = 0; round <= REFINEMENTS; ++round) {
    remainder_.resize(size);  // b - (D + V Y^T Y) x, then D^-1 times that
    right_.assign(rank, 0.0);
    moved_.assign(rank, 0.0);
    if (round > 0) {
      for (int r = 0; r < rank; ++r)
        for (int i = 0; i < size; ++i) moved_[r] += root[r * size + i] * step_[i];
    }
    for (int i = 0; i < terms.count; ++i) {
      Vector velocity = regularisation * at(step_, i);
      for (int r = 0; r < rank; ++r) velocity = velocity + moved_[r] * gathered(r, i);
      const Vector left =
          -1.0 * laws_[i].defect - laws_[i].by_impulse * at(step_, i) - laws_[i].by_velocity * velocity;
      const Vector alone = inverses_[i] * left;
      put(remainder_, i, alone);
      for (int r = 0; r < rank; ++r) right_[r] += dot(gathered(r, i), alone);
    }
    work_ = matrix_;
    if (!eliminate(work_.data(), right_.data(), rank)) return false;
    for (int i = 0; i < terms.count; ++i) {
      Vector velocity{};
      for (int r = 0; r < rank; ++r) velocity = velocity + right_[r] * gathered(r, i);
      put(step_, i, at(step_, i) + at(remainder_, i) - inverses_[i] * (laws_[i].by_velocity * velocity));
    }
  }
  for (const double value : step_)
    if (!std::isfinite(value)) return false;
  return true;
}

bool Solver::newton_step(const Terms& terms, double regularisation) {
  const int size = 3 * terms.count;
  if (terms.rank > 0 && step_by_root(terms, regularisation)) return true;
  step_.assign(size, 0.0);
  coupled_.clear();
  for (int i = 0; i < terms.count; ++i) {
    if (laws_[i].independent) {
      put(step_, i, -1.0 * laws_[i].defect);
    } else {
      coupled_.push_back(i);
    }
  }
  const int points = static_cast<int>(coupled_.size()), unknowns = 3 * points;
  matrix_.resize(unknowns * unknowns);
  right_.resize(unknowns);
  for (int p = 0; p < points; ++p) {
    const int i = coupled_[p];
    const PointLaw& law = laws_[i];
    Vector given{};  // change at this point due to the steps of the others
    for (int j = 0; j < terms.count; ++j) {
      if (!laws_[j].independent) continue;
      for (int k = 0; k < 3; ++k) {
        const double* row = terms.delassus.data() + (3 * i + k) * size + 3 * j;
        given[k] += row[0] * step_[3 * j] + row[1] * step_[3 * j + 1] + row[2] * step_[3 * j + 2];
      }
    }
    Vector right = -1.0 * law.defect - law.by_velocity * given;
    const int host = terms.host[i];
    if (host >= 0 && laws_[host].independent)
      right = right - dot(at(terms.normals, host), at(step_, host)) * law.by_host;
    for (int k = 0; k < 3; ++k) {
      right_[3 * p + k] = right[k];
      double* row = matrix_.data() + (3 * p + k) * unknowns;
      const double* by = law.by_velocity.data() + 3 * k;
      for (int q = 0; q < points; ++q) {
        const double* block = terms.delassus.data() + 3 * i * size + 3 * coupled_[q];
        for (int c = 0; c < 3; ++c)
          row[3 * q + c] = by[0] * block[c] + by[1] * block[size + c] + by[2] * block[2 * size + c];
      }
      for (int c = 0; c < 3; ++c) row[3 * p + c] += law.by_impulse[3 * k + c] + regularisation * by[c];
      if (host < 0) continue;
      for (int q = 0; q < points; ++q)
        if (coupled_[q] == host) {
          for (int c = 0; c < 3; ++c) row[3 * q + c] += law.by_host[k] * terms.normals[3 * host + c];
        }
    }
  }
  if (!eliminate(matrix_.data(), right_.data(), unknowns)) return false;
  for (int p = 0; p < points; ++p) put(step_, coupled_[p], vector(right_.data() + 3 * p));
  return true;
}

// Newton's method without line search, which stalls at the kinks between contact states.
bool Solver::full_steps(const Terms& terms, std::vector<double>& impulses, double regularisation, double tolerance,
                        int most) {
  double lowest = INFINITY;
  best_ = impulses;
  laws_.resize(terms.count);
  for (int iteration = 0; iteration < most; ++iteration) {
    ++steps;
    velocities(terms, impulses, regularisation);
    double sum = 0.0;
    for (int i = 0; i < terms.count; ++i) {
      laws_[i] = law_of(terms, impulses, i);
      const double size = terms.inverse_mass[i] * norm(laws_[i].defect);
      sum += size * size;
    }
    const double error = std::sqrt(sum);
    const bool stalled = !(error < lowest);
    if (!stalled) {
      best_ = impulses;
      lowest = error;
    }
    if (lowest <= tolerance || (lowest <= ACCEPTED && stalled)) break;
    if (!newton_step(terms, regularisation)) break;
    for (int i = 0; i < 3 * terms.count; ++i) impulses[i] += step_[i];
  }
  impulses = best_;
  return lowest <= ACCEPTED;
}

bool Solver::newton(const Terms& terms, std::vector<double>& impulses, double compliance) {
  const double mobility = terms.mobility;
  origin_.assign(3 * terms.count, 0.0);
  kept_ = impulses;
  if (full_steps(terms, impulses, compliance * mobility, CONVERGED, ITERATIONS)) return true;
  impulses = kept_;
  bool converged = true;
  for (const double rho : CONTINUATION)
    if (converged && rho > compliance) converged = full_steps(terms, impulses, rho * mobility, CONVERGED, ITERATIONS);
  if (converged && full_steps(terms, impulses, compliance * mobility, CONVERGED, ITERATIONS)) return true;
  impulses = kept_;
  return false;
}

bool Solver::harden(const Terms& terms, std::vector<double>& impulses, double compliance) {
  const double regularisation = compliance * terms.mobility;
  for (int round = 0; round < PROXIMAL_STEPS; ++round) {
    origin_ = impulses;
    kept_ = impulses;
    if (!full_steps(terms, impulses, regularisation, CONVERGED, ITERATIONS)) {
      impulses = kept_;
      return round > 0;
    }
    double moved = 0.0;
    for (int i = 0; i < 3 * terms.count; ++i) moved = std::max(moved, std::abs(impulses[i] - origin_[i]));
    if (regularisation * moved <= CONVERGED) break;
  }
  return true;
}

// Gauss-Seidel sweep: each point opens, sticks, or slides on the edge of its cone.
void Solver::sweep(const Terms& terms, std::vector<double>& impulses, double regularisation) {
  const int size = 3 * terms.count;
  velocities(terms, impulses, regularisation);
  steps += SWEEPS;
  for (int visit = 0; visit < SWEEPS * terms.count; ++visit) {
    const int i = visit % terms.count;
    const Vector normal = at(terms.normals, i), before = at(impulses, i);
    Vector velocity = vector(velocity_.data() + 3 * i);
    Matrix block;
    for (int k = 0; k < 3; ++k)
      for (int c = 0; c < 3; ++c)
        block[3 * k + c] = terms.delassus[(3 * i + k) * size + 3 * i + c] + (k == c ? regularisation : 0.0);
    const Vector alone = velocity - block * before;
    Vector next{};
    if (const int host = terms.host[i]; host >= 0) {
      const double normal_load = std::max(dot(at(terms.normals, host), at(impulses, host)), 0.0);
      const Vector trial = before - (1.0 / (terms.inverse_mass[i] + regularisation)) * velocity;
      const double about = dot(normal, trial), most = terms.spin[i] * normal_load;
      const Vector across = trial - about * normal;
      next = std::clamp(about, -most, most) * normal +
             std::min(1.0, terms.friction[i] * normal_load / std::max(norm(across), TINY)) * across;
    } else if (dot(normal, alone) < 0.0) {
      Vector holding = -1.0 * alone;
      Matrix work = block;
      const bool holds = eliminate(work.data(), holding.data(), 3);
      const double normal_impulse = dot(normal, holding);
      const double tangential_size = norm(holding - normal_impulse * normal);
      if (holds && normal_impulse >= 0.0 && tangential_size <= terms.friction[i] * normal_impulse) {
        next = holding;
      } else {
        const double stiff = dot(normal, block * normal);
        const double across = 0.5 * (block[0] + block[4] + block[8] - stiff);
        Vector tangential = before - dot(normal, before) * normal;
        double normal_part = std::max(dot(normal, before), 0.0);
        for (int inner = 0; inner < 4; ++inner) {
          Vector now = alone + block * (normal_part * normal + tangential);
          normal_part = std::max(0.0, normal_part - dot(normal, now) / stiff);
          now = alone + block * (normal_part * normal + tangential);
          const Vector trial = tangential - (1.0 / across) * (now - dot(normal, now) * normal);
          const double length = norm(trial);
          tangential = std::min(1.0, terms.friction[i] * normal_part / std::max(length, TINY)) * trial;
        }
        next = normal_part * normal + tangential;
      }
    }
    const Vector change = next - before;
    if (change[0] == 0.0 && change[1] == 0.0 && change[2] == 0.0) continue;
    put(impulses, i, next);
    for (int k = 0; k < size; ++k) {
      const double* row = terms.delassus.data() + k * size + 3 * i;
      velocity_[k] += row[0] * change[0] + row[1] * change[1] + row[2] * change[2];
    }
    for (int c = 0; c < 3; ++c) velocity_[3 * i + c] += regularisation * change[c];
  }
}

// Continuation in the compliance. With large compliance the solution is unique, shares loads evenly and is easy to
// find. From there the compliance falls to its final value: at once where Newton's method converges, else in growing
// steps.
bool Solver::continuation(const Terms& terms, std::vector<double>& impulses, double compliance) {
  impulses.assign(3 * terms.count, 0.0);
  origin_ = impulses;
  double total = 0.0;
  for (const double mass : terms.inverse_mass) total += mass;
  const double last = compliance * terms.mobility;
  double regularisation = std::max(START_COMPLIANCE * total / std::max(terms.count, 1), last), factor = 0.0;
  sweep(terms, impulses, regularisation);
  if (!full_steps(terms, impulses, regularisation, ACCEPTED, ITERATIONS)) return false;
  while (regularisation > last) {
    kept_ = impulses;
    const int before = steps;
    const double next = std::max(regularisation * factor, last);
    if (full_steps(terms, impulses, next, ACCEPTED, factor < LARGE_REDUCTION ? LARGE_REDUCTION_STEPS : ITERATIONS)) {
      regularisation = next;
      if (steps - before <= FEW_STEPS) factor *= factor;
    } else {
      impulses = kept_;
      factor = factor > 0.0 ? std::sqrt(factor) : FIRST_REDUCTION;
      if (factor > MIN_REDUCTION) return false;
    }
  }
  return true;
}

// Where the continuation stalls between two contact states, Newton's method or a proximal step starts again from the
// impulses where it stopped.
bool Solver::solve(const Terms& terms, std::vector<double>& impulses, double compliance) {
  const bool found = continuation(terms, impulses, compliance) || newton(terms, impulses, compliance);
  return harden(terms, impulses, compliance) || found;
}

bool Solver::resume(const Terms& terms, std::vector<double>& impulses, double compliance) {
  origin_.assign(3 * terms.count, 0.0);
  if (!full_steps(terms, impulses, compliance * terms.mobility, ACCEPTED, RESUMED_STEPS)) return false;
  harden(terms, impulses, compliance);
  return true;
}

LawResiduals judge(const Terms& terms, const double* impulses, const double* after) {
  LawResiduals judged;
  double pushed = TINY;
  for (int i = 0; i < terms.count; ++i)
    if (terms.host[i] < 0) pushed = std::max(pushed, dot(at(terms.normals, i), vector(impulses + 3 * i)));
  const auto worse = [](double& law, double amount) {
    if (law == law && !(amount <= law)) law = amount;  // NaN counts as the largest
  };
  for (int i = 0; i < terms.count; ++i) {
    const Vector normal = at(terms.normals, i), impulse = vector(impulses + 3 * i);
    const Vector moving = vector(after + 3 * i) + at(terms.rebound, i);
    const double mass = terms.inverse_mass[i];
    if (const int host = terms.host[i]; host >= 0) {
      const double normal_load = dot(at(terms.normals, host), vector(impulses + 3 * host));
      const PointLaw law = linearise_turning(impulse, moving, normal, terms.friction[i], terms.spin[i], mass, normal_load);
      worse(judged.friction, mass * norm(law.defect));
      continue;
    }
    const double separation = dot(normal, moving), normal_impulse = dot(normal, impulse);
    const Vector tangential = impulse - normal_impulse * normal, sliding = moving - separation * normal;
    worse(judged.penetration, -separation);
    worse(judged.complementarity, std::max(separation, 0.0) * std::max(normal_impulse - terms.least[i], 0.0) / pushed);
    worse(judged.complementarity, mass * (terms.least[i] - normal_impulse));
    const Vector trial = tangential - (1.0 / mass) * sliding;
    const double radius = terms.friction[i] * std::max(normal_impulse, 0.0);
    const Vector held = std::min(1.0, radius / std::max(norm(trial), TINY)) * trial;
    worse(judged.friction, mass * norm(tangential - held));
  }
  return judged;
}

}  // namespace impact_rs
