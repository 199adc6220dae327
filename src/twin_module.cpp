// SPDX-License-Identifier: Apache-2.0
// Python bindings of twin.hpp, documented in impact_rs_sim/_kernel.pyi.

#include <atomic>
#include <exception>
#include <stdexcept>
#include <thread>

#include "module.hpp"
#include "twin.hpp"

namespace impact_rs {
namespace {

using Rows = py::array_t<int, py::array::c_style | py::array::forcecast>;
using PadOfPython = std::tuple<Numbers, Numbers, Numbers, std::optional<double>, double, double, double, OptionalShape>;
using ToolOfPython = std::tuple<Numbers, double>;
using PullOfPython = std::tuple<Numbers, double, Numbers>;
using FormulaOfPython = std::tuple<std::string, int, int, std::vector<int>, std::vector<double>>;
using BoxOfPython = std::tuple<double, Numbers, Numbers, Numbers, OptionalShape, std::optional<Numbers>>;
using SupportOfPython = std::tuple<double, double, double, double, double>;
using ArmStartOfPython = std::tuple<Numbers, Numbers, Numbers, Numbers, Numbers, Numbers, Numbers>;
using BoxStartOfPython = std::tuple<Numbers, Numbers, Numbers>;
using TorqueInputOfPython = std::tuple<Numbers, Rows>;
using JobOfPython = std::tuple<const TwinModel*, std::vector<ArmStartOfPython>, std::vector<BoxStartOfPython>, Numbers,
                               int, std::vector<TorqueInputOfPython>>;

Vector vector_of(const Numbers& values, const char* name) { return vector(checked(values, 3, name)); }

Matrix matrix_of(const Numbers& values, const char* name) {
  Matrix found;
  std::copy_n(checked(values, 9, name), 9, found.begin());
  return found;
}

// Torques of a function of the symbols of the scene, q, dq and tau_J.
PythonLoad load_of(const py::function& function, std::size_t n) {
  return [function, n](const double* symbols, const double* q, const double* dq, const double* torque, double* on_links,
                       double* on_motors) {
    const py::gil_scoped_acquire acquire;
    const auto count = static_cast<py::ssize_t>(n);
    const auto torques =
        function(Numbers(of_joints, symbols), Numbers(count, q), Numbers(count, dq), Numbers(count, torque))
            .cast<std::tuple<Numbers, Numbers>>();
    const double* parts[] = {checked(std::get<0>(torques), count, "torque on the links"),
                             checked(std::get<1>(torques), count, "torque on the motors")};
    for (std::size_t i = 0; i < n; ++i) {
      on_links[i] += parts[0][i];
      on_motors[i] += parts[1][i];
    }
  };
}

ArmModel arm_of(const Chain& links, const py::object& motors, const Numbers& shaping, const Numbers& gain,
                const Numbers& offset, const Numbers& stiffness, const Numbers& damping, double delay, bool joint_torque,
                const PadOfPython& pad, const std::optional<ToolOfPython>& tool, const std::optional<PullOfPython>& spring,
                const std::vector<FormulaOfPython>& formulas, const std::optional<py::function>& load) {
  const auto n = static_cast<py::ssize_t>(links.joints());
  const auto& [centre, rotation, half, pad_stiffness, pad_damping, shear_compliance, creep, shape] = pad;
  ArmModel arm{links,
               drive_of(motors),
               copied(shaping, n, "shaping"),
               copied(gain, n, "gain"),
               copied(offset, n, "offset"),
               copied(stiffness, n, "stiffness"),
               copied(damping, n, "damping"),
               delay,
               joint_torque,
               {vector_of(centre, "pad"), matrix_of(rotation, "pad"), vector_of(half, "pad"), !pad_stiffness,
                pad_stiffness.value_or(0.0), pad_damping, shear_compliance, creep, shape.value_or(Shape{})},
               {},
               std::nullopt,
               {},
               load ? load_of(*load, links.joints()) : PythonLoad{}};
  if (tool) {
    const auto& [motions, lag] = *tool;
    if (motions.size() % 6 != 0) throw py::value_error("tool: expected the six components of a twist in every row");
    arm.tool.lag = lag;
    for (const double* row = motions.data(); row < motions.data() + motions.size(); row += 6)
      arm.tool.motions.push_back({vector(row + 3), vector(row)});
  }
  if (spring) {
    const auto& [force, k, position] = *spring;
    arm.spring = CartesianSpring{vector_of(force, "pull"), k, vector_of(position, "pull")};
  }
  for (const auto& [effect, acts, index, code, constants] : formulas) {
    if (acts < 0 || acts > static_cast<int>(Acts::along_pad)) throw py::value_error("formula: acts on no arm");
    const auto limit = acts <= static_cast<int>(Acts::on_motor) ? n : 3;
    if (index < 0 || index >= limit) throw py::value_error("formula: unknown joint or axis");
    arm.formulas.push_back({effect, static_cast<Acts>(acts), index, Formula(code, constants, static_cast<int>(n))});
  }
  if (static_cast<py::ssize_t>(arm.drive.joints()) != n) throw py::value_error("motors: not one per joint");
  return arm;
}

TwinModel model_of(const std::vector<const ArmModel*>& arms, const std::vector<BoxOfPython>& boxes,
                   const std::optional<SupportOfPython>& support, double pad_friction, double box_friction,
                   double rolling_arm,
                   const Numbers& gravity, double period, int refinement,
                   const std::vector<FormulaOfPython>& formulas) {
  TwinModel model{{}, {}, std::nullopt, pad_friction, box_friction, rolling_arm, vector_of(gravity, "gravity"), period,
                  refinement, {}};
  for (const auto& [mass, half, inertia, offset, shape, guide] : boxes) {
    model.boxes.push_back({mass, vector_of(half, "boxes"), vector_of(inertia, "boxes"), vector_of(offset, "boxes"),
                           shape.value_or(Shape{}), std::nullopt});
    if (!guide) continue;
    if (boxes.size() > 1) throw py::value_error("boxes: one on a hinge or slide has no neighbours");
    const double* twist = checked(*guide, 6, "boxes");
    model.boxes.back().guide = Spatial{vector(twist + 3), vector(twist)};
  }
  for (const auto& [effect, acts, index, code, constants] : formulas) {
    if (acts < static_cast<int>(Acts::on_object) || acts > static_cast<int>(Acts::along_support))
      throw py::value_error("formula: does not act on the object");
    if (index < 0 || index >= 3) throw py::value_error("formula: unknown axis");
    model.formulas.push_back({effect, static_cast<Acts>(acts), index, Formula(code, constants, 0)});
  }
  for (const ArmModel* arm : arms) model.arms.push_back(*arm);
  if (support) {
    const auto& [height, half_x, half_y, friction, compliance] = *support;
    model.support = SupportModel{height, half_x, half_y, friction, compliance};
  }
  if (refinement < 1) throw py::value_error("refinement: expected 1 or more");
  return model;
}

ArmStart arm_start_of(const ArmStartOfPython& given, py::ssize_t n) {
  const auto& [q, dq, torque, rate, times, earlier, before] = given;
  if (times.size() == 0) throw py::value_error("earlier: expected one command or more");
  const double* row = checked(earlier, n * times.size(), "earlier");
  if (before.size() % (1 + 3 * n) != 0) throw py::value_error("before: expected time, q, dq and torque in every row");
  std::deque<Command> commands;
  for (py::ssize_t i = 0; i < times.size(); ++i, row += n) commands.push_back({times.data()[i], {row, row + n}});
  return {copied(q, n, "position"), copied(dq, n, "velocity"), copied(torque, n, "torque"), copied(rate, n, "torque rate"),
          std::move(commands), copied(before, before.size(), "before")};
}

TwinStart start_of(const TwinModel& model, const std::vector<ArmStartOfPython>& arms,
                   const std::vector<BoxStartOfPython>& boxes) {
  TwinStart start;
  if (arms.size() != model.arms.size()) throw py::value_error("arms: not those of the model");
  for (std::size_t i = 0; i < arms.size(); ++i)
    start.arms.push_back(arm_start_of(arms[i], static_cast<py::ssize_t>(model.arms[i].links.joints())));
  if (!boxes.empty() && boxes.size() != model.boxes.size()) throw py::value_error("boxes: not those of the model");
  for (const auto& [centre, rotation, given] : boxes) {
    const double* twist = checked(given, 6, "boxes");
    start.boxes.push_back({vector_of(centre, "boxes"), matrix_of(rotation, "boxes"), vector(twist), vector(twist + 3)});
  }
  return start;
}

TorqueTrajectory trajectory_of(const TwinModel& model, const Numbers& time, int substeps,
                               const std::vector<TorqueInputOfPython>& arms) {
  if (time.size() == 0 || substeps < 1) throw py::value_error("time: expected ticks, and periods between them");
  if (arms.size() != model.arms.size()) throw py::value_error("driving: not that of the arms of the model");
  TorqueTrajectory trajectory{copied(time, time.size(), "time"), substeps, {}};
  const py::ssize_t periods = (time.size() - 1) * substeps;
  for (std::size_t i = 0; i < arms.size(); ++i) {
    const auto& [torques, row_by_period] = arms[i];
    const auto rows = torques.size() / static_cast<py::ssize_t>(model.arms[i].links.joints());
    if (row_by_period.size() != periods) throw py::value_error("acting: expected a row for every period");
    for (py::ssize_t k = 0; k < periods; ++k)
      if (row_by_period.data()[k] < 0 || row_by_period.data()[k] >= rows) throw py::value_error("acting: no such row");
    trajectory.arms.push_back({torques.data(), row_by_period.data()});
  }
  return trajectory;
}

// A simulation tick by tick, under torques that may depend on its state.
class TwinRun {
 public:
  TwinRun(const TwinModel& model, const std::vector<ArmStartOfPython>& arms, const std::vector<BoxStartOfPython>& boxes)
      : model_(model), twin_(model_, start_of(model_, arms, boxes)), state_(twin_.state_size()) {
    twin_.state(state_.data(), nullptr);
  }
  TwinRun(const TwinRun&) = delete;

