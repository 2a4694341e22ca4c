#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kFollowDistance =
    0.01;                             // [m] set-point to measured tip; beyond it the arm is stuck
constexpr double kToolTimeout = 0.2;  // [s] without a jaw state (F31)
constexpr double kDelayDecay = 0.5;   // [s] time constant of the recent state age
constexpr double kDampedLoop = 0.6;   // gain times delay of a loop that is well damped
constexpr double kRoundTrip = 2.0;    // a link with late states also executes late

bool finite(const MotionCommand& command) {
  return surg::finite(command.p) && surg::finite(command.rotation.coeffs()) &&
         surg::finite(command.joints) &&
         surg::finite(Eigen::Vector2d(command.roll_rate, command.jaw));
}

}  // namespace

void Controller::Impl::sense(const Inputs& in) {
  state_known = false;
  out.warn_track = TrackWarning::kNone;
  state_reason = Reason::kLinkLost;
  jaw.sense(in.jaw);
  const int n = arm.chain().dof();
  if (!in.state_valid) {
    if (enabled()) fault(Reason::kLinkLost);
    return;
  }
  const bool sized = in.q.size() == n && in.qd.size() == n;
  if (!sized || !in.q.allFinite() || !in.qd.allFinite()) {
    state_reason = Reason::kStateNotFinite;
    if (operating.state() != State::kDisabled) fault(Reason::kStateNotFinite);
    return;
  }
  if (!(in.state_age <= robot.tuning.link_timeout)) {
    if (enabled()) fault(Reason::kLinkLost);
    return;
  }
  state_known = true;
  state_reason = Reason::kNone;
  state_delay = std::max(in.state_age - T, state_delay * (1 - T / kDelayDecay));
  trocar_before = trocar;
  if (!stopping_off_pivot()) update_trocar(in);
  arm.sense(in.q, in.qd, trocar);
  measure_lag(in);
  check_tool_link(in);
}

void Controller::Impl::measure_lag(const Inputs& in) {
  if (enabled()) {
    lag_meter.step(qd_last, in.q, in.state_age, in.elapsed > 0 ? in.elapsed : T);
  } else {
    lag_meter.interrupt();
  }
  out.link_lag = lag_meter.lag();
}

double Controller::Impl::feedback_scale() const {
  if (state_delay <= 0 || gains.rcm <= 0) return 1;
  const double fresh = std::max(robot.tuning.link_lag, kDampedLoop / gains.rcm);
  return fresh / (fresh + kRoundTrip * state_delay);
}

void Controller::Impl::update_trocar(const Inputs& in) {
  if (!track_rcm || !trocar.taught()) return;
  const Reason reason = trocar.track({in.track_valid, in.track_age, in.p_BTrack, in.v_BTrack}, T);
  track_reason = reason;
  out.warn_track = trocar.warning();
  if (reason == Reason::kTrackStale) {
    pause(reason);
  } else if (reason != Reason::kNone && enabled()) {
    fault(reason);
  }
}

void Controller::Impl::check_tool_link(const Inputs& in) {
  const bool lost = !(in.jaw_age <= kToolTimeout);
  if (lost && !tool_lost && enabled()) stop_motion();
  tool_lost = lost;
  if (lost) out.reason = Reason::kToolLost;
}

void Controller::Impl::guard_pivot() {
  out.warn_rcm = trocar.taught() && shaft().e.norm() > limits.rcm_error_warn;
  if (!enabled() || !operating.homed() || !state_known) return;
  if (shaft().depth >= limits.depth_min) inserted = true;
  if (handler.setpoint().axial() || handler.retracing())
    inserted = false;  // passing through the trocar
  if (!shaft_through_trocar() || (inserted && shaft().depth <= 0)) {
    fault(Reason::kRcmError);
    trocar = trocar_before;
    return;
  }
  // A blocked arm must not jump to its set-point when it is released.
  const double behind = (X_BR * handler.setpoint().p_RTip() - shaft().p_BTip).norm();
  if (!(behind <= kFollowDistance)) pause(Reason::kNotFollowing);
}

void Controller::Impl::guard_force(const Inputs& in) {
  const ForceGuard::Verdict verdict = force.judge(in.tip_force, in.trocar_force, T);
  out.warn_force = force.warns();
  if (verdict == ForceGuard::Verdict::kHalt) halt();  // also ends a ramp
  if (!enabled()) return;
  switch (verdict) {
    case ForceGuard::Verdict::kFree:
    case ForceGuard::Verdict::kYield:
      break;
    case ForceGuard::Verdict::kPause:
      pause(Reason::kForce);
      break;
    case ForceGuard::Verdict::kStop:
    case ForceGuard::Verdict::kHalt:
      fault(Reason::kForce);
      break;
  }
}

void Controller::Impl::gate(const Inputs& in) {
  const int n = std::clamp(in.n_commands, 0, kMaxCommands);
  for (int i = 0; i < n; ++i) {
    const MotionCommand& command = in.commands[i];
    const Reason reason = accept(command);
    out.verdicts[i] = {reason, command.source, command.motion};
    ++(reason == Reason::kNone ? out.accepted : out.refused);
  }
  out.n_verdicts = n;
  const Reason timeout = handler.check_timeout();
  if (timeout != Reason::kNone) out.reason = timeout;
}

Reason Controller::Impl::accept(const MotionCommand& command) {
  if (!enabled()) return Reason::kNotEnabled;
  if (command.motion == Motion::kHold) {  // obeyed from anyone
    handler.hold();
    return Reason::kNone;
  }
  if (!operating.homed()) return Reason::kNotHomed;
  if (!authority.may_command(command.source)) return Reason::kNoAuthority;
  if (!finite(command)) {
    fault(Reason::kNotFinite);
    return Reason::kNotFinite;
  }
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

}  // namespace surg
