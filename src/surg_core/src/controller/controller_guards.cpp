#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kFollowDistance = 0.01;  // [m] set-point to measured tip: more means a stuck arm
constexpr double kToolTimeout = 0.2;      // [s] without a jaw state (F31)
constexpr double kForgets = 0.5;          // [s] a late state
constexpr double kLoop = 0.6;             // gain times delay of a loop that is well damped
constexpr double kBothWays = 2.0;         // a link that speaks late obeys late

bool finite(const MotionCommand& command) {
  return surg::finite(command.p) && surg::finite(command.rotation.coeffs()) &&
         surg::finite(command.joints) &&
         surg::finite(Eigen::Vector2d(command.roll_rate, command.jaw));
}

}  // namespace

void Controller::Impl::sense(const Inputs& in) {
  sensed = false;
  unseen = Reason::kLinkLost;
  jaw.sense(in.jaw);
  const int n = arm.chain().dof();
  if (!in.state_valid) {
    if (enabled()) fault(Reason::kLinkLost);
    return;
  }
  const bool sized = in.q.size() == n && in.qd.size() == n;
  if (!sized || !in.q.allFinite() || !in.qd.allFinite()) {
    unseen = Reason::kStateNotFinite;
    if (operating.state() != State::kDisabled) fault(Reason::kStateNotFinite);
    return;
  }
  if (!(in.state_age <= robot.tuning.link_timeout)) {
    if (enabled()) fault(Reason::kLinkLost);
    return;
  }
  sensed = true;
  unseen = Reason::kNone;
  stale = std::max(in.state_age - T, stale * (1 - T / kForgets));
  steady = trocar;
  if (!torn()) follow_trocar(in);
  arm.sense(in.q, in.qd, trocar);
  watch_tool(in);
}

double Controller::Impl::trust() const {
  if (stale <= 0 || gains.rcm <= 0) return 1;
  const double fresh = std::max(robot.tuning.link_lag, kLoop / gains.rcm);
  return fresh / (fresh + kBothWays * stale);
}

void Controller::Impl::follow_trocar(const Inputs& in) {
  if (!track_rcm || !trocar.taught()) return;
  const Reason reason = trocar.track({in.track_valid, in.track_age, in.p_BTrack, in.v_BTrack}, T);
  untracked = reason;
  if (reason == Reason::kTrackStale) {
    pause(reason);
  } else if (reason != Reason::kNone && enabled()) {
    fault(reason);
  }
}

void Controller::Impl::watch_tool(const Inputs& in) {
  const bool lost = !(in.jaw_age <= kToolTimeout);
  if (lost && !tool_lost && enabled()) leave_enabled();
  tool_lost = lost;
  if (lost) out.reason = Reason::kToolLost;
}

void Controller::Impl::guard_pivot() {
  out.warn_rcm = trocar.taught() && shaft().e.norm() > limits.rcm_error_warn;
  if (!enabled() || !operating.homed() || !sensed) return;
  if (shaft().depth >= limits.depth_min) inserted = true;
  if (pilot.setpoint().axial() || pilot.retracing())
    inserted = false;  // on the way in or out through the trocar
  if (!on_line() || (inserted && shaft().depth <= 0)) {
    fault(Reason::kRcmError);
    trocar = steady;
    return;
  }
  // An arm that is stopped from elsewhere must not run after its set-point once it is released.
  const double behind = (X_BR * pilot.setpoint().p_RTip() - shaft().p_BTip).norm();
  if (!(behind <= kFollowDistance)) pause(Reason::kNotFollowing);
}

void Controller::Impl::guard_force(const Inputs& in) {
  const ForceGuard::Verdict verdict = force.judge(in.tip_force, in.trocar_force, T);
  out.warn_force = force.warns();
  if (verdict == ForceGuard::Verdict::kHalt) freeze();  // a ramp that is under way ends as well
  if (!enabled()) return;
  switch (verdict) {
    case ForceGuard::Verdict::kFree:
    case ForceGuard::Verdict::kYield:
      break;
    case ForceGuard::Verdict::kPause:
      pause(Reason::kForce);
      break;
    case ForceGuard::Verdict::kStop:
      fault(Reason::kForce);
      break;
    case ForceGuard::Verdict::kHalt:
      fault(Reason::kForce);
      break;
  }
}

void Controller::Impl::gate(const Inputs& in) {
  const int n = std::clamp(in.n_commands, 0, kMaxCommands);
  for (int i = 0; i < n; ++i) {
    const MotionCommand& command = in.commands[i];
    const Reason reason = take(command);
    out.verdicts[i] = {reason, command.source, command.motion};
    ++(reason == Reason::kNone ? out.accepted : out.refused);
  }
  out.n_verdicts = n;
  const Reason watched = pilot.watch();
  if (watched != Reason::kNone) out.reason = watched;
}

Reason Controller::Impl::take(const MotionCommand& command) {
  if (!enabled()) return Reason::kNotEnabled;
  if (command.motion == Motion::kHold) {  // obeyed from anyone
    pilot.hold();
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
    reason = pilot.take(command);
  }
  if (reason == Reason::kNone) authority.taken(command.source);
  return reason;
}

}  // namespace surg
