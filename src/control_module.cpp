// SPDX-License-Identifier: Apache-2.0
// Python bindings of control.hpp, documented in impact_rs_sim/_kernel.pyi.

#include "control.hpp"
#include "module.hpp"

namespace impact_rs {
namespace {

class ObserverOfPython {
 public:
  ObserverOfPython(int joints, double gain, double period, double threshold, double forgetting,
                   const Numbers& direction)
      : observer_(joints, gain, period, threshold, forgetting, vector(checked(direction, 3, "direction"))) {}

  // `terms`: a RigidTerms of Python.
  bool update(const Numbers& velocity, const Numbers& torque, const py::object& terms, const Numbers& coriolis,
              int steps) {
    const py::ssize_t n = observer_.joints();
    const Columns inertia(terms.attr("mass_matrix"));
    const Numbers bias(terms.attr("bias")), jacobian(terms.attr("jacobian"));
    const RigidTerms rigid{checked(inertia, n * n, "mass_matrix"), checked(bias, n, "bias"),
                           checked(jacobian, 6 * n, "jacobian")};
    return observer_.update(checked(velocity, n, "velocity"), checked(torque, n, "torque"), rigid,
                            checked(coriolis, n * n, "coriolis"), steps);
  }

  Numbers wrench() const { return Numbers(6, observer_.wrench.data()); }
  double force() const { return observer_.force; }

 private:
  Observer observer_;
};

using PhaseOfPython = std::tuple<Numbers, Numbers, Numbers, Numbers>;

Phase phase_of(const PhaseOfPython& given, py::ssize_t ticks, py::ssize_t posture_tasks) {
  const auto& [position, velocity, acceleration, gains] = given;
  const py::ssize_t tasks = 6 + posture_tasks;
  return {copied(position, ticks * (3 + posture_tasks), "position"), copied(velocity, ticks * tasks, "velocity"),
          copied(acceleration, ticks * tasks, "acceleration"), copied(gains, tasks, "gains")};
}

class TaskLawOfPython {
 public:
  TaskLawOfPython(const Numbers& motor_inertia, const std::vector<int>& posture, const PhaseOfPython& ante,
                  const PhaseOfPython& post, const Numbers& orientation, const Numbers& wrench, double idle_rate,
                  bool idle)
      : ticks_(wrench.size() / 6),
        law_(copied(motor_inertia, motor_inertia.size(), "motor_inertia"), checked_posture(posture, motor_inertia.size()),
             phase_of(ante, ticks_, posture.size()), phase_of(post, ticks_, posture.size()),
             copied(orientation, 9 * ticks_, "orientation"), copied(wrench, 6 * ticks_, "wrench"), idle_rate, idle) {}

  // `terms`: a RigidTerms of Python.
  py::tuple decide(py::ssize_t tick, bool after, double gamma, const Numbers& position, const Numbers& velocity,
                   const py::object& terms) {
    if (tick < 0 || tick >= ticks_) throw py::index_error("tick: none of the plan");
    const py::ssize_t n = law_.joints(), rows = law_.rows();
    const Columns inertia(terms.attr("mass_matrix")), axes(terms.attr("rotation"));
    const Numbers jacobian(terms.attr("jacobian")), bias_acceleration(terms.attr("drift")), origin(terms.attr("position")),
        twist(terms.attr("twist"));
    const RigidTerms rigid{checked(inertia, n * n, "mass_matrix"), nullptr, checked(jacobian, 6 * n, "jacobian")};
    law_.decide(static_cast<int>(tick), after, gamma,
                {checked(position, n, "position"), checked(velocity, n, "velocity"), checked(bias_acceleration, 6, "drift"),
                 checked(origin, 3, "position"), checked(twist, 6, "twist"), checked(axes, 9, "rotation")},
                rigid);
    return py::make_tuple(array(law_.feedback, {law_.tasks()}), array(law_.matrix, {rows, n}),
                          array(law_.targets, {rows}), array(law_.inertia, {n, n}));
  }

