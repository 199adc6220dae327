// SPDX-License-Identifier: Apache-2.0
// Numbers between Python and the kernel, and the parts of the module that stand in files of their own.

#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "shapes.hpp"

namespace impact_rs {

namespace py = pybind11;

using Numbers = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Columns = py::array_t<double, py::array::f_style | py::array::forcecast>;  // as Pinocchio has M
using ArrayShape = std::vector<py::ssize_t>;

inline Numbers array(const std::vector<double>& values, ArrayShape shape) {
  return Numbers(std::move(shape), values.data());
}

// The numbers of an array of doubles that has as many.
inline const double* checked(const py::array& values, py::ssize_t size, const char* name) {
  if (values.size() != size)
    throw py::value_error(std::string(name) + ": expected " + std::to_string(size) + " numbers, got " +
                          std::to_string(values.size()));
  return static_cast<const double*>(values.data());
}

inline std::vector<double> copied(const Numbers& values, py::ssize_t size, const char* name) {
  const double* first = checked(values, size, name);
  return {first, first + size};
}

// A copy that may be written to, in the same shape.
inline Numbers own(const Numbers& values) {
  return Numbers(ArrayShape(values.shape(), values.shape() + values.ndim()), values.data());
}

using OptionalShape = std::optional<Shape>;  // of Python; none: a box

class Drive;
const Drive& drive_of(const py::object& motors);  // of Motors; drive_module.cpp

void add_chain(py::module_& module);    // chain_module.cpp
void add_control(py::module_& module);  // control_module.cpp
void add_drive(py::module_& module);    // drive_module.cpp
void add_twin(py::module_& module);     // twin_module.cpp

}  // namespace impact_rs
