// SPDX-License-Identifier: Apache-2.0
// Python bindings of the kernel, documented in impact_rs_sim/_kernel.pyi.

#include <algorithm>
#include <memory>
#include <optional>
#include <tuple>
#include <utility>

#include "impact.hpp"
#include "module.hpp"

namespace impact_rs {
namespace {

const char* const STATES[] = {"open", "stick", "slide"};

// One field of N problems: N sets of numbers, or one set for all of them.
class Field {
 public:
  Field(const py::handle& given, py::ssize_t each, py::ssize_t count, const char* name) {
    if (each == 1 && PyFloat_Check(given.ptr())) {  // a plain number needs no array
      number_ = PyFloat_AS_DOUBLE(given.ptr());
      return;
    }
    numbers_ = Numbers(py::reinterpret_borrow<py::object>(given));
    is_number_ = false;
    if (numbers_.size() != each) checked(numbers_, each * count, name);
    stride_ = numbers_.size() == each ? 0 : each;
  }
  const double* operator()(py::ssize_t question) const {
    return is_number_ ? &number_ : numbers_.data() + question * stride_;
  }

 private:
  Numbers numbers_;
  py::ssize_t stride_ = 0;
  double number_ = 0.0;
  bool is_number_ = true;
};

using BodyOfPython = std::tuple<Numbers, Numbers, Numbers, OptionalShape>;

ConvexBody body_of(const BodyOfPython& given) {
  const auto& [centre, rotation, half, shape] = given;
  Matrix axes;
  const double* values = checked(rotation, 9, "rotation");
  std::copy(values, values + 9, axes.begin());
  return {vector(checked(centre, 3, "centre")), axes, vector(checked(half, 3, "half")), shape.value_or(Shape{})};
}

Shape shape_of(const std::string& kind, const std::optional<Numbers>& corners,
                       const std::vector<std::vector<int>>& faces) {
  const char* const kinds[] = {"box", "sphere", "capsule", "cylinder", "hull"};
  const auto* found = std::find(kinds, kinds + 5, kind);
  if (found == kinds + 5) throw py::value_error("kind: expected box, sphere, capsule, cylinder or hull");
  Shape shape{static_cast<ShapeKind>(found - kinds), nullptr};
  if ((shape.kind == ShapeKind::hull) != corners.has_value())
    throw py::value_error("corners: a hull has some, nothing else");
  if (corners) {
    if (corners->size() == 0 || corners->size() % 3 != 0)
      throw py::value_error("corners: expected one or more, three numbers each");
    std::vector<Vector> points;
    for (py::ssize_t i = 0; i < corners->size(); i += 3) points.push_back(vector(corners->data() + i));
    shape.hull = std::make_shared<Hull>(std::move(points), faces);  // an invalid one is a ValueError
  }
  return shape;
}

using EdgesOfPython = std::optional<std::pair<int, int>>;

py::tuple separating_axis_of(const BodyOfPython& partner, const BodyOfPython& object, double aligned) {
  const SeparatingAxis separating = separating_axis(body_of(partner), body_of(object), aligned);
  EdgesOfPython edges;
  if (separating.edges) edges.emplace(separating.edges->partner, separating.edges->object);
  return py::make_tuple(separating.separation, Numbers(3, separating.normal.data()), separating.on_object, edges);
}

py::tuple contact_manifold_of(const BodyOfPython& partner, const BodyOfPython& object, const Numbers& normal, bool on_object,
                      const EdgesOfPython& edges, double tolerance) {
  SeparatingAxis separating{0.0, vector(checked(normal, 3, "normal")), on_object, std::nullopt};
  if (edges) {
    if (std::min(edges->first, edges->second) < 0 || std::max(edges->first, edges->second) > 2)
      throw py::value_error("edges: expected two axes of boxes, 0 to 2");
    separating.edges = Edges{edges->first, edges->second};
  }
  std::vector<ManifoldPoint> found;
  contact_manifold(body_of(partner), body_of(object), separating, tolerance, found);
  std::vector<double> positions, gaps;
  for (const ManifoldPoint& candidate : found) {
    positions.insert(positions.end(), candidate.position.begin(), candidate.position.end());
    gaps.push_back(candidate.gap);
  }
  const py::ssize_t count = found.size();
  return py::make_tuple(array(positions, {count, 3}), array(gaps, {count}));
}

class TermsOfPython {
 public:
  TermsOfPython(const Numbers& delassus, const Numbers& approach, const Numbers& normals, const Numbers& friction,
                const Numbers& rebound, const Numbers& inverse_mass, double mobility) {
    const py::ssize_t count = friction.size(), size = 3 * count;
    terms_.resize(static_cast<int>(count));
    const auto take = [](std::vector<double>& into, const Numbers& from, py::ssize_t expected, const char* name) {
      const double* values = checked(from, expected, name);
      into.assign(values, values + expected);
    };
    take(terms_.delassus, delassus, size * size, "delassus");
    take(terms_.approach, approach, size, "approach");
    take(terms_.normals, normals, size, "normals");
    take(terms_.friction, friction, count, "friction");
    checked(rebound, count, "rebound");
    for (py::ssize_t i = 0; i < size; ++i) terms_.rebound[i] = rebound.data()[i / 3] * terms_.normals[i];
    take(terms_.inverse_mass, inverse_mass, count, "inverse_mass");
    terms_.mobility = mobility;
    // In exact arithmetic it is symmetric.
    for (py::ssize_t i = 0; i < size; ++i)
      for (py::ssize_t j = 0; j < i; ++j) {
        double &left = terms_.delassus[i * size + j], &right = terms_.delassus[j * size + i];
        left = right = 0.5 * (left + right);
      }
  }

