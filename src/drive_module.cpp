// SPDX-License-Identifier: Apache-2.0
// Python bindings of drive.hpp, documented in impact_rs_sim/_kernel.pyi.

#include <optional>
#include <tuple>

#include "drive.hpp"
#include "module.hpp"

namespace impact_rs {
namespace {

// A tuple of numbers (as Bullet returns them) or an array.
class Values {
 public:
  Values(const py::handle& given, std::size_t size, const char* name) {
    if (PyTuple_CheckExact(given.ptr()) && PyTuple_GET_SIZE(given.ptr()) == static_cast<py::ssize_t>(size)) {
      copy_.resize(size);
      for (std::size_t i = 0; i < size; ++i) copy_[i] = PyFloat_AsDouble(PyTuple_GET_ITEM(given.ptr(), i));
      if (PyErr_Occurred() != nullptr) throw py::error_already_set();
      return;
    }
    numbers_ = Numbers(py::reinterpret_borrow<py::object>(given));
    checked(numbers_, size, name);
  }
  const double* data() const { return copy_.empty() ? numbers_.data() : copy_.data(); }

 private:
  std::vector<double> copy_;
  Numbers numbers_;
};

using PerJoint = std::vector<double>;
using Sigmoid = std::tuple<PerJoint, PerJoint, PerJoint>;
using Shafts = std::tuple<PerJoint, PerJoint, PerJoint, PerJoint>;
using FrictionOfPython = std::tuple<PerJoint, PerJoint, PerJoint, PerJoint, PerJoint, PerJoint, PerJoint,
                                    std::optional<Sigmoid>, std::optional<Shafts>>;

Friction friction_of(const std::optional<FrictionOfPython>& given, std::size_t joints) {
  if (!given) return {};
  const auto& [coulomb, viscous, stribeck, stribeck_velocity, smoothing, asymmetry, load, sigmoid, shafts] = *given;
  Friction found{};
  found.coulomb = coulomb, found.viscous = viscous, found.stribeck = stribeck;
  found.stribeck_velocity = stribeck_velocity, found.smoothing = smoothing;
  found.asymmetry = asymmetry, found.load = load;
  std::vector<const PerJoint*> parts{&found.coulomb,           &found.viscous,   &found.stribeck,
                                     &found.stribeck_velocity, &found.smoothing, &found.asymmetry,
                                     &found.load};
  if (sigmoid) {
    std::tie(found.a, found.b, found.c) = *sigmoid;
    parts.insert(parts.end(), {&found.a, &found.b, &found.c});
  }
  if (shafts) {
    std::tie(found.shaft_coulomb, found.shaft_viscous, found.shaft_ratio, found.shaping) = *shafts;
    const std::size_t count = found.shaft_coulomb.size();
    if (found.shaft_viscous.size() != count || found.shaft_ratio.size() != count ||
        (count > 0 && (joints < 2 || count % (joints - 1) != 0)))
      throw py::value_error("friction: not a number per pair of joints");
    parts.push_back(&found.shaping);
  }
  for (const PerJoint* part : parts)
    if (part->size() != joints) throw py::value_error("friction: not a number per joint");
  return found;
}

class DriveOfPython {
 public:
  DriveOfPython(const Numbers& stiffness, const Numbers& damping, const Numbers& feedback, const Numbers& rotor_inverse,
                const std::optional<FrictionOfPython>& friction, double period)
      : drive_(copied(stiffness, stiffness.size(), "stiffness"), copied(damping, stiffness.size(), "damping"),
               copied(feedback, stiffness.size(), "feedback"),
               copied(rotor_inverse, stiffness.size(), "rotor_inverse"), friction_of(friction, stiffness.size()),
               period) {}

  void place(const Numbers& position, const Numbers& velocity, const Numbers& elastic, const Numbers& transmission) {
    const auto size = static_cast<py::ssize_t>(drive_.joints());
    drive_.position = copied(position, size, "position");
    drive_.velocity = copied(velocity, size, "velocity");
    drive_.elastic = copied(elastic, size, "elastic");
    drive_.transmission = copied(transmission, size, "transmission");
  }

  void sense(const py::handle& position, const py::handle& velocity) {
    const Values q(position, drive_.joints(), "position"), dq(velocity, drive_.joints(), "velocity");
    drive_.sense(q.data(), dq.data());
  }

  void integrate(const Numbers& shaped) { drive_.step(checked(shaped, drive_.joints(), "shaped")); }

  const Drive& drive() const { return drive_; }

  template <std::vector<double> Drive::*State>
  Numbers get() const {
    return array(drive_.*State, {static_cast<py::ssize_t>(drive_.joints())});
  }
  template <std::vector<double> Drive::*State>
  void set(const Numbers& values) {
    drive_.*State = copied(values, drive_.joints(), "values");
  }

 private:
  Drive drive_;
};

}  // namespace

const Drive& drive_of(const py::object& motors) { return motors.cast<const DriveOfPython&>().drive(); }

void add_drive(py::module_& module) {
  using Python = DriveOfPython;
  py::class_<Python>(module, "Motors")
      .def(py::init<const Numbers&, const Numbers&, const Numbers&, const Numbers&, const std::optional<FrictionOfPython>&,
                    double>(),
           py::arg("stiffness"), py::arg("damping"), py::arg("feedback"), py::arg("rotor_inverse"),
           py::arg("friction"), py::arg("period"))
      .def("place", &Python::place, py::arg("position"), py::arg("velocity"), py::arg("elastic"),
           py::arg("transmission"))
      .def("sense", &Python::sense, py::arg("link_position"), py::arg("link_velocity"))
      .def("integrate", &Python::integrate, py::arg("shaped"))
      .def_property("position", &Python::get<&Drive::position>, &Python::set<&Drive::position>)
      .def_property("velocity", &Python::get<&Drive::velocity>, &Python::set<&Drive::velocity>)
      .def_property_readonly("actuation_torque", &Python::get<&Drive::actuation>)
      .def_property_readonly("friction_torque", &Python::get<&Drive::friction>)
      .def_property("elastic_torque", &Python::get<&Drive::elastic>, &Python::set<&Drive::elastic>)
      .def_property("transmission_torque", &Python::get<&Drive::transmission>, &Python::set<&Drive::transmission>);
}

}  // namespace impact_rs
