// SPDX-License-Identifier: Apache-2.0
// What Python sees of drive.hpp; impact_rs_sim/_kernel.pyi says it in Python's words.

#include <optional>

#include "drive.hpp"
#include "module.hpp"

namespace impact_rs {
namespace {

// Numbers that Bullet hands out as a tuple, or an array.
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

class DriveOfPython {
 public:
  DriveOfPython(const Numbers& stiffness, const Numbers& damping, const Numbers& feedback, const Numbers& rotor_inverse,
                double period)
      : drive_(copied(stiffness, stiffness.size(), "stiffness"), copied(damping, stiffness.size(), "damping"),
               copied(feedback, stiffness.size(), "feedback"),
               copied(rotor_inverse, stiffness.size(), "rotor_inverse"), period),
        shape_{stiffness.size()} {}

  void place(const Numbers& position, const Numbers& velocity, const Numbers& elastic, const Numbers& transmission) {
    const py::ssize_t size = position.size();
    if (size == 0 || size % drive_.joints() != 0) throw py::value_error("position: not a number per joint");
    drive_.resize(size);
    shape_.assign(position.shape(), position.shape() + position.ndim());
    drive_.position = copied(position, size, "position");
    drive_.velocity = copied(velocity, size, "velocity");
    drive_.elastic = copied(elastic, size, "elastic");
    drive_.transmission = copied(transmission, size, "transmission");
  }

  void sense(const py::handle& position, const py::handle& velocity) {
    const Values q(position, drive_.size(), "position"), dq(velocity, drive_.size(), "velocity");
    drive_.sense(q.data(), dq.data());
  }

  void turn(const Numbers& shaped, const std::optional<Numbers>& friction) {
    const double* wanted = checked(shaped, drive_.size(), "shaped");
    drive_.step(wanted, friction ? checked(*friction, drive_.size(), "friction") : nullptr);
  }

  template <std::vector<double> Drive::*State>
  Numbers get() const {
    return array(drive_.*State, shape_);
  }
  template <std::vector<double> Drive::*State>
  void set(const Numbers& values) {
    drive_.*State = copied(values, drive_.size(), "values");
  }

 private:
  Drive drive_;
  Shape shape_;
};

}  // namespace

void add_drive(py::module_& module) {
  using Python = DriveOfPython;
  py::class_<Python>(module, "Motors")
      .def(py::init<const Numbers&, const Numbers&, const Numbers&, const Numbers&, double>(), py::arg("stiffness"),
           py::arg("damping"), py::arg("feedback"), py::arg("rotor_inverse"), py::arg("period"))
      .def("place", &Python::place, py::arg("position"), py::arg("velocity"), py::arg("elastic"),
           py::arg("transmission"))
      .def("sense", &Python::sense, py::arg("link_position"), py::arg("link_velocity"))
      .def("turn", &Python::turn, py::arg("shaped"), py::arg("friction"))
      .def_property("position", &Python::get<&Drive::position>, &Python::set<&Drive::position>)
      .def_property("velocity", &Python::get<&Drive::velocity>, &Python::set<&Drive::velocity>)
      .def_property_readonly("actuation_torque", &Python::get<&Drive::actuation>)
      .def_property("elastic_torque", &Python::get<&Drive::elastic>, &Python::set<&Drive::elastic>)
      .def_property("transmission_torque", &Python::get<&Drive::transmission>, &Python::set<&Drive::transmission>);
}

}  // namespace impact_rs