  py::tuple linearise(const Numbers& impulses, const Numbers& velocity, const Numbers& least) {
    press(least);
    const py::ssize_t count = terms_.count;
    const double* at = checked(impulses, 3 * count, "impulses");
    const double* moving = checked(velocity, 3 * count, "velocity");
    std::vector<double> defect, by_impulse, by_velocity, by_friction, margin;
    py::tuple states(count);
    for (py::ssize_t i = 0; i < count; ++i) {
      const PointLaw law =
          impact_rs::linearise(vector(at + 3 * i), vector(moving + 3 * i), vector(terms_.normals.data() + 3 * i),
                               terms_.friction[i], terms_.inverse_mass[i], terms_.least[i]);
      defect.insert(defect.end(), law.defect.begin(), law.defect.end());
      by_impulse.insert(by_impulse.end(), law.by_impulse.begin(), law.by_impulse.end());
      by_velocity.insert(by_velocity.end(), law.by_velocity.begin(), law.by_velocity.end());
      by_friction.insert(by_friction.end(), law.by_friction.begin(), law.by_friction.end());
      margin.push_back(law.margin);
      states[i] = STATES[static_cast<int>(law.state)];
    }
    return py::make_tuple(array(defect, {count, 3}), array(by_impulse, {count, 3, 3}),
                          array(by_velocity, {count, 3, 3}), array(by_friction, {count, 3}), states,
                          array(margin, {count}));
  }

  py::tuple newton(const Numbers& guess, const Numbers& least, double compliance) {
    press(least);
    std::vector<double> impulses = start(guess);
    const bool converged = Solver().newton(terms_, impulses, compliance);
    return py::make_tuple(array(impulses, {terms_.count, 3}), converged);
  }

  Numbers harden(const Numbers& guess, const Numbers& least, double compliance) {
    press(least);
    std::vector<double> impulses = start(guess);
    Solver().harden(terms_, impulses, compliance);
    return array(impulses, {terms_.count, 3});
  }

  py::tuple solve(double compliance) {
    terms_.least.assign(terms_.count, 0.0);
    std::vector<double> impulses;
    Solver solver;
    const bool converged = solver.solve(terms_, impulses, compliance);
    return py::make_tuple(array(impulses, {terms_.count, 3}), converged, solver.steps);
  }

  py::tuple judge(const Numbers& impulses, const Numbers& after, const Numbers& least) {
    press(least);
    const LawResiduals found = impact_rs::judge(terms_, checked(impulses, 3 * terms_.count, "impulses"),
                                          checked(after, 3 * terms_.count, "after"));
    return py::make_tuple(found.penetration, found.complementarity, found.friction);
  }