  // The state afterwards.
  Numbers step(double time, int substeps, const std::vector<Numbers>& torques) {
    if (torques.size() != model_.arms.size()) throw py::value_error("torque: expected one by arm");
    std::vector<const double*> desired;
    for (std::size_t i = 0; i < torques.size(); ++i)
      desired.push_back(checked(torques[i], model_.arms[i].links.joints(), "torque"));
    const std::vector<double> before = state_;
    if (twin_.tick(time, substeps, desired)) {
      twin_.state(state_.data(), before.data());
    } else {
      std::fill(state_.begin(), state_.end(), NAN);
    }
    return state();
  }

  Numbers state() const { return array(state_, {static_cast<py::ssize_t>(state_.size())}); }
  Numbers pad_force(std::size_t arm) const {
    if (arm >= model_.arms.size()) throw py::index_error("no such arm");
    const Vector& force = twin_.pad_force(static_cast<int>(arm));
    return Numbers(3, force.data());
  }
  bool asleep() const { return twin_.asleep(); }
  double residual() const { return twin_.report().residual; }
  const std::vector<double>& failed() const { return twin_.report().failed; }

 private:
  const TwinModel model_;
  Twin twin_;
  std::vector<double> state_;
};

// Result of one job.
struct Outcome {
  Numbers rows;
  double* data;
  TwinReport report;
  std::string failure;
  std::exception_ptr thrown;
};

void run_one(const TwinModel& model, const TwinStart& start, const TorqueTrajectory& trajectory, Outcome& outcome) {
  try {
    Twin twin(model, start);
    std::fill_n(outcome.data, trajectory.time.size() * twin.state_size(), NAN);
    try {
      twin.run(trajectory, outcome.data);
    } catch (const std::runtime_error& error) {
      outcome.failure = error.what();
    }
    outcome.report = twin.report();
  } catch (...) {
    outcome.thrown = std::current_exception();
  }
}

py::list run_twins(const std::vector<JobOfPython>& jobs, int threads) {
  std::vector<TwinStart> starts;
  std::vector<TorqueTrajectory> trajectories;
  std::vector<Outcome> outcomes;
  for (const auto& [model, arms, boxes, time, substeps, inputs] : jobs) {
    starts.push_back(start_of(*model, arms, boxes));
    trajectories.push_back(trajectory_of(*model, time, substeps, inputs));
    std::size_t row = BOX_ROW * boxes.size();
    for (const ArmStart& arm : starts.back().arms) row += 5 * arm.position.size();
    Numbers rows({time.size(), static_cast<py::ssize_t>(row)});
    double* data = rows.mutable_data();
    outcomes.push_back({std::move(rows), data, {}, {}, nullptr});
  }
  {
    const py::gil_scoped_release release;
    std::atomic<std::size_t> next{0};
    const auto work = [&] {
      for (std::size_t i = next++; i < jobs.size(); i = next++)
        run_one(*std::get<0>(jobs[i]), starts[i], trajectories[i], outcomes[i]);
    };
    std::vector<std::thread> pool;
    for (std::size_t i = 1; i < std::min<std::size_t>(std::max(threads, 1), jobs.size()); ++i) pool.emplace_back(work);
    work();
    for (std::thread& thread : pool) thread.join();
  }
  py::list found;
  for (Outcome& outcome : outcomes) {
    if (outcome.thrown) std::rethrow_exception(outcome.thrown);
    const TwinReport& report = outcome.report;
    found.append(py::make_tuple(outcome.rows, report.steps, report.contact_steps, report.iterations, report.fallbacks,
                                report.residual, report.failed, outcome.failure));
  }
  return found;
}

}  // namespace

void add_twin(py::module_& module) {
  module.attr("SYMBOLS") = py::cast(std::vector<std::string>(std::begin(SYMBOLS), std::end(SYMBOLS)));
  module.attr("OPERATIONS") = py::cast(std::vector<std::string>(std::begin(Formula::NAMES), std::end(Formula::NAMES)));
  py::class_<ArmModel>(module, "TwinArm")
      .def(py::init(&arm_of), py::arg("links"), py::arg("motors"), py::arg("shaping"), py::arg("gain"), py::arg("offset"),
           py::arg("stiffness"), py::arg("damping"), py::arg("delay"), py::arg("joint_torque"), py::arg("pad"),
           py::arg("tool"), py::arg("pull"), py::arg("formulas"), py::arg("load"));
  py::class_<TwinModel>(module, "Twin")
      .def(py::init(&model_of), py::arg("arms"), py::arg("boxes"), py::arg("support"), py::arg("pad_friction"),
           py::arg("box_friction"), py::arg("rolling_arm"), py::arg("gravity"), py::arg("period"),
           py::arg("refinement"), py::arg("formulas"));
  py::class_<TwinRun>(module, "TwinRun")
      .def(py::init<const TwinModel&, const std::vector<ArmStartOfPython>&, const std::vector<BoxStartOfPython>&>(),
           py::arg("model"), py::arg("arms"), py::arg("boxes"))
      .def("step", &TwinRun::step, py::arg("time"), py::arg("substeps"), py::arg("torques"))
      .def("pad_force", &TwinRun::pad_force, py::arg("arm"))
      .def_property_readonly("state", &TwinRun::state)
      .def_property_readonly("asleep", &TwinRun::asleep)
      .def_property_readonly("residual", &TwinRun::residual)
      .def_property_readonly("failed", &TwinRun::failed);
  module.def("run_twins", &run_twins, py::arg("jobs"), py::arg("threads"));
}

}  // namespace impact_rs
