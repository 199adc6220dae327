// SPDX-License-Identifier: Apache-2.0
// Python bindings of chain.hpp, documented in impact_rs_sim/_kernel.pyi.

#include "chain.hpp"

#include "module.hpp"

namespace impact_rs {
namespace {

Matrix matrix(const double* values) {
  Matrix found;
  std::copy(values, values + 9, found.begin());
  return found;
}

Chain chain_of(const Numbers& rotations, const Numbers& origins, const std::vector<bool>& prismatic, const Numbers& masses,
               const Numbers& coms, const Numbers& inertias, const Numbers& gravity, const Numbers& tip) {
  const auto n = static_cast<py::ssize_t>(prismatic.size());
  const double *axes = checked(rotations, 9 * n, "rotations"), *origin = checked(origins, 3 * n, "origins"),
               *mass = checked(masses, n, "masses"), *com = checked(coms, 3 * n, "coms"),
               *inertia = checked(inertias, 9 * n, "inertias");
  std::vector<Joint> joints;
  std::vector<Link> links;
  for (py::ssize_t i = 0; i < n; ++i) {
    joints.push_back({matrix(axes + 9 * i), vector(origin + 3 * i), prismatic[i]});
    links.push_back({mass[i], vector(com + 3 * i), matrix(inertia + 9 * i)});
  }
  return Chain(std::move(joints), std::move(links), vector(checked(gravity, 3, "gravity")),
               vector(checked(tip, 3, "tip")));
}

py::tuple momentum(Chain& chain, const Numbers& position, const Numbers& velocity) {
  const auto n = static_cast<py::ssize_t>(chain.joints());
  if (n == 0 || position.size() % n != 0) throw py::value_error("position: not a number per joint");
  const py::ssize_t rows = position.size() / n;
  const double *q = position.data(), *dq = checked(velocity, position.size(), "velocity");
  Numbers moved({rows, n}), known({rows, n}), twist({rows, py::ssize_t{6}});
  for (py::ssize_t row = 0; row < rows; ++row)
    chain.momentum(q + row * n, dq + row * n, moved.mutable_data() + row * n, known.mutable_data() + row * n,
                   twist.mutable_data() + row * 6);
  return py::make_tuple(moved, known, twist);
}

}  // namespace

void add_chain(py::module_& module) {
  py::class_<Chain>(module, "Chain")
      .def(py::init(&chain_of), py::arg("rotations"), py::arg("origins"), py::arg("slides"), py::arg("masses"),
           py::arg("coms"), py::arg("inertias"), py::arg("gravity"), py::arg("tip"))
      .def("momentum", &momentum, py::arg("position"), py::arg("velocity"));
}

}  // namespace impact_rs