 private:
  void press(const Numbers& least) {
    if (least.size() == 1) {
      terms_.least.assign(terms_.count, *least.data());
    } else {
      const double* values = checked(least, terms_.count, "least");
      terms_.least.assign(values, values + terms_.count);
    }
  }

  std::vector<double> start(const Numbers& guess) const {
    const double* values = checked(guess, 3 * terms_.count, "impulses");
    return std::vector<double>(values, values + 3 * terms_.count);
  }

  Terms terms_;
};

struct ArmFields {
  py::ssize_t joints;
  std::vector<Field> fields;
  OptionalShape shape;  // of what is on the flange
  int carrier;         // index of the arm whose velocities it has

  ArmFields(const py::sequence& given, py::ssize_t count, int own) : carrier(own) {
    if (given.size() < 13 || given.size() > 15)
      throw py::value_error("an arm has 13 fields, 14 with a shape, 15 with its carrier");
    if (given.size() > 13) shape = given[13].cast<OptionalShape>();
    if (given.size() > 14) carrier = given[14].cast<int>();
    if (carrier < 0 || carrier > own) throw py::value_error("expected the carrier of a pad before it");
    joints = Numbers(py::reinterpret_borrow<py::object>(given[3])).size();  // low: one number per joint
    const py::ssize_t n = joints;
    const py::ssize_t sizes[] = {n, n, n, n, n, n, n * n, 6 * n, 3, 9, 3, 9, 3};
    const char* const names[] = {"position", "velocity", "motor_inertia", "low",   "high",      "fastest",  "inertia",
                                 "jacobian", "place",    "axes",          "pad_place", "pad_axes", "pad_half"};
    for (int k = 0; k < 13; ++k) fields.emplace_back(given[k], sizes[k], count, names[k]);
  }

  ArmState at(py::ssize_t q) const {
    const auto& f = fields;
    return {static_cast<int>(joints), f[0](q), f[1](q), f[2](q),  f[3](q),  f[4](q),  f[5](q), f[6](q),
            f[7](q),                  f[8](q), f[9](q), f[10](q), f[11](q), f[12](q), shape.value_or(Shape{}), carrier};
  }
};

using PointsOfPython = std::tuple<std::vector<int>, std::vector<int>, Numbers, Numbers, Numbers, Numbers>;

std::vector<Point> points_of(const PointsOfPython& given, int arms) {
  const auto& [first, partner, position, normal, gap, law] = given;
  const py::ssize_t count = partner.size();
  checked(position, 3 * count, "points.position");
  checked(normal, 3 * count, "points.normal");
  checked(gap, count, "points.gap");
  checked(law, 6 * count, "points.law");
  std::vector<Point> points;
  for (py::ssize_t i = 0; i < count; ++i) {
    if (partner[i] < 0 || partner[i] > arms) throw py::value_error("points.partner: there is no such arm");
    const double* l = law.data() + 6 * i;
    points.push_back({partner[i], vector(position.data() + 3 * i), vector(normal.data() + 3 * i), {}, gap.data()[i],
                      State::open, {l[0], l[1], l[2], l[3], l[4], l[5]}});
  }
  return points;
}

struct ObjectFields {
  std::vector<Field> fields;
  OptionalShape shape;

  ObjectFields(const py::sequence& given, py::ssize_t count) {
    if (given.size() != 7 && given.size() != 8) throw py::value_error("expected 7 fields of an object, 8 with a shape");
    if (given.size() == 8) shape = given[7].cast<OptionalShape>();
    const py::ssize_t sizes[] = {3, 9, 6, 1, 3, 3, 3};
    const char* const names[] = {"object.position", "object.rotation", "object.twist",     "object.mass",
                                 "object.half",     "object.inertia",  "object.com_offset"};
    for (int k = 0; k < 7; ++k) fields.emplace_back(given[k], sizes[k], count, names[k]);
  }

