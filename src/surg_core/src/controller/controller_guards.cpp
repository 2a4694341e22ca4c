#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kFollowDistance = 0.01;  // [m] expected to measured tip; beyond it: stuck
constexpr double kToolTimeout = 0.2;      // [s] without a jaw state (F31)
constexpr double kDampedLoop = 0.7;       // gain times delay of a loop that is well damped
constexpr double kVelocitySlack = 0.05;   // [rad/s] noise of measured velocities
constexpr double kSofter = 4;  // times the excess of the cycles: streams are followed as softly
constexpr double kStatusPeriods = 0.04;  // [s] two periods of robot/status: joint states end first
constexpr double kOutside = 0.02;        // [rad] a lagging joint may be beyond its limit
constexpr double kRoundTrip = 2.0;       // a link with late states also executes late

bool finite(const MotionCommand& command) {
  return surg::finite(command.p) && surg::finite(command.rotation.coeffs()) &&
         surg::finite(command.joints) && surg::finite(command.wrist) &&
         surg::finite(command.omega) &&
         surg::finite(Vector3(command.roll_rate, command.jaw, command.elbow));
}

}  // namespace

void Controller::Impl::catch_up() {
  catching_up = true;
  const double soft_period = std::max(clock.elapsed(), T + kSofter * clock.excess());
  handler.setpoint().begin_cycle(soft_period, clock.rest());
  handler.wrist().begin_cycle(soft_period, clock.rest());
  for (int i = 1; i < clock.periods(); ++i) {
    handler.setpoint().elapse(T, false);
    handler.wrist().elapse(T, false, handler.setpoint().stream_delay());
    arm.record_command(qd_last);
    stops.add(qd_last);
    JointVector unused = qd_last;
    // Behind a longer gap the arm takes up nothing where it was left, see guard_lateness.
    Reason progress = Reason::kNone;
    const bool follows = clock.periods() <= CycleClock::kCatchUp && follows_setpoint();
    Setpoint& setpoint = handler.setpoint();
    if (follows && setpoint.is_reactive() && law == Law::kExact && clock.periods() == 2) {
      setpoint.coast(T, handler.fixtures());
      follower.coast();
    } else if (follows && law != Law::kExact && setpoint.mode() == Setpoint::Mode::kStopping) {
      // The velocity form's ramp has no path to make up for: it goes on as the arm does.
      setpoint.resync(setpoint.p_RTip() + T * setpoint.v_RTip(), setpoint.v_RTip());
    } else if (follows) {
      const Step step = advance_motion(unused);
      progress = handler.check_progress(step.alpha < 1 || step.tier > 0);
    }
    note(progress);
    note(handler.check_timeout());
    note(handler.check_arrival(tip_pose()));
    elapse_authority();
  }
  catching_up = false;
}

void Controller::Impl::sense(const Inputs& in) {
  state_known = false;
  out.warn_track = TrackWarning::kNone;
  jaw.sense(passive ? 0.0 : in.jaw);
  handler.wrist().sense(in.wrist, clock.elapsed());
  state_reason = take_state(in);
  if (state_reason != Reason::kNone) {
    const bool idle =
        operating.state() == State::kDisabled || (state_reason == Reason::kLinkLost && !enabled());
    if (!idle) fault(state_reason);
    return;
  }
  state_known = true;
  const double kept = std::max(1 - clock.periods() * T / CycleClock::kMemory, 0.0);
  state_delay = std::max(in.state_age - T, state_delay * kept);
  if (track_rcm) trocar_before = trocar;
  if (!stopping_off_pivot()) update_trocar(in);
  arm.sense(q, qd, trocar);
  measure_lag(in);
  measure_clearance(in);
  check_tool_link(in);
}

Reason Controller::Impl::take_state(const Inputs& in) {
  const int n = arm.chain().dof();
  const bool sized = in.q.size() == n && in.qd.size() == n;
  const Reason reason = !in.state_valid ? Reason::kLinkLost
                        : !sized || !in.q.allFinite() || !in.qd.allFinite()
                            ? Reason::kStateNotFinite
                        : !(in.state_age <= robot.tuning.link_timeout) ? Reason::kLinkLost
                                                                       : Reason::kNone;
  const bool follows = enabled() || !qd_last.isZero(0);
  if (reason != Reason::kNone || !follows) state_check.restart();
  if (reason != Reason::kNone) return reason;
  q = in.q;
  qd = in.qd;
  const StateCheck::Verdict verdict = state_check.judge(q, qd, in.state_age, clock.elapsed());
  return verdict == StateCheck::Verdict::kLost ? Reason::kStateImplausible : Reason::kNone;
}

