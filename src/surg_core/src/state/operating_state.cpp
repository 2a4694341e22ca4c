#include "surg_core/state/operating_state.hpp"

#include <cstddef>
#include <iterator>

namespace surg {
namespace {

/// A reason's short name, and one sentence: what is wrong and what to do.
struct Words {
  Reason reason;
  const char *name, *sentence;
};
constexpr Words kWords[] = {
    {Reason::kNone, "none", ""},
    {Reason::kNotHomed, "not_homed", "the arm is not homed: send 'home' on state_command first"},
    {Reason::kNotEnabled, "not_enabled",
     "the arm is not ENABLED: send 'enable' on state_command first"},
    {Reason::kNotFinite, "not_finite", "the command holds NaN or infinity: send finite numbers"},
    {Reason::kStateNotFinite, "state_not_finite",
     "the measured joint state holds NaN or infinity: check the robot link"},
    {Reason::kStale, "stale", "the command stream fell silent: the arm stopped and holds"},
    {Reason::kLinkLost, "link", "no joint state from the robot link: check that it runs"},
    {Reason::kRcmUnset, "rcm_unset", "no trocar point is known: publish one on rcm/set_cp"},
    {Reason::kRcmError, "rcm_error",
     "the shaft does not pass through the trocar point: move the trocar or the arm, or send "
     "'disable' and teach the point again on rcm/set_cp"},
    {Reason::kRcmWhileEnabled, "rcm_while_enabled",
     "the trocar point may only be taught while DISABLED or PAUSED: send 'disable' first"},
    {Reason::kStepTooLarge, "step_too_large",
     "the step from the last accepted pose is too large: send smaller steps, or use "
     "move_cp for a distant target"},
    {Reason::kStreamStartTooFar, "stream_start_too_far",
     "a pose stream must start at the set-point, within limits.step_slack and "
     "step_roll_slack: start from setpoint_cp, or use move_cp to get there"},
    {Reason::kOutsideWorkspace, "outside_workspace",
     "the target is outside the allowed depth, cone or roll: see limits.depth_min, "
     "depth_max, cone and roll_max of the robot's YAML"},
    {Reason::kWrongFrame, "wrong_frame",
     "frame_id is not the arm's rcm frame: leave it empty or use <arm>_rcm; nothing is "
     "converted"},
    {Reason::kWrongSize, "wrong_size",
     "wrong number of joints: yaw, pitch, insertion, roll (4) or one jaw angle"},
    {Reason::kNoAuthority, "no_authority",
     "another node holds the arm: wait until it has rested 0.5 s without a command"},
    {Reason::kRefusedTransition, "refused_transition",
     "not possible from this operating state: DISABLED -enable-> ENABLED -pause-> PAUSED "
     "-resume-> ENABLED; any -disable-> DISABLED; FAULT -enable-> ENABLED"},
    {Reason::kOverrun, "overrun",
     "the control loop missed its deadlines: free the CPU, then send 'resume'"},
    {Reason::kJointLimit, "joint_limit", "a joint is at its limit: move the tip back"},
    {Reason::kOperator, "operator", "asked for on state_command"},
    {Reason::kNotFollowing, "not_following",
     "the arm does not follow its commands: look for a protective stop or a clamp on the "
     "robot's side, then send 'resume'"},
    {Reason::kHeld, "held",
     "the arm was told to hold: end the stream for servo_timeout, then start it again"},
    {Reason::kNotInserted, "not_inserted",
     "the tip is near or above the trocar: send 'start' on rcm/insert to go in along the "
     "shaft, or on rcm/withdraw to come out"},
    {Reason::kTrackStale, "track_stale",
     "rcm/track fell silent, or sent nothing but outliers, for tuning.track_timeout: the "
     "trocar is taken to stand still; check the tracker, then send 'resume'"},
    {Reason::kToolLost, "tool_lost",
     "no jaw state from the tool link: the arm holds; check the tool link"},
    {Reason::kUnreachable, "unreachable",
     "the arm cannot follow its target any further without leaving a limit or the trocar: "
     "choose another target, or send 'start' on rcm/retrace to go back the way it came"},
    {Reason::kNotArrived, "not_arrived",
     "the move ended without reaching its target: choose another target, or send 'start' on "
     "rcm/retrace to go back the way it came"},
    {Reason::kNoTrace, "no_trace", "nothing is recorded to go back along"},
    {Reason::kFrameWhileEnabled, "frame_while_enabled",
     "the base frame may not change while ENABLED: send 'disable' first"},
    {Reason::kNotAtRest, "not_at_rest",
     "the arm is still coming to rest: send it again in a moment"},
    {Reason::kForce, "force",
     "too much force at the tip or on the trocar: see limits.tip_force_soft, tip_force_hard "
     "and trocar_force_fault; move away from the contact after 'resume' or 'enable'. Or the "
     "cell requires a force sensor that measures nothing: see force/status"},
    {Reason::kMasterLost, "master_lost",
     "the ROS master is gone: start it again, then restart every node of the system"},
    {Reason::kFixture, "fixture",
     "a virtual fixture is in the way: choose a way around it, or remove it with "
     "fixtures/remove while the arm is not ENABLED"},
    {Reason::kFixtureOfCell, "fixture_of_cell",
     "the cell states this fixture: change cell.yaml, or choose another name"},
    {Reason::kFixtureWhileEnabled, "fixture_while_enabled",
     "a fixture may be replaced or removed only while the arm is not ENABLED: send "
     "'disable' or 'pause' first; a new name may be added at any time"},
    {Reason::kFixturesFull, "fixtures_full", "the arm has 16 fixtures already: remove one first"},
    {Reason::kNoFixture, "no_fixture",
     "the arm has no fixture of this name: see the topic fixtures"},
    {Reason::kLate, "late",
     "it answers what the arm said before it stopped, so it was held up on its way: begin "
     "again from the newest setpoint_cp; look at the network or at the sender"},
    {Reason::kNoElbow, "no_elbow",
     "the elbow cannot be chosen: only an arm of seven joints that takes joint velocities "
     "and runs the exact form can turn it without moving the tip"},
    {Reason::kElbowOutOfReach, "elbow_out_of_reach",
     "the elbow cannot turn that far with the tip where it is: ask for an angle nearer to "
     "elbow/measured_js, or move the tip first"},
    {Reason::kToolWhileEnabled, "tool_while_enabled",
     "the tool may only be changed while DISABLED: withdraw it, then send 'disable' first"},
    {Reason::kRobot, "robot",
     "the robot does not obey: see robot/status, mend it there, start the robot, then send "
     "'enable'"},
    {Reason::kOtherArmLost, "other_arm_lost",
     "no fresh joint state of another arm of the cell: the arm moves only away from where "
     "that arm was last seen; check its link, or name the arms that run in ~others"},
    {Reason::kStateImplausible, "state_implausible",
     "the measured joint positions and velocities contradict each other: a joint wraps, "
     "jumps, stands still or drifts; check the robot link, then send 'enable'"},
    {Reason::kJointOutside, "joint_outside",
     "a joint stands outside its position limits: guide the arm back by hand, then send "
     "'enable'"},
};

const Words& words(Reason reason) {
  static constexpr Words kUnknown{Reason::kNone, "unknown", ""};
  for (const Words& one : kWords) {
    if (one.reason == reason) return one;
  }
  return kUnknown;
}

constexpr const char* kStates[] = {"DISABLED", "ENABLED", "PAUSED", "FAULT"};

}  // namespace

const char* name(Reason reason) { return words(reason).name; }
const char* sentence(Reason reason) { return words(reason).sentence; }

const char* name(State state) {
  const auto number = static_cast<std::size_t>(state);
  return number < std::size(kStates) ? kStates[number] : "UNKNOWN";
}

Reason OperatingState::request(StateCommand command, const Conditions& now) {
  const Reason obstacle = now.state != Reason::kNone ? now.state
                          : now.rcm != Reason::kNone ? now.rcm
                          : !now.force_ok            ? Reason::kForce
                                                     : Reason::kNone;
  const bool may_enter = command == StateCommand::kEnable
                             ? state_ == State::kDisabled || state_ == State::kFault
                             : state_ == State::kPaused;
  switch (command) {
    case StateCommand::kDisable:
      state_ = State::kDisabled;
      reason_ = Reason::kOperator;
      return Reason::kNone;
    case StateCommand::kPause:
      if (state_ == State::kPaused) return Reason::kNone;
      if (state_ != State::kEnabled) return Reason::kRefusedTransition;
      pause(Reason::kOperator);
      return Reason::kNone;
    case StateCommand::kEnable:
    case StateCommand::kResume:
      if (state_ == State::kEnabled) return Reason::kNone;
      if (!may_enter) return Reason::kRefusedTransition;
      if (obstacle != Reason::kNone) return obstacle;
      state_ = State::kEnabled;
      reason_ = Reason::kNone;
      return Reason::kNone;
    case StateCommand::kHome:
      if (obstacle != Reason::kNone) return obstacle;
      homed_ = true;
      return Reason::kNone;
    case StateCommand::kUnhome:
      if (state_ == State::kEnabled) return Reason::kRefusedTransition;
      homed_ = false;
      return Reason::kNone;
  }
  return Reason::kRefusedTransition;
}

void OperatingState::fault(Reason reason) {
  if (state_ == State::kFault) return;
  state_ = State::kFault;
  reason_ = reason;
}

void OperatingState::pause(Reason reason) {
  if (state_ != State::kEnabled) return;
  state_ = State::kPaused;
  reason_ = reason;
}

}  // namespace surg