 private:
  static std::vector<int> checked_posture(const std::vector<int>& posture, py::ssize_t joints) {
    for (int joint : posture)
      if (joint < 0 || joint >= joints) throw py::value_error("posture: there is no such joint");
    return posture;
  }

  py::ssize_t ticks_;
  TaskLaw law_;
};

class ProgramOfPython {
 public:
  ProgramOfPython(const Numbers& low, const Numbers& high, const Numbers& fastest, const Numbers& strongest,
                  double period, double regularisation)
      : program_(copied(low, strongest.size(), "low"), copied(high, strongest.size(), "high"),
                 copied(fastest, strongest.size(), "fastest"), copied(strongest, strongest.size(), "strongest"), period,
                 regularisation) {}

  void set(const Numbers& tasks, const Numbers& targets, const Numbers& weights, const Numbers& inertia,
           const Numbers& bias, const Numbers& position, const Numbers& velocity) {
    const py::ssize_t n = program_.joints(), rows = targets.size();
    program_.set(static_cast<int>(rows), checked(tasks, rows * n, "tasks"), targets.data(),
                 checked(weights, rows, "weights"), checked(inertia, n * n, "inertia"), checked(bias, n, "bias"),
                 checked(position, n, "position"), checked(velocity, n, "velocity"));
  }

  py::object free() {
    Numbers found(program_.joints());
    if (program_.free(found.mutable_data())) return found;
    return py::none();
  }

  py::tuple parts() const {
    const py::ssize_t n = program_.joints();
    return py::make_tuple(array(program_.hessian, {n, n}), array(program_.gradient, {n}), array(program_.lower, {n}),
                          array(program_.upper, {n}), array(program_.inertia, {n, n}),
                          array(program_.torque_lower, {n}), array(program_.torque_upper, {n}));
  }

 private:
  Program program_;
};

}  // namespace

void add_control(py::module_& module) {
  module.attr("MOVABLE") = MOVABLE;
  module.attr("SEPARABLE") = SEPARABLE;
  py::class_<ObserverOfPython>(module, "Observer")
      .def(py::init<int, double, double, double, double, const Numbers&>(), py::arg("joints"), py::arg("gain"),
           py::arg("period"), py::arg("threshold"), py::arg("forgetting"), py::arg("direction"))
      .def("update", &ObserverOfPython::update, py::arg("velocity"), py::arg("torque"), py::arg("terms"),
           py::arg("coriolis"), py::arg("steps") = 1)
      .def_property_readonly("wrench", &ObserverOfPython::wrench)
      .def_property_readonly("force", &ObserverOfPython::force);
  py::class_<TaskLawOfPython>(module, "TaskLaw")
      .def(py::init<const Numbers&, const std::vector<int>&, const PhaseOfPython&, const PhaseOfPython&, const Numbers&,
                    const Numbers&, double, bool>(),
           py::arg("motor_inertia"), py::arg("posture"), py::arg("ante"), py::arg("post"), py::arg("orientation"),
           py::arg("wrench"), py::arg("idle_rate"), py::arg("idle"))
      .def("decide", &TaskLawOfPython::decide, py::arg("tick"), py::arg("after"), py::arg("gamma"),
           py::arg("position"), py::arg("velocity"), py::arg("terms"));
  py::class_<ProgramOfPython>(module, "Program")
      .def(py::init<const Numbers&, const Numbers&, const Numbers&, const Numbers&, double, double>(), py::arg("low"),
           py::arg("high"), py::arg("fastest"), py::arg("strongest"), py::arg("period"), py::arg("regularisation"))
      .def("set", &ProgramOfPython::set, py::arg("tasks"), py::arg("targets"), py::arg("weights"), py::arg("inertia"),
           py::arg("bias"), py::arg("position"), py::arg("velocity"))
      .def("free", &ProgramOfPython::free)
      .def("parts", &ProgramOfPython::parts);
}

}  // namespace impact_rs
