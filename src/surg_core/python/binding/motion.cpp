#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/profiler.hpp"
#include "surg_core/quintic.hpp"
#include "surg_core/stream.hpp"

namespace surg::python {
namespace {

constexpr int kDof = Profiler::kDof;

std::array<double, kDof> to_dofs(const Array& array, const char* name) {
  const Vector4 v = to_vector4(array, name);
  return {v[0], v[1], v[2], v[3]};
}

void bind_quintic(py::module_& m) {
  py::class_<Kinematic>(m, "Kinematic",
                        "Position, velocity, acceleration of one degree of freedom.")
      .def(py::init([](double x, double v, double a) {
             return Kinematic{x, v, a};
           }),
           py::arg("x") = 0.0, py::arg("v") = 0.0, py::arg("a") = 0.0)
      .def_readonly("x", &Kinematic::x)
      .def_readonly("v", &Kinematic::v)
      .def_readonly("a", &Kinematic::a)
      .def("__repr__", [](const Kinematic& k) {
        return py::str("Kinematic(x={!r}, v={!r}, a={!r})").format(k.x, k.v, k.a);
      });

  py::class_<Quintic>(m, "Quintic", "x(t) of degree five on [0, d] with given states at both ends.")
      .def(py::init<const Kinematic&, const Kinematic&, double>(), py::arg("start"), py::arg("end"),
           py::arg("duration"), "duration [s]; not positive: the constant end state.")
      .def_property_readonly("duration", &Quintic::duration)
      .def("at", &Quintic::at, py::arg("t"), "State at time t [s], clamped to [0, d].")
      .def("jerk", &Quintic::jerk, py::arg("t"), "Jerk at time t, clamped to [0, d].")
      .def("max_velocity", &Quintic::max_velocity, "Largest |v| on [0, d], exact.")
      .def("max_acceleration", &Quintic::max_acceleration, "Largest |a|, exact.")
      .def("max_jerk", &Quintic::max_jerk, "Largest |jerk|, exact.")
      .def("min_position", &Quintic::min_position, "Least x, exact; may lie outside the two ends.")
      .def("max_position", &Quintic::max_position, "Greatest x, exact.");
}

void bind_profiler(py::module_& m) {
  py::class_<DofLimits>(m, "DofLimits", "Limits of one degree of freedom.")
      .def(py::init([](double v, double a, double j) {
             return DofLimits{v, a, j};
           }),
           py::arg("velocity"), py::arg("acceleration"), py::arg("jerk"))
      .def_readonly("velocity", &DofLimits::velocity)
      .def_readonly("acceleration", &DofLimits::acceleration)
      .def_readonly("jerk", &DofLimits::jerk);

  py::class_<Profiler>(
      m, "Profiler",
      "Discrete targets for four degrees of freedom: one quintic each with a common\n"
      "duration, extended until every limit holds.")
      .def(py::init<const std::array<DofLimits, kDof>&, double>(), py::arg("limits"),
           py::arg("base_duration") = 0.5, "Four DofLimits; base_duration [s].")
      .def(
          "reset", [](Profiler& p, const Array& x) { p.reset(to_dofs(x, "x")); }, py::arg("x"),
          "Stands still at x (4,).")
      .def(
          "reset_to", [](Profiler& p, const std::array<Kinematic, kDof>& state) { p.reset(state); },
          py::arg("state"), "Starts from four given states.")
      .def(
          "plan", [](Profiler& p, const Array& target) { p.plan(to_dofs(target, "target")); },
          py::arg("target"), "Plans from the present state to rest at target (4,).")
      .def(
          "plan_fixed",
          [](Profiler& p, const Array& target, double duration) {
            p.plan_fixed(to_dofs(target, "target"), duration);
          },
          py::arg("target"), py::arg("duration"), "The same in a fixed time [s], limits or not.")
      .def("advance", &Profiler::advance, py::arg("dt"))
      .def_property_readonly("state", &Profiler::state)
      .def_property_readonly("done", &Profiler::done)
      .def_property_readonly("duration", &Profiler::duration, "Of the present profile [s].")
      .def(
          "quintic",
          [](const Profiler& p, int dof) {
            if (dof < 0 || dof >= kDof) throw py::index_error("dof: 0 to 3");
            return p.quintic(dof);
          },
          py::arg("dof"));
}

void bind_stream(py::module_& m) {
  py::class_<AlphaBeta>(m, "AlphaBeta", "Fixed-gain estimate of position and velocity.")
      .def(py::init<>())
      .def("reset", &AlphaBeta::reset, py::arg("x"), py::arg("v") = 0.0)
      .def("update", &AlphaBeta::update, py::arg("x"), py::arg("spacing"),
           "A sample 'spacing' seconds after the last one.")
      .def("predict", &AlphaBeta::predict, py::arg("age"),
           "Estimate 'age' seconds after the last sample.");

  py::class_<StreamFilter>(
      m, "StreamFilter",
      "Follows a stream of targets within velocity, acceleration and jerk limits.")
      .def(py::init<const DofLimits&>(), py::arg("limits"))
      .def("reset", &StreamFilter::reset, py::arg("state"))
      .def("step", &StreamFilter::step, py::arg("target"), py::arg("T"),
           "One tick of T seconds towards a target predicted one tick ahead (x and v are used).")
      .def_property_readonly("state", &StreamFilter::state, py::return_value_policy::copy);
}

}  // namespace

void bind_motion(py::module_& m) {
  bind_quintic(m);
  bind_profiler(m);
  bind_stream(m);
}

}  // namespace surg::python