  ObjectState at(py::ssize_t q) const {
    const auto& o = fields;
    return {o[0](q), o[1](q), o[2](q), o[3](q), o[4](q), o[5](q), o[6](q), shape.value_or(Shape{})};
  }
};

py::tuple solve_impacts(py::ssize_t count, const py::sequence& arms, const py::sequence& object,
                        const py::sequence& contact, const py::object& support,
                        const std::tuple<double, double, double, double>& rules,
                        const std::optional<PointsOfPython>& given, const std::optional<Numbers>& near,
                        const py::sequence& neighbours) {
  std::vector<ArmFields> arm_fields;
  py::ssize_t joints = 0;
  for (const py::handle arm : arms) {
    const int own = static_cast<int>(arm_fields.size());
    arm_fields.emplace_back(py::reinterpret_borrow<py::sequence>(arm), count, own);
    const ArmFields& found = arm_fields.back();
    const ArmFields& carrier = arm_fields[found.carrier];
    if (carrier.joints != found.joints || carrier.carrier != found.carrier)
      throw py::value_error("a pad has the joints of its carrier, and a carrier has no carrier");
    if (found.carrier == own) joints += found.joints;
  }
  std::vector<ObjectFields> object_fields;
  object_fields.emplace_back(object, count);
  for (const py::handle one : neighbours) object_fields.emplace_back(py::reinterpret_borrow<py::sequence>(one), count);
  const bool alone = object_fields.size() == 1;
  if (contact.size() != (alone ? 3 : 4)) throw py::value_error("expected 3 fields of contact, 4 with neighbours");
  std::vector<Field> of_contact, of_support;
  const char* const coefficients[] = {"pad_friction", "support_friction", "restitution", "object_friction"};
  for (py::size_t k = 0; k < contact.size(); ++k) of_contact.emplace_back(contact[k], 1, count, coefficients[k]);
  if (!support.is_none()) of_support.emplace_back(support, 6, count, "support");

  const py::ssize_t k = arm_fields.size(), size = joints + 6 * static_cast<py::ssize_t>(object_fields.size());
  std::vector<Point> known;
  std::vector<int> where;
  if (given) {
    known = points_of(*given, static_cast<int>(k));
    where = std::get<0>(*given);
    const int most = static_cast<int>(known.size());
    bool in_order = static_cast<py::ssize_t>(where.size()) == count + 1 && where.front() == 0 && where.back() == most;
    for (std::size_t q = 1; q < where.size(); ++q) in_order = in_order && where[q - 1] <= where[q];
    if (!in_order) throw py::value_error("points.first: expected N + 1 numbers in order");
  }
  if (near) {
    checked(*near, 3 * static_cast<py::ssize_t>(known.size()), "near");
    for (std::size_t i = 0; i < known.size(); ++i) known[i].impulse = vector(near->data() + 3 * i);
  }
  Numbers velocity({count, size}), twists({count, 6 * k}), residual({count, py::ssize_t{4}}),
      energy({count, py::ssize_t{2}});
  py::array_t<int> status(count), steps(count), first(count + 1), partner, state;
  std::vector<double> positions, normals, gaps, impulses;
  std::vector<int> partners, states, bodies;
  {
    double *u = velocity.mutable_data(), *t = twists.mutable_data(), *r = residual.mutable_data(),
           *e = energy.mutable_data();
    int *s = status.mutable_data(), *n = steps.mutable_data(), *f = first.mutable_data();
    const py::gil_scoped_release others_may_run;
    Impact impact({std::get<0>(rules), std::get<1>(rules), std::get<2>(rules), std::get<3>(rules)});
    std::vector<ArmState> states_of_arms(k);
    std::vector<ObjectState> states_of_objects(object_fields.size());
    f[0] = 0;
    for (py::ssize_t q = 0; q < count; ++q) {
      for (py::ssize_t a = 0; a < k; ++a) states_of_arms[a] = arm_fields[a].at(q);
      for (std::size_t b = 0; b < object_fields.size(); ++b) states_of_objects[b] = object_fields[b].at(q);
      const auto& c = of_contact;
      const Status found = impact.solve(
          states_of_arms, states_of_objects,
          {c[0](q), c[1](q), c[2](q), of_support.empty() ? nullptr : of_support[0](q), alone ? nullptr : c[3](q)},
          given ? known.data() + where[q] : nullptr, given ? known.data() + where[q + 1] : nullptr, near.has_value());
      s[q] = static_cast<int>(found);
      n[q] = impact.steps;
      if (found == Status::invalid) {
        std::fill(u + q * size, u + (q + 1) * size, NAN);
        std::fill(t + q * 6 * k, t + (q + 1) * 6 * k, NAN);
        std::fill(r + 4 * q, r + 4 * q + 4, NAN);
        std::fill(e + 2 * q, e + 2 * q + 2, NAN);
        n[q] = 0;
        f[q + 1] = f[q];
        continue;
      }
      std::copy(impact.velocity.begin(), impact.velocity.end(), u + q * size);
      std::copy(impact.twists.begin(), impact.twists.end(), t + q * 6 * k);
      const double judged[] = {impact.laws.penetration, impact.laws.complementarity, impact.laws.friction,
                               impact.momentum};
      std::copy(judged, judged + 4, r + 4 * q);
      e[2 * q] = impact.energy;
      e[2 * q + 1] = impact.gain;
      f[q + 1] = f[q] + static_cast<int>(impact.points.size());
      for (const Point& point : impact.points) {
        partners.push_back(point.partner);
        bodies.push_back(point.body);
        states.push_back(static_cast<int>(point.state));
        gaps.push_back(point.gap);
        positions.insert(positions.end(), point.position.begin(), point.position.end());
        normals.insert(normals.end(), point.normal.begin(), point.normal.end());
        impulses.insert(impulses.end(), point.impulse.begin(), point.impulse.end());
      }
    }
  }
  const py::ssize_t points = gaps.size();
  return py::make_tuple(status, velocity, twists, residual, energy, steps, first,
                        py::array_t<int>(points, partners.data()), py::array_t<int>(points, states.data()),
                        array(positions, {points, 3}), array(normals, {points, 3}), array(gaps, {points}),
                        array(impulses, {points, 3}), py::array_t<int>(points, bodies.data()));
}

void add_impacts(py::module_& module) {
  module.attr("ACCEPTED") = ACCEPTED;
  py::class_<Shape>(module, "Shape")
      .def(py::init(&shape_of), py::arg("kind"), py::arg("corners") = py::none(),
           py::arg("faces") = std::vector<std::vector<int>>{});
  module.def("meet", &separating_axis_of, py::arg("partner"), py::arg("object"), py::arg("aligned"));
  module.def("touching", &contact_manifold_of, py::arg("partner"), py::arg("object"), py::arg("normal"),
             py::arg("on_object"), py::arg("edges"), py::arg("tolerance"));
  py::class_<TermsOfPython>(module, "Terms")
      .def(py::init<const Numbers&, const Numbers&, const Numbers&, const Numbers&, const Numbers&, const Numbers&,
                    double>(),
           py::arg("delassus"), py::arg("approach"), py::arg("normals"), py::arg("friction"), py::arg("rebound"),
           py::arg("inverse_mass"), py::arg("mobility"))
      .def("linearise", &TermsOfPython::linearise, py::arg("impulses"), py::arg("velocity"), py::arg("least"))
      .def("newton", &TermsOfPython::newton, py::arg("impulses"), py::arg("least"), py::arg("compliance"))
      .def("harden", &TermsOfPython::harden, py::arg("impulses"), py::arg("least"), py::arg("compliance"))
      .def("solve", &TermsOfPython::solve, py::arg("compliance"))
      .def("judge", &TermsOfPython::judge, py::arg("impulses"), py::arg("after"), py::arg("least"));
  module.def("solve_impacts", &solve_impacts, py::arg("count"), py::arg("arms"), py::arg("object"), py::arg("contact"),
             py::arg("support"), py::arg("rules"), py::arg("points") = py::none(), py::arg("near") = py::none(),
             py::arg("neighbours") = py::tuple());
}

}  // namespace
}  // namespace impact_rs

PYBIND11_MODULE(_kernel, module) {
  impact_rs::add_impacts(module);
  impact_rs::add_chain(module);
  impact_rs::add_control(module);
  impact_rs::add_drive(module);
  impact_rs::add_twin(module);
}