bool Controller::Impl::within_joint_limits() const {
  const JointVector& at = arm.measured().q;  // also after a snapshot, which has no q
  return ((at - robot.position_min).array() >= -kOutside).all() &&
         ((robot.position_max - at).array() >= -kOutside).all();
}

void Controller::Impl::guard_robot(const Inputs& in) {
  robot_reason = in.condition == RobotCondition::kActive ? Reason::kNone : Reason::kRobot;
  if (!state_known) return;  // a lost link ends the motion anyway
  const bool fresh = in.condition_age <= robot.tuning.link_timeout + kStatusPeriods;
  if (!fresh || in.condition == RobotCondition::kOffline) {
    state_known = false;
    state_reason = Reason::kLinkLost;
    if (enabled()) fault(Reason::kLinkLost);
    return;
  }
  if (robot_reason == Reason::kNone) return;
  if (enabled() || operating.state() == State::kPaused) fault(Reason::kRobot);
  if (in.condition == RobotCondition::kSlowed) return;  // it still obeys a ramp
  if (fading && qd_last.isZero(0)) return;
  handler.start(tip_pose());
  fade();
  follower.reset(q);
  qd_last.setZero();
}

void Controller::Impl::measure_lag(const Inputs& in) {
  if (enabled()) {
    lag_meter.step(qd_last, q, in.state_age, clock.elapsed());
    if (gains.rcm > 0) follower.set_link(lag_meter.link());
  } else {
    lag_meter.interrupt();
  }
}

void Controller::Impl::measure_clearance(const Inputs& in) {
  if (!clearance.active()) return;
  clearance.sense(in.others);
  out.clearance = clearance.distance(q);
}

double Controller::Impl::feedback_scale() const {
  const double delay = std::max(state_delay, 0.0) + 0.5 * std::max(clock.excess(), 0.0);
  if (gains.rcm <= 0) return 1;
  const double damped = kDampedLoop / gains.rcm, lag = lag_meter.link().slowest();
  return damped / (std::max(lag, damped) + kRoundTrip * delay);
}

void Controller::Impl::update_trocar(const Inputs& in) {
  if (!track_rcm || !trocar.taught()) return;
  const Reason reason =
      trocar.track({in.track_valid, in.track_age, in.p_BTrack, in.v_BTrack}, clock.elapsed());
  track_reason = reason;
  out.warn_track = trocar.warning();
  if (reason == Reason::kTrackStale) {
    pause(reason);
  } else if (reason != Reason::kNone && enabled()) {
    fault(reason);
  }
}

void Controller::Impl::check_tool_link(const Inputs& in) {
  const bool lost = !passive && !(in.jaw_age <= kToolTimeout);
  if (lost && !tool_lost && enabled()) stop_motion();
  tool_lost = lost;
  if (lost) out.reason = Reason::kToolLost;
  if (handler.wrist().blocked() && enabled()) pause(Reason::kNotFollowing);
}

void Controller::Impl::guard_lateness() {
  out.late_share = clock.late_share();
  const JointVector step = T * robot.acceleration;  // of a command in one cycle
  const bool commanded_to_move = (qd_last.array().abs() > step.array()).any();
  if (state_known && clock.gap() && commanded_to_move) {
    const bool too_long = clock.periods() > CycleClock::kCatchUp;
    if (too_long || !commanded.explains(qd, step, clock.elapsed())) {
      stop_from_measured(Reason::kOverrun);
    } else {
      follower.take_up(qd);
      qd_last = qd;
    }
  } else if (state_known && clock.gap()) {  // it creeps as commanded, or the link has stopped it
    const JointVector none = JointVector::Zero(qd_last.size());
    qd_last = qd.cwiseMax(qd_last.cwiseMin(none)).cwiseMin(qd_last.cwiseMax(none));
    follower.take_up(qd_last);
  }
  if (clock.overrun()) pause(Reason::kOverrun);
}

/// The link stops the arm by itself when commands are lost on their way. When they arrive again,
/// the arm must not be told to go on at full speed.
void Controller::Impl::guard_following() {
  const bool unlike = joints_are_unexplained(), still = stands_still();
  if (unlike || still) stop_from_measured(Reason::kNotFollowing);
}

