#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <optional>

#include "convert.hpp"
#include "surg_core/controller.hpp"

namespace surg::python {
namespace {

void bind_motion_names(py::module_& m) {
  py::enum_<Motion>(m, "Motion", "Motion commands, numbered as in surg_msgs/Cycle.")
      .value("NONE", Motion::kNone)
      .value("SERVO_CP", Motion::kServoCp)
      .value("SERVO_JP", Motion::kServoJp)
      .value("SERVO_CV", Motion::kServoCv)
      .value("SERVO_JV", Motion::kServoJv)
      .value("INTERPOLATE_CP", Motion::kInterpolateCp)
      .value("MOVE_CP", Motion::kMoveCp)
      .value("HOLD", Motion::kHold)
      .value("JAW_SERVO_JP", Motion::kJawServoJp)
      .value("SERVO_JR", Motion::kServoJr)
      .value("INTERPOLATE_JP", Motion::kInterpolateJp)
      .value("MOVE_JP", Motion::kMoveJp)
      .value("MOVE_JR", Motion::kMoveJr)
      .value("JAW_MOVE_JP", Motion::kJawMoveJp)
      .value("INSERT", Motion::kInsert)
      .value("WITHDRAW", Motion::kWithdraw)
      .value("RETRACE", Motion::kRetrace)
      .value("ELBOW_MOVE_JP", Motion::kElbowMoveJp);
}

void bind_command(py::module_& m) {
  py::class_<MotionCommand>(m, "MotionCommand", "One decoded command.")
      .def(
          py::init([](Motion motion, std::uint32_t source, const std::optional<Array>& p,
                      const std::optional<Array>& rotation, double roll_rate,
                      const std::optional<Array>& joints, double jaw, std::int64_t stamp_ns,
                      double age, bool slide, double elbow, const std::optional<Array>& omega,
                      const std::optional<Array>& wrist) {
            MotionCommand command;
            command.motion = motion;
            command.source = source;
            if (p) command.p = to_vector3(*p, "p");
            if (rotation) {
              command.rotation = to_unit_quaternion(*rotation, "rotation");
            }
            command.roll_rate = roll_rate;
            if (joints) command.joints = to_vector4(*joints, "joints");
            command.jaw = jaw;
            command.stamp_ns = stamp_ns;
            command.age = age;
            command.slide = slide;
            command.elbow = elbow;
            if (omega) command.omega = to_vector3(*omega, "omega");
            if (wrist) command.wrist.head<2>() = to_vector2(*wrist, "wrist");
            return command;
          }),
          py::arg("motion"), py::arg("source") = 0, py::arg("p") = py::none(),
          py::arg("rotation") = py::none(), py::arg("roll_rate") = 0.0,
          py::arg("joints") = py::none(), py::arg("jaw") = 0.0, py::arg("stamp_ns") = 0,
          py::arg("age") = 0.0, py::arg("slide") = false, py::arg("elbow") = 0.0,
          py::arg("omega") = py::none(), py::arg("wrist") = py::none(),
          "p (3,): position [m] (cp) or tip velocity [m/s] (cv), in the rcm frame; rotation (4,):\n"
          "unit quaternion x, y, z, w; joints (4,): yaw, pitch, insertion, roll, their rates or "
          "changes;\n"
          "jaw [rad]; stamp_ns on the sender's clock (0: none); age [s] since it arrived;\n"
          "slide: a servo_cp target outside the workspace slides along its wall; elbow: swivel "
          "angle [rad];\nof an instrument with a wrist omega (3,): angular velocity of the tip "
          "[rad/s] (cv); wrist (2,): pitch and yaw, their rates or changes.")
      .def_readonly("motion", &MotionCommand::motion)
      .def_readonly("source", &MotionCommand::source)
      .def_property_readonly("p", array_of(&MotionCommand::p))
      .def_property_readonly(
          "rotation",
          [](const MotionCommand& c) { return frozen(from_matrix(c.rotation.coeffs())); },
          "Quaternion x, y, z, w.")
      .def_readonly("roll_rate", &MotionCommand::roll_rate)
      .def_property_readonly("joints", array_of(&MotionCommand::joints))
      .def_readonly("jaw", &MotionCommand::jaw)
      .def_readonly("stamp_ns", &MotionCommand::stamp_ns)
      .def_readonly("age", &MotionCommand::age)
      .def_readonly("slide", &MotionCommand::slide)
      .def_readonly("elbow", &MotionCommand::elbow);

  py::class_<Verdict>(m, "Verdict", "What became of a command; reason NONE: accepted.")
      .def_readonly("reason", &Verdict::reason)
      .def_readonly("source", &Verdict::source)
      .def_readonly("motion", &Verdict::motion);
}

void bind_readings(py::module_& m) {
  py::class_<ForceSample>(m, "ForceSample", "A measured force on the instrument.")
      .def(py::init([](const std::optional<Array>& f_B) {
             ForceSample sample;
             sample.valid = f_B.has_value();
             if (f_B) sample.f_B = to_vector3(*f_B, "f_B");
             return sample;
           }),
           py::arg("f_B") = py::none(),
           "f_B (3,) [N] of the environment on the instrument, in the base; None: no sensor.")
      .def_readonly("valid", &ForceSample::valid)
      .def_property_readonly("f_B", array_of(&ForceSample::f_B));

  py::class_<Readings>(m, "Readings",
                       "What robot, tool and sensors said beside the joints; for Controller.step.")
      .def(
          py::init([](RobotCondition condition, double condition_age, double jaw_age,
                      const ForceSample& tip_force, const ForceSample& trocar_force,
                      const std::optional<Array>& p_BTrack, const std::optional<Array>& v_BTrack,
                      double track_age, const std::optional<Array>& wrist,
                      const std::optional<Array>& wrist_rate) {
            Readings readings;
            readings.condition = condition;
            readings.condition_age = condition_age;
            readings.jaw_age = jaw_age;
            readings.tip_force = tip_force;
            readings.trocar_force = trocar_force;
            if (wrist) readings.wrist = to_drive(*wrist, "wrist");
            if (wrist_rate) readings.wrist_rate = to_drive(*wrist_rate, "wrist_rate");
            readings.track_valid = p_BTrack.has_value();
            readings.track_age = track_age;
            if (p_BTrack) readings.p_BTrack = to_vector3(*p_BTrack, "p_BTrack");
            if (v_BTrack) readings.v_BTrack = to_vector3(*v_BTrack, "v_BTrack");
            return readings;
          }),
          py::kw_only(), py::arg_v("condition", RobotCondition::kActive, "RobotCondition.ACTIVE"),
          py::arg("condition_age") = 0.0, py::arg("jaw_age") = 0.0,
          py::arg_v("tip_force", ForceSample{}, "ForceSample()"),
          py::arg_v("trocar_force", ForceSample{}, "ForceSample()"),
          py::arg("p_BTrack") = py::none(), py::arg("v_BTrack") = py::none(),
          py::arg("track_age") = 0.0, py::arg("wrist") = py::none(),
          py::arg("wrist_rate") = py::none(),
          "condition of the robot, condition_age [s]; jaw_age [s]; forces; p_BTrack (3,) [m] and "
          "v_BTrack (3,) [m/s]: where a moving trocar "
          "was\n"
          "track_age [s] ago (Controller(track_rcm=True)); None: not tracked; "
          "wrist and wrist_rate (2,) or (3,): measured pitch, yaw and drive's roll [rad] and their "
          "rates, of the jaw's age.");
}

void bind_wrist_outputs(py::module_& m, py::class_<Outputs>& type) {
  py::class_<WristOutputs>(m, "WristOutputs", "The wrist in one cycle; joints are pitch and yaw.")
      .def_readonly("geometry", &WristOutputs::geometry, "Its turn is known from home on.")
      .def_property_readonly("q", array_of(&WristOutputs::q), "Measured (2,) [rad].")
      .def_property_readonly("qd", array_of(&WristOutputs::qd), "Measured (2,) [rad/s].")
      .def_property_readonly("set", array_of(&WristOutputs::set), "Set-point (2,) [rad].")
      .def_property_readonly("goal", array_of(&WristOutputs::goal), "(2,) [rad]")
      .def_property_readonly("command", array_of(&WristOutputs::command),
                             "For the drive (3,) [rad]: pitch, yaw, roll; not a number: nothing is "
                             "sent.")
      .def_property_readonly("R_RTip", array_of(&WristOutputs::R_RTip), "Measured (3, 3).")
      .def_property_readonly("R_RSet", array_of(&WristOutputs::R_RSet), "Set-point (3, 3).")
      .def_property_readonly("R_RGoal", array_of(&WristOutputs::R_RGoal), "Goal (3, 3).")
      .def_property_readonly("omega_B", array_of(&WristOutputs::omega_B),
                             "Angular velocity of the tip (3,) [rad/s].");
  type.def_property_readonly(
      "wrist",
      [](const Outputs& self) -> std::optional<WristOutputs> {
        if (!self.wrist.exists) return std::nullopt;
        return self.wrist;
      },
      "None: the instrument has no wrist.");
}

void bind_elbow(py::class_<Outputs>& type) {
  type.def_readonly("elbow_goal", &Outputs::elbow_goal,
                    "Swivel angle [rad]; not a number: none is asked for.");
  type.def_readonly(
      "elbow_limit", &Outputs::elbow_limit,
      "Joint that holds the elbow or refused its command; the number of joints: a singularity; "
      "-1: nothing.");
}

void bind_stop_bound(py::class_<Outputs>& type) {
  type.def_readonly("clearance", &Outputs::clearance,
                    "Smallest distance to other arms and obstacles [m]; infinite without a guard.");
  type.def_property_readonly(
      "stop_bound_tip", [](const Outputs& self) { return self.stop_bound.tip; },
      "Most that the tip still moves until rest, whatever stops the arm [m]; NaN: unknown.");
  type.def_property_readonly(
      "stop_bound_pivot", [](const Outputs& self) { return self.stop_bound.pivot; },
      "Largest distance of the shaft from the trocar until then [m]; NaN: unknown.");
}

void bind_lag(py::class_<Outputs>& type) {
  type.def_readonly("link_lag", &Outputs::link_lag,
                    "Measured lag of the link [s]; not a number until known.");
  type.def_property_readonly(
      "joint_lag", array_of(&Outputs::joint_lag),
      "Measured lag of each joint (n,) [s]; not a number until known; empty before a motion.");
}

void bind_outputs(py::module_& m) {
  py::class_<Outputs> type(m, "Outputs",
                           "Everything one cycle decided; vectors in B unless named R.");
  const auto number = [&](const char* name, auto member, const char* text = "") {
    type.def_readonly(name, member, text);
  };
  const auto array = [&](const char* name, auto member, const char* text = "") {
    type.def_property_readonly(
        name, [member](const Outputs& self) { return frozen(from_matrix(self.*member)); }, text);
  };
  number("state", &Outputs::state, "Operating state.");
  number("reason", &Outputs::reason, "Why PAUSED, FAULT or held.");
  number("homed", &Outputs::homed, "The rcm frame and the zero of roll are known.");
  number("busy", &Outputs::busy, "A move of tip, jaw or elbow is under way.");
  number("motion", &Outputs::motion, "The command obeyed in this cycle.");
  number("source", &Outputs::source, "Its sender.");
  number("accepted", &Outputs::accepted, "Commands taken since construction.");
  number("refused", &Outputs::refused, "Commands refused since construction.");
  number("warn_rcm", &Outputs::warn_rcm, "RCM deviation above the warning level.");
  number("warn_force", &Outputs::warn_force, "Load of the trocar above the warning level.");
  number("roll", &Outputs::roll, "Absolute roll [rad].");
  number("depth", &Outputs::depth, "Insertion [m], positive inside.");
  number("rcm_error", &Outputs::rcm_error, "Kinematic RCM deviation [m].");
  number("roll_goal", &Outputs::roll_goal, "[rad]");
  number("roll_set", &Outputs::roll_set, "[rad]");
  number("jaw", &Outputs::jaw, "Measured [rad].");
  number("jaw_set", &Outputs::jaw_set, "Commanded [rad]; not a number until measured.");
  bind_elbow(type);
  bind_wrist_outputs(m, type);
  bind_lag(type);
  bind_stop_bound(type);
  number("scale", &Outputs::scale, "Uniform factor alpha.");
  number("tier", &Outputs::tier, "0: on the path; 1: off it, on the pivot; 2: braking.");
  number("late_share", &Outputs::late_share, "Share of late cycles in the recent window.");
  number("withheld", &Outputs::withheld,
         "Whether the link shall get no command, so that it stops the arm by itself.");
  array("p_BTip", &Outputs::p_BTip, "Tip (3,) [m].");
  array("s_B", &Outputs::s_B, "Unit shaft axis (3,), to the tip.");
  array("p_BRcm", &Outputs::p_BRcm, "Trocar point (3,) [m].");
  array("v_BTip", &Outputs::v_BTip, "Measured tip velocity (3,) [m/s].");
  array("virtual_q", &Outputs::virtual_q, "Measured yaw, pitch, insertion, roll (4,) [rad, m].");
  array("virtual_qd", &Outputs::virtual_qd, "Their measured rates (4,).");
  array("virtual_set", &Outputs::virtual_set, "Their set-point (4,).");
  array("p_goal", &Outputs::p_goal, "Goal of the tip (3,) [m].");
  array("p_set", &Outputs::p_set, "Set-point of the tip (3,) [m].");
  array("v_set", &Outputs::v_set, "Its velocity (3,) [m/s].");
  array("qd_command", &Outputs::qd_command, "[rad/s] (n,)");
  array("twist_command", &Outputs::twist_command, "(6,), v then omega");
  type.def_property_readonly("X_BF", array_of(&Outputs::X_BF), "Flange (4, 4) in the base.");
  type.def_property_readonly(
      "limited_by", [](const Outputs& self) { return std::string(self.limited_by); },
      "Which limit set the scale; empty when it is 1.");
  type.def_property_readonly(
      "verdicts",
      [](const Outputs& self) {
        return std::vector<Verdict>(self.verdicts.begin(), self.verdicts.begin() + self.n_verdicts);
      },
      "One per command of this cycle, in order.");
}

// The joint count stands beside the controller, so that every array can be checked against it.
struct Owned {
  int dof;
  std::vector<int> others;  // joints of the other arms that the controller keeps clear of
  std::unique_ptr<Controller> controller;
  Inputs inputs;
};

void check_others(const std::vector<OtherArm>& given, const std::vector<int>& known) {
  if (given.size() > known.size()) {
    throw py::value_error("others: " + std::to_string(given.size()) +
                          " arms; the clearance setup " + "has " + std::to_string(known.size()));
  }
  for (std::size_t i = 0; i < given.size(); ++i) {
    if (given[i].q.size() != known[i]) {
      throw py::value_error("others[" + std::to_string(i) +
                            "]: " + std::to_string(given[i].q.size()) + " joints instead of " +
                            std::to_string(known[i]));
    }
  }
}

Owned make_controller(const Chain& chain, const RobotConfig& robot, const Limits& limits,
                      const InstrumentConfig& instrument, const ToolCalibration& tool, Law law,
                      double dt, double feedback_gain, bool track_rcm,
                      const std::optional<ClearanceSetup>& clearance) {
  const ClearanceSetup keep = clearance.value_or(ClearanceSetup{});
  Owned owned{chain.dof(), {}, nullptr, {}};
  for (const ArmShape& other : keep.others) owned.others.push_back(other.chain.dof());
  owned.controller =
      std::make_unique<Controller>(chain, robot, limits, instrument, tool,
                                   Controller::Options{law, dt, feedback_gain, track_rcm}, keep);
  return owned;
}

Outputs step(Owned& o, const Array& q, const Array& qd, const std::vector<MotionCommand>& commands,
             double jaw, bool state_valid, double state_age, double elapsed,
             const std::optional<Readings>& readings, const std::vector<OtherArm>& others) {
  if (commands.size() > static_cast<std::size_t>(kMaxCommands)) {
    throw py::value_error("commands: at most " + std::to_string(kMaxCommands) + " per cycle, not " +
                          std::to_string(commands.size()));
  }
  static_cast<Readings&>(o.inputs) = readings.value_or(Readings{});
  check_others(others, o.others);
  std::copy(others.begin(), others.end(), o.inputs.others.begin());
  o.inputs.state_valid = state_valid;
  o.inputs.state_age = state_age;
  o.inputs.elapsed = elapsed;
  o.inputs.q = to_joints(q, o.dof, "q");
  o.inputs.qd = to_joints(qd, o.dof, "qd");
  o.inputs.jaw = jaw;
  o.inputs.n_commands = static_cast<int>(commands.size());
  std::copy(commands.begin(), commands.end(), o.inputs.commands.begin());
  return Outputs(o.controller->step(o.inputs));
}

/// The frames and constants of a controller.
void bind_frames(py::class_<Owned>& type) {
  type.def_property_readonly(
          "X_BR", [](const Owned& o) { return frozen(from_pose(o.controller->X_BR())); },
          "(4, 4), read-only: the rcm frame in the base. Its rotation is the identity until homed.")
      .def_property_readonly(
          "rcm_set", [](const Owned& o) { return o.controller->rcm_set(); },
          "A trocar point is known.")
      .def_property_readonly(
          "dt", [](const Owned& o) { return o.controller->dt(); }, "Control period [s].");
}

}  // namespace

void bind_fixture_calls(py::class_<Owned>& type) {
  type.def(
          "set_fixture",
          [](Owned& o, const Fixture& fixture) { return o.controller->set_fixture(fixture); },
          py::arg("fixture"),
          "Adds a region in B, at any time, or replaces the one of its name while not ENABLED.")
      .def_property_readonly(
          "fixtures",
          [](const Owned& o) {
            const Fixtures& all = o.controller->fixtures();
            return py::tuple(py::cast(std::vector<Fixture>(all.begin(), all.end())));
          },
          "All regions, in B.");
}

void bind_reason(py::module_& m) {
  py::enum_<Reason> reasons(m, "Reason", "Why the arm does not do what was asked.");
  for (int i = 0; i <= static_cast<int>(Reason::kJointOutside); ++i) {
    const auto reason = static_cast<Reason>(i);
    std::string word = reason == Reason::kLinkLost ? "link_lost" : name(reason);
    std::transform(word.begin(), word.end(), word.begin(), [](char c) { return std::toupper(c); });
    reasons.value(word.c_str(), reason);
  }
  m.def("sentence", py::overload_cast<Reason>(&sentence), py::arg("reason"),
        "What was wrong and what to do, for people.");
  m.def("reason_name", py::overload_cast<Reason>(&name), py::arg("reason"),
        "Short name, as in FAULT(name).");
}

void bind_operating_state(py::module_& m) {
  bind_reason(m);
  py::enum_<State>(m, "State", "CRTK operating state; compare with ==, not with is.")
      .value("DISABLED", State::kDisabled)
      .value("ENABLED", State::kEnabled)
      .value("PAUSED", State::kPaused)
      .value("FAULT", State::kFault);
  py::enum_<RobotCondition>(m, "RobotCondition", "Numbered as in surg_msgs/LinkStatus.")
      .value("OFFLINE", RobotCondition::kOffline)
      .value("OFF", RobotCondition::kOff)
      .value("BRAKED", RobotCondition::kBraked)
      .value("READY", RobotCondition::kReady)
      .value("ACTIVE", RobotCondition::kActive)
      .value("GUIDED", RobotCondition::kGuided)
      .value("SLOWED", RobotCondition::kSlowed)
      .value("STOPPED", RobotCondition::kStopped)
      .value("ESTOP", RobotCondition::kEstop)
      .value("BROKEN", RobotCondition::kBroken)
      .value("OTHER_COMMAND", RobotCondition::kOtherCommand);
  py::enum_<StateCommand>(m, "StateCommand", "CRTK state commands.")
      .value("ENABLE", StateCommand::kEnable)
      .value("DISABLE", StateCommand::kDisable)
      .value("PAUSE", StateCommand::kPause)
      .value("RESUME", StateCommand::kResume)
      .value("HOME", StateCommand::kHome)
      .value("UNHOME", StateCommand::kUnhome);
  m.def("condition_sentence", py::overload_cast<RobotCondition>(&sentence), py::arg("condition"),
        "What is wrong with the robot and what to do, for people; empty for ACTIVE.");
}

void bind_controller(py::module_& m) {
  bind_motion_names(m);
  bind_command(m);
  bind_readings(m);
  bind_outputs(m);

  py::enum_<Law>(m, "Law")
      .value("EXACT", Law::kExact)
      .value("VELOCITY", Law::kVelocity)
      .value("PAPER", Law::kPaper);

  py::class_<Owned> type(m, "Controller", "One arm's controller: call step() every dt.");
  type.def(py::init(&make_controller), py::arg("chain"), py::arg("robot"), py::arg("limits"),
           py::arg("instrument"), py::arg("tool"), py::arg("law") = Law::kExact,
           py::arg("dt") = 0.002, py::arg("feedback_gain") = -1.0, py::arg("track_rcm") = false,
           py::arg("clearance") = py::none(),
           "dt [s]; feedback_gain [1/s] overrides tuning.rcm_gain when >= 0 (simulator only);\n"
           "track_rcm: the trocar may move, see Readings; clearance: what the arm keeps clear of.")
      .def(
          "request", [](Owned& o, StateCommand command) { return o.controller->request(command); },
          py::arg("command"), "Reason.NONE: done; otherwise why it was refused.")
      .def(
          "set_rcm",
          [](Owned& o, const Array& p) { return o.controller->set_rcm(to_vector3(p, "p_BRcm")); },
          py::arg("p_BRcm"), "Teaches the trocar point (3,) in B; only DISABLED or PAUSED.")
      .def(
          "fault", [](Owned& o, Reason reason) { o.controller->fault(reason); }, py::arg("reason"),
          "FAULT from outside, latched.")
      .def(
          "pause", [](Owned& o, Reason reason) { o.controller->pause(reason); }, py::arg("reason"),
          "ENABLED -> PAUSED from outside.")
      .def(
          "claim", [](Owned& o, std::uint32_t source) { return o.controller->claim(source); },
          py::arg("source"), "The arm obeys this sender alone until it leaves ENABLED.")
      .def(
          "step", &step, py::arg("q"), py::arg("qd"),
          py::arg("commands") = std::vector<MotionCommand>(), py::arg("jaw") = 0.0,
          py::arg("state_valid") = true, py::arg("state_age") = 0.0, py::arg("elapsed") = 0.0,
          py::arg("readings") = py::none(), py::arg("others") = std::vector<OtherArm>(),
          "One cycle from the measured joints q, qd (n,) [rad, rad/s] and this cycle's commands.\n"
          "jaw [rad]; state_age [s]; elapsed [s] since the last cycle, 0: one period; readings: "
          "of the sensors, where there are any;\nothers: the other arms of the clearance setup, in "
          "its order; a missing one is lost.");
  bind_fixture_calls(type);
  bind_frames(type);
}

}  // namespace surg::python
