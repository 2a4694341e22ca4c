#include "surg_core/controller.hpp"

#include <pybind11/stl.h>

#include <algorithm>
#include <optional>

#include "convert.hpp"

namespace surg::python {
namespace {

void bind_state(py::module_& m) {
  py::enum_<State>(m, "State", "CRTK operating state.")
      .value("DISABLED", State::kDisabled)
      .value("ENABLED", State::kEnabled)
      .value("PAUSED", State::kPaused)
      .value("FAULT", State::kFault);
  py::enum_<Reason>(m, "Reason", "Why the arm does not do what was asked.")
      .value("NONE", Reason::kNone)
      .value("NOT_HOMED", Reason::kNotHomed)
      .value("NOT_ENABLED", Reason::kNotEnabled)
      .value("NOT_FINITE", Reason::kNotFinite)
      .value("STATE_NOT_FINITE", Reason::kStateNotFinite)
      .value("STALE", Reason::kStale)
      .value("LINK_LOST", Reason::kLinkLost)
      .value("RCM_UNSET", Reason::kRcmUnset)
      .value("RCM_ERROR", Reason::kRcmError)
      .value("RCM_WHILE_ENABLED", Reason::kRcmWhileEnabled)
      .value("STEP_TOO_LARGE", Reason::kStepTooLarge)
      .value("STREAM_START_TOO_FAR", Reason::kStreamStartTooFar)
      .value("OUTSIDE_WORKSPACE", Reason::kOutsideWorkspace)
      .value("WRONG_FRAME", Reason::kWrongFrame)
      .value("WRONG_SIZE", Reason::kWrongSize)
      .value("NO_AUTHORITY", Reason::kNoAuthority)
      .value("REFUSED_TRANSITION", Reason::kRefusedTransition)
      .value("OVERRUN", Reason::kOverrun)
      .value("JOINT_LIMIT", Reason::kJointLimit)
      .value("OPERATOR", Reason::kOperator)
      .value("NOT_FOLLOWING", Reason::kNotFollowing)
      .value("HELD", Reason::kHeld);
  py::enum_<StateCommand>(m, "StateCommand", "CRTK state commands.")
      .value("ENABLE", StateCommand::kEnable)
      .value("DISABLE", StateCommand::kDisable)
      .value("PAUSE", StateCommand::kPause)
      .value("RESUME", StateCommand::kResume)
      .value("HOME", StateCommand::kHome)
      .value("UNHOME", StateCommand::kUnhome);
  m.def("sentence", &sentence, py::arg("reason"), "What was wrong and what to do, for people.");
  m.def("reason_name", py::overload_cast<Reason>(&name), py::arg("reason"),
        "Short name, as in FAULT(name).");
  m.def("state_name", py::overload_cast<State>(&name), py::arg("state"));
}

void bind_command(py::module_& m) {
  py::enum_<Motion>(m, "Motion", "Motion commands, numbered as in surg_msgs/Cycle.")
      .value("NONE", Motion::kNone)
      .value("SERVO_CP", Motion::kServoCp)
      .value("SERVO_JP", Motion::kServoJp)
      .value("SERVO_CV", Motion::kServoCv)
      .value("SERVO_JV", Motion::kServoJv)
      .value("INTERPOLATE_CP", Motion::kInterpolateCp)
      .value("MOVE_CP", Motion::kMoveCp)
      .value("HOLD", Motion::kHold)
      .value("JAW_SERVO_JP", Motion::kJawServoJp);

  py::class_<MotionCommand>(m, "MotionCommand", "One decoded command.")
      .def(
          py::init([](Motion motion, std::uint32_t source, const std::optional<Array>& p,
                      const std::optional<Array>& rotation, double roll_rate,
                      const std::optional<Array>& joints, double jaw) {
            MotionCommand command;
            command.motion = motion;
            command.source = source;
            if (p) command.p = to_vector3(*p, "p");
            if (rotation) {
              command.rotation = Eigen::Quaterniond(to_vector4(*rotation, "rotation"));
            }
            command.roll_rate = roll_rate;
            if (joints) command.joints = to_vector4(*joints, "joints");
            command.jaw = jaw;
            return command;
          }),
          py::arg("motion"), py::arg("source") = 0, py::arg("p") = py::none(),
          py::arg("rotation") = py::none(), py::arg("roll_rate") = 0.0,
          py::arg("joints") = py::none(), py::arg("jaw") = 0.0,
          "p (3,): position [m] (cp) or tip velocity [m/s] (cv), in the rcm frame; rotation (4,):\n"
          "quaternion x, y, z, w; joints (4,): yaw, pitch, insertion, roll or their rates.")
      .def_readonly("motion", &MotionCommand::motion)
      .def_readonly("source", &MotionCommand::source)
      .def_property_readonly("p", [](const MotionCommand& c) { return from_matrix(c.p); })
      .def_property_readonly(
          "rotation", [](const MotionCommand& c) { return from_matrix(c.rotation.coeffs()); },
          "Quaternion x, y, z, w.")
      .def_readonly("roll_rate", &MotionCommand::roll_rate)
      .def_property_readonly("joints", [](const MotionCommand& c) { return from_matrix(c.joints); })
      .def_readonly("jaw", &MotionCommand::jaw);

  py::class_<Verdict>(m, "Verdict", "What became of a command; reason NONE: accepted.")
      .def_readonly("reason", &Verdict::reason)
      .def_readonly("source", &Verdict::source)
      .def_readonly("motion", &Verdict::motion);
}

void bind_outputs(py::module_& m) {
  py::class_<Outputs> type(m, "Outputs",
                           "Everything one cycle decided; vectors in B unless named R.");
  const auto number = [&](const char* name, auto member, const char* text = "") {
    type.def_readonly(name, member, text);
  };
  const auto array = [&](const char* name, auto member, const char* text = "") {
    type.def_property_readonly(
        name, [member](const Outputs& self) { return from_matrix(self.*member); }, text);
  };
  number("state", &Outputs::state);
  number("reason", &Outputs::reason);
  number("homed", &Outputs::homed);
  number("busy", &Outputs::busy);
  number("motion", &Outputs::motion);
  number("source", &Outputs::source);
  number("accepted", &Outputs::accepted);
  number("refused", &Outputs::refused);
  number("warn_rcm", &Outputs::warn_rcm);
  number("roll", &Outputs::roll, "[rad]");
  number("depth", &Outputs::depth, "[m]");
  number("rcm_error", &Outputs::rcm_error, "[m]");
  number("roll_goal", &Outputs::roll_goal);
  number("roll_set", &Outputs::roll_set);
  number("jaw", &Outputs::jaw);
  number("jaw_set", &Outputs::jaw_set);
  number("scale", &Outputs::scale, "Uniform factor alpha.");
  array("p_BTip", &Outputs::p_BTip);
  array("s_B", &Outputs::s_B);
  array("p_BRcm", &Outputs::p_BRcm);
  array("v_BTip", &Outputs::v_BTip, "Measured.");
  array("virtual_q", &Outputs::virtual_q, "Measured yaw, pitch, insertion, roll.");
  array("virtual_qd", &Outputs::virtual_qd);
  array("virtual_set", &Outputs::virtual_set);
  array("p_goal", &Outputs::p_goal);
  array("p_set", &Outputs::p_set);
  array("v_set", &Outputs::v_set);
  array("qd_command", &Outputs::qd_command, "[rad/s] (n,)");
  array("twist_command", &Outputs::twist_command, "(6,), v then omega");
  type.def_property_readonly("X_BF", [](const Outputs& self) { return from_pose(self.X_BF); });
  type.def_property_readonly("limited_by",
                             [](const Outputs& self) { return std::string(self.limited_by); });
  type.def_property_readonly(
      "verdicts",
      [](const Outputs& self) {
        return std::vector<Verdict>(self.verdicts.begin(), self.verdicts.begin() + self.n_verdicts);
      },
      "One per command of this cycle, in order.");
}

}  // namespace

void bind_controller(py::module_& m) {
  bind_state(m);
  bind_command(m);
  bind_outputs(m);
  m.attr("MAX_COMMANDS") = kMaxCommands;

  py::enum_<Law>(m, "Law").value("OURS", Law::kVelocity).value("PAPER", Law::kPaper);

  // The joint count stands beside the controller, so that every array can be checked against it.
  struct Owned {
    int dof;
    std::unique_ptr<Controller> controller;
    Inputs inputs;
  };
  py::class_<Owned>(m, "Controller", "One arm's controller: call step() every dt.")
      .def(py::init([](const Chain& chain, const RobotConfig& robot, const Limits& limits,
                       const InstrumentConfig& instrument, const ToolCalibration& tool, Law law,
                       double dt, double feedback_gain) {
             return Owned{chain.dof(),
                          std::make_unique<Controller>(chain, robot, limits, instrument, tool,
                                                       Controller::Options{law, dt, feedback_gain}),
                          {}};
           }),
           py::arg("chain"), py::arg("robot"), py::arg("limits"), py::arg("instrument"),
           py::arg("tool"), py::arg("law") = Law::kVelocity, py::arg("dt") = 0.002,
           py::arg("feedback_gain") = -1.0,
           "dt [s]; feedback_gain [1/s] overrides tuning.rcm_gain when >= 0 (simulator only).")
      .def(
          "request", [](Owned& o, StateCommand command) { return o.controller->request(command); },
          py::arg("command"), "Reason.NONE: done; otherwise why it was refused.")
      .def(
          "set_rcm",
          [](Owned& o, const Array& p) { return o.controller->set_rcm(to_vector3(p, "p_BRcm")); },
          py::arg("p_BRcm"), "Teaches the trocar point (3,) in B; only DISABLED or PAUSED.")
      .def(
          "fault", [](Owned& o, Reason reason) { o.controller->fault(reason); }, py::arg("reason"))
      .def(
          "pause", [](Owned& o, Reason reason) { o.controller->pause(reason); }, py::arg("reason"))
      .def(
          "step",
          [](Owned& o, const Array& q, const Array& qd, const std::vector<MotionCommand>& commands,
             double jaw, bool state_valid, double state_age) {
            if (commands.size() > static_cast<std::size_t>(kMaxCommands)) {
              throw py::value_error("commands: at most " + std::to_string(kMaxCommands) +
                                    " per cycle, not " + std::to_string(commands.size()));
            }
            o.inputs.state_valid = state_valid;
            o.inputs.state_age = state_age;
            o.inputs.q = to_joints(q, o.dof, "q");
            o.inputs.qd = to_joints(qd, o.dof, "qd");
            o.inputs.jaw = jaw;
            o.inputs.n_commands = static_cast<int>(commands.size());
            std::copy(commands.begin(), commands.end(), o.inputs.commands.begin());
            return Outputs(o.controller->step(o.inputs));
          },
          py::arg("q"), py::arg("qd"), py::arg("commands") = std::vector<MotionCommand>(),
          py::arg("jaw") = 0.0, py::arg("state_valid") = true, py::arg("state_age") = 0.0,
          "One cycle from the measured joints q, qd (n,) [rad, rad/s] and this cycle's commands.")
      .def_property_readonly("X_BR", [](const Owned& o) { return from_pose(o.controller->X_BR()); })
      .def_property_readonly("rcm_set", [](const Owned& o) { return o.controller->rcm_set(); })
      .def_property_readonly("dt", [](const Owned& o) { return o.controller->dt(); })
      .def(
          "tool_orientation",
          [](const Owned& o, const Array& s_B, double roll) {
            return from_matrix(
                o.controller->tool_orientation(to_vector3(s_B, "s_B"), roll).coeffs());
          },
          py::arg("s_B"), py::arg("roll"), "R_RcmTool as a quaternion x, y, z, w.");
}

}  // namespace surg::python