bool Controller::Impl::joints_are_unexplained() {
  const bool fresh = state_known && state_delay <= T && !clock.gap();
  const JointVector slack = (2 * T * robot.acceleration).cwiseMax(kVelocitySlack);
  const bool moves = (qd_last.array().abs() > slack.array()).any();
  const bool explained = !fresh || !moves || commanded.explains(qd, slack, 0);
  unexplained = explained ? 0 : unexplained + 1;
  if (unexplained < StateCheck::kLost) return false;
  unexplained = 0;
  return true;
}

/// A set-point that waits for its arm never runs away from it, and a slow one does so late.
bool Controller::Impl::stands_still() {
  if (!enabled() || !state_known || clock.gap()) {
    standstill.restart();
    return false;
  }
  const double dt = clock.periods() * T;
  if (!standstill.stands_still(qd_last, q, dt)) return false;
  standstill.restart();
  return true;
}

void Controller::Impl::stop_from_measured(Reason reason) {
  pause(reason);
  handler.start(tip_pose());
  follower.reset(q, qd);
  qd_last = qd;
  fading = true;
}

void Controller::Impl::guard_pivot() {
  out.warn_rcm = trocar.taught() && shaft().e.norm() > limits.rcm_error_warn;
  if (!enabled() || !operating.homed() || !state_known) return;
  if (shaft().depth >= limits.depth_min) inserted = true;
  if (handler.setpoint().axial() || handler.retracing())
    inserted = false;  // passing through the trocar
  if (!shaft_through_trocar() || (inserted && shaft().depth <= 0)) {
    fault(Reason::kRcmError);
    if (track_rcm) trocar = trocar_before;
    return;
  }
  // A blocked arm must not jump to its reference when it is released.
  const double behind = (expected_tip() - shaft().p_BTip).norm();
  if (!(behind <= kFollowDistance)) stop_from_measured(Reason::kNotFollowing);
}

Vector3 Controller::Impl::expected_tip() const {
  if (law != Law::kExact) return X_BR * handler.setpoint().p_RTip();
  return arm.chain().forward(follower.expected()) * arm.tool().p_FTip;
}

void Controller::Impl::guard_force(const Inputs& in) {
  const ForceGuard::Verdict verdict =
      force.judge(in.tip_force, in.trocar_force, T, clock.periods());
  out.warn_force = force.warns();
  if (verdict == ForceGuard::Verdict::kFade) fade();  // also ends a ramp
  if (verdict == ForceGuard::Verdict::kPause) pause(Reason::kForce);
  const bool stops = verdict == ForceGuard::Verdict::kStop || verdict == ForceGuard::Verdict::kFade;
  if (stops && enabled()) fault(Reason::kForce);
}

void Controller::Impl::gate(const Inputs& in) {
  const int n = std::clamp(in.n_commands, 0, kMaxCommands);
  elbow_asked = false;
  for (int i = 0; i < n; ++i) {
    const MotionCommand& command = in.commands[i];
    const Reason reason = accept(command);
    out.verdicts[i] = {reason, command.source, command.motion};
    ++(reason == Reason::kNone ? out.accepted : out.refused);
  }
  out.n_verdicts = n;
}

Reason Controller::Impl::accept(const MotionCommand& command) {
  if (!enabled()) return Reason::kNotEnabled;
  if (command.motion == Motion::kHold) {  // obeyed from anyone
    handler.hold();
    elbow.hold();
    return Reason::kNone;
  }
  if (!operating.homed()) return Reason::kNotHomed;
  const bool turns = command.motion == Motion::kElbowMoveJp;
  const bool may =
      turns ? authority.may_turn_elbow(command.source) : authority.may_command(command.source);
  if (!may) return Reason::kNoAuthority;
  if (!finite(command)) {
    fault(Reason::kNotFinite);
    return Reason::kNotFinite;
  }
  if (turns) return turn_elbow(command);
  if (tool_lost) return Reason::kToolLost;
  Reason reason = Reason::kNone;
  if (is_jaw(command.motion)) {
    jaw.go_to(command.jaw, command.motion == Motion::kJawMoveJp);
  } else {
    reason = handler.accept(command);
  }
  if (reason == Reason::kNone) authority.taken(command.source);
  return reason;
}

Reason Controller::Impl::turn_elbow(const MotionCommand& command) {
  if (law != Law::kExact || arm.chain().dof() != 7) return Reason::kNoElbow;
  if (handler.retracing() || elbow_asked) return Reason::kNotAtRest;
  elbow_asked = true;
  return elbow.go_to(command.elbow, follower.reference(), out.elbow_limit);
}

}  // namespace surg
