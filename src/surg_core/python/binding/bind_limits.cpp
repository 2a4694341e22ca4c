#include <pybind11/functional.h>

#include <functional>
#include <tuple>

#include "convert.hpp"
#include "surg_core/limits/limited_step.hpp"
#include "surg_core/limits/workspace.hpp"

namespace surg::python {
namespace {

/// A path as Python gives it: t -> (p_BRcm, s_B, depth, roll).
using PythonGoal = std::tuple<Array, Array, double, double>;
using PythonPath = std::function<PythonGoal(double)>;

struct Path {
  const PythonPath& call;
  ShaftGoal operator()(double t) const {
    const auto [p_BRcm, s_B, depth, roll] = call(t);
    return {to_vector3(p_BRcm, "p_BRcm"), to_vector3(s_B, "s_B"), depth, roll};
  }
};

Home to_home(const Array& s_home, const Array& R_home) {
  return {to_vector3(s_home, "s_home"), to_matrix3(R_home, "R_home")};
}

int dof(const LimitedStep& limited) { return static_cast<int>(limited.limits().velocity.size()); }

/// Number of joints of an array that says it; at most kMaxJoints.
int joints_of(const Array& array, const char* name) {
  if (array.size() < 1 || array.size() > kMaxJoints) {
    throw py::value_error(std::string(name) + ": 1 to " + std::to_string(kMaxJoints) +
                          " joints, not " + std::to_string(array.size()));
  }
  return static_cast<int>(array.size());
}

void bind_joint_limits(py::module_& testing) {
  py::class_<JointLimits>(testing, "JointLimits", "What the joints may do; never exceeded.")
      .def(py::init([](const Array& position_min, const Array& position_max, const Array& velocity,
                       const Array& acceleration, double flange_velocity, double position_margin) {
             const int n = joints_of(velocity, "velocity");
             return JointLimits{to_joints(position_min, n, "position_min"),
                                to_joints(position_max, n, "position_max"),
                                to_joints(velocity, n, "velocity"),
                                to_joints(acceleration, n, "acceleration"),
                                flange_velocity,
                                position_margin};
           }),
           py::arg("position_min"), py::arg("position_max"), py::arg("velocity"),
           py::arg("acceleration"), py::arg("flange_velocity") = INFINITY,
           py::arg("position_margin") = 0.0,
           "Each (n,): positions [rad], velocity [rad/s], acceleration [rad/s^2]; flange_velocity "
           "[m/s];\n"
           "position_margin [rad]: nearer to a position limit a joint comes in gently.")
      .def_property_readonly(
          "position_min", [](const JointLimits& l) { return frozen(from_matrix(l.position_min)); })
      .def_property_readonly(
          "position_max", [](const JointLimits& l) { return frozen(from_matrix(l.position_max)); })
      .def_property_readonly("velocity",
                             [](const JointLimits& l) { return frozen(from_matrix(l.velocity)); })
      .def_property_readonly(
          "acceleration", [](const JointLimits& l) { return frozen(from_matrix(l.acceleration)); })
      .def_readonly("flange_velocity", &JointLimits::flange_velocity)
      .def_readonly("position_margin", &JointLimits::position_margin);
  testing.def("joint_limits", &joint_limits, py::arg("robot"), py::arg("limits"),
              "The joint limits of a robot's configuration.");

  py::class_<Step>(testing, "Step", "What became of one cycle.")
      .def_property_readonly(
          "qd", [](const Step& s) { return frozen(from_matrix(s.qd)); }, "(n,) [rad/s].")
      .def_readonly("alpha", &Step::alpha, "Speed of the set-point's clock, 0 to 1.")
      .def_property_readonly(
          "limited_by", [](const Step& s) { return std::string(s.limited_by); },
          "What set alpha; empty when it is 1.")
      .def_readonly("tier", &Step::tier,
                    "0: on the path; 1: on the pivot, the tip off it; 2: braking.")
      .def_readonly("held", &Step::held, "The path wants to move and the arm cannot.")
      .def("__repr__", [](const Step& s) {
        return py::str("Step(alpha={!r}, tier={!r}, limited_by={!r}, held={!r})")
            .format(s.alpha, static_cast<int>(s.tier), s.limited_by, s.held);
      });
}

void bind_trace(py::module_& testing) {
  py::class_<JointTrace>(testing, "JointTrace",
                         "Where the joints have been, in bounded memory: the guaranteed way back.")
      .def(py::init<>())
      .def("clear", &JointTrace::clear)
      .def(
          "record",
          [](JointTrace& trace, const Array& q) {
            trace.record(to_joints(q, joints_of(q, "q"), "q"));
          },
          py::arg("q"), "Where the joints are now (n,) [rad]; once a cycle.")
      .def("shorten", &JointTrace::shorten, py::arg("s"),
           "The newest s [rad] have been gone back, and are no part of the way out any more.")
      .def_property_readonly("length", &JointTrace::length, "Length of the way back [rad].")
      .def("__len__", &JointTrace::size)
      .def(
          "at",
          [](const JointTrace& trace, double s) {
            if (trace.empty()) throw py::value_error("the trace is empty: record() first");
            return from_matrix(trace.at(s));
          },
          py::arg("s"), "Joints (n,) s [rad] back from the newest point, clamped to the trace.");
}

Step exact(const LimitedStep& limited, const Array& q, const Array& qd_last, const Array& s_home,
           const Array& R_home, const PythonPath& call, double horizon) {
  const Path path{call};
  StepRequest request;
  request.path = PathView(path);
  request.horizon = horizon;
  return limited.exact(to_joints(q, dof(limited), "q"), to_joints(qd_last, dof(limited), "qd_last"),
                       to_home(s_home, R_home), request);
}

}  // namespace

void bind_limits(py::module_& testing) {
  bind_joint_limits(testing);
  bind_trace(testing);
  py::class_<LimitedStep>(
      testing, "LimitedStep",
      "One control cycle inside every joint limit without leaving the pivot. Paths are callables\n"
      "t -> (p_BRcm (3,), s_B (3,), depth, roll): the goal at the end of this cycle when the\n"
      "set-point's clock has run on by t [s].")
      .def(py::init([](const Chain& chain, const Array& s_F, const Array& p_FTip,
                       const JointLimits& limits, double T) {
             if (limits.velocity.size() != chain.dof()) {
               throw py::value_error("limits are for " + std::to_string(limits.velocity.size()) +
                                     " joints, the chain has " + std::to_string(chain.dof()));
             }
             return LimitedStep(chain, {to_vector3(s_F, "s_F"), to_vector3(p_FTip, "p_FTip")},
                                limits, T);
           }),
           py::arg("chain"), py::arg("s_F"), py::arg("p_FTip"), py::arg("limits"), py::arg("T"),
           "Tool calibration (3,), (3,) in the flange frame; T: control period [s].")
      .def(
          "exact", &exact, py::arg("q"), py::arg("qd_last"), py::arg("s_home"), py::arg("R_home"),
          py::arg("path"), py::arg("horizon") = 0.0,
          "Exact form from joints q (n,) and last velocities (n,); s_home (3,) and R_home (3, 3):\n"
          "shaft and flange at home; horizon [s]: how far the preview looks, 0: not at all.")
      .def(
          "velocity",
          [](const LimitedStep& limited, const Array& q, const Array& qd_last, const Array& p_BRcm,
             const Array& feedback, const Array& forward) {
            StepRequest request;
            request.feedback = to_vector6(feedback, "feedback");
            request.forward = to_vector6(forward, "forward");
            return limited.velocity(to_joints(q, dof(limited), "q"),
                                    to_joints(qd_last, dof(limited), "qd_last"), Home(),
                                    to_vector3(p_BRcm, "p_BRcm"), request);
          },
          py::arg("q"), py::arg("qd_last"), py::arg("p_BRcm"), py::arg("feedback"),
          py::arg("forward"),
          "Velocity form: the flange twist feedback + alpha forward, each (6,), v then omega in B.")
      .def(
          "retrace",
          [](const LimitedStep& limited, const Array& q, const Array& qd_last,
             const JointTrace& trace, double back, double rate, const Array& p_BRcm) {
            if (trace.empty()) throw py::value_error("the trace is empty: record() first");
            if (trace.at(0).size() != dof(limited)) {
              throw py::value_error("the trace is of another arm");
            }
            return limited.retrace(to_joints(q, dof(limited), "q"),
                                   to_joints(qd_last, dof(limited), "qd_last"), trace, back, rate,
                                   to_vector3(p_BRcm, "p_BRcm"));
          },
          py::arg("q"), py::arg("qd_last"), py::arg("trace"), py::arg("back"), py::arg("rate"),
          py::arg("p_BRcm"),
          "The trace backwards, 'back' [rad] of it behind, at 'rate' [rad/s]; advance back by\n"
          "alpha rate T.");
}

}  // namespace surg::python
