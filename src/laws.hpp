// SPDX-License-Identifier: Apache-2.0
// The contact laws in terms of the impulses, and their solver. Symbols and derivation: laws.py in
// impact_rs_sim/impact_map.

#pragma once

#include <vector>

#include "dense.hpp"

namespace impact_rs {

constexpr double CONVERGED = 1e-15;  // m/s, |g F| that ends the iteration
constexpr double ACCEPTED = 1e-10;   // m/s, |g F| accepted where rounding stops the iteration earlier
constexpr int ITERATIONS = 25;       // of Newton's method; most problems take five to ten
constexpr double CONTINUATION[] = {1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7};  // rho, where the final value fails at once

// A problem at its m contacts; three numbers per contact, in axes of A. A contact is a point, with an impulse and a
// velocity, or the turning of a point, with a moment and an angular velocity; these are over and times a length, so that
// all contacts have one unit. Turning is resisted by the normal impulse of its point alone: |M_n| <= spin L_n about the
// normal and |M_t| <= friction L_n across it, with both arms over the same length.
struct Terms {
  int count = 0;
  std::vector<double> delassus;      // G = J_c H^-1 J_c^T, (3 m, 3 m) [1/kg]
  std::vector<double> approach;      // J_c u^-, (3 m) [m/s]
  std::vector<double> normals;       // into the object, (3 m)
  std::vector<double> friction;      // Coulomb coefficients, (m) [-]
  std::vector<double> spin;          // of turnings, (m) [-]
  std::vector<int> host;             // point of a turning; -1: a point, (m)
  std::vector<double> rebound;       // velocity that restitution returns, e min(J_n u^-, 0) n, (3 m) [m/s]
  std::vector<double> least;         // bound a of the normal impulses, (m) [N s]
  std::vector<double> inverse_mass;  // g, (m) [1/kg]
  double mobility = 0.0;             // 1 / m of the object, or mean of g where it is fixed [1/kg]
  int rank = 0;                      // rows of the root; 0: the root is not used
  std::vector<double> root;          // Y = L^-1 J_c^T with H = L L^T, so that G = Y^T Y, (rank, 3 m)

  void resize(int points);
  void compute_inverse_mass();  // from the Delassus operator
};

enum class State : char { open, stick, slide };

// The laws at one contact: dF = by_impulse dL + by_velocity ds + by_friction dmu + by_host dL_n of its point.
struct PointLaw {
  Vector defect;
  Matrix by_impulse;
  Matrix by_velocity;
  Vector by_friction;
  Vector by_host;
  State state;
  double margin;     // distance to another contact state [m/s]
  bool independent;  // whether F = L - L_0: nothing depends on a velocity
};

PointLaw linearise(const Vector& impulse, const Vector& velocity, const Vector& normal, double friction,
                   double inverse_mass, double least);

// The same of a turning, with the normal impulse of its point.
PointLaw linearise_turning(const Vector& moment, const Vector& velocity, const Vector& normal, double friction,
                           double spin, double inverse_mass, double normal_impulse);

class Solver {
 public:
  // Newton's method from the given impulses, as newton() of laws.py; false: not converged, impulses unchanged.
  bool newton(const Terms& terms, std::vector<double>& impulses, double compliance);

  // Remove the effect of the compliance on the velocities (proximal point method); false: not converged, impulses
  // unchanged.
  bool harden(const Terms& terms, std::vector<double>& impulses, double compliance);

  // From zero impulses, by Gauss-Seidel sweeps, Newton's method and harden; false: not converged.
  bool solve(const Terms& terms, std::vector<double>& impulses, double compliance);

  // The same from impulses near the answer, as those of other parameters; false: not converged in a few steps.
  bool resume(const Terms& terms, std::vector<double>& impulses, double compliance);

  // Linearisation of a point at the last Newton step.
  State state(int point) const { return laws_[point].state; }

  int steps = 0;  // of Newton's method and sweeps of Gauss and Seidel, since the start

 private:
  bool continuation(const Terms& terms, std::vector<double>& impulses, double compliance);
  bool full_steps(const Terms& terms, std::vector<double>& impulses, double regularisation, double tolerance, int most);
  void sweep(const Terms& terms, std::vector<double>& impulses, double regularisation);
  bool newton_step(const Terms& terms, double regularisation);
  bool step_by_root(const Terms& terms, double regularisation);
  PointLaw law_of(const Terms& terms, const std::vector<double>& impulses, int contact) const;
  void velocities(const Terms& terms, const std::vector<double>& impulses, double regularisation);

  std::vector<PointLaw> laws_;
  std::vector<int> coupled_;
  std::vector<double> velocity_, step_, matrix_, right_, best_, origin_, kept_, moved_, remainder_, work_;
  std::vector<Matrix> inverses_;
};

struct LawResiduals {
  double penetration = 0.0, complementarity = 0.0, friction = 0.0;  // m/s
};

// Residuals of the contact laws at impulses and velocities J_c u^+; definitions in laws.py.
LawResiduals judge(const Terms& terms, const double* impulses, const double* after);

}  // namespace impact_rs
