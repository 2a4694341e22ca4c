#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kOutside = 0.15;   // [m] a tip may be above its trocar before 'insert'
constexpr double kCreep = 5e-3;     // [rad/s] may be dropped in one cycle
constexpr double kSame = 0.02;      // [rad] an arm at rest is still where it was
constexpr int kHomeBusyCycles = 5;  // is_busy needs an edge that a client can see

}  // namespace

Conditions Controller::Impl::conditions() const {
  Conditions now;
  now.state = sensed ? Reason::kNone : unseen;
  if (trocar.taught()) now.rcm = untracked;
  if (now.rcm == Reason::kNone && (torn() || !on_line() || shaft().depth <= -kOutside)) {
    now.rcm = Reason::kRcmError;
  }
  now.force_ok = force.acceptable();
  return now;
}

bool Controller::Impl::torn() const {
  return operating.state() == State::kFault && operating.reason() == Reason::kRcmError && ramping();
}

bool Controller::Impl::on_line() const {
  return shaft().e.norm() <= limits.rcm_error_fault && shaft().depth < arm.shaft_length();
}

Whereabouts Controller::Impl::whereabouts() const {
  return {X_BR.inverse() * shaft().p_BTip, X_BR.linear().transpose() * shaft().s, arm.now().roll};
}

Reason Controller::Impl::request(StateCommand command) {
  const State before = operating.state();
  // Clients home as a habit: on a homed arm that may be moving it changes nothing.
  const bool keep_home =
      command == StateCommand::kHome && operating.homed() && before == State::kEnabled;
  // A ramp that is under way goes on: dropped, its velocity would be gone in one cycle.
  const bool moving = ramping();
  if (command == StateCommand::kHome && !keep_home && moving) return Reason::kNotAtRest;
  const Reason reason = operating.request(command, conditions());
  if (reason != Reason::kNone) return reason;
  if (command == StateCommand::kHome) {
    home_busy = kHomeBusyCycles;
    if (!keep_home) take_home();
  }
  if (before == State::kEnabled && !enabled()) leave_enabled();
  if (before != State::kEnabled && enabled()) {
    if (moving) {
      pilot.stop();
      force.restart();
    } else {
      start_here();
    }
  }
  return Reason::kNone;
}

Reason Controller::Impl::set_rcm(const Vector3& p_BRcm) {
  const State state = operating.state();
  if (state != State::kDisabled && state != State::kPaused) return Reason::kRcmWhileEnabled;
  if (!finite(p_BRcm)) return Reason::kNotFinite;
  trocar.teach(p_BRcm);
  X_BR.translation() = p_BRcm;
  operating.request(StateCommand::kUnhome, {});  // the rcm frame has changed
  if (sensed) arm.look_again(trocar);
  return Reason::kNone;
}

bool Controller::Impl::ramping() const {
  const bool known = sensed && !halted && operating.homed();
  return known && (pilot.setpoint().mode() != Setpoint::Mode::kRest || !commands_rest());
}

bool Controller::Impl::commands_rest() const {
  const JointVector& qd = law == Law::kExact ? follower.velocity() : qd_last;
  return qd.cwiseAbs().maxCoeff() < kCreep;
}

void Controller::Impl::take_home() {
  arm.take_home();
  X_BR = rcm_frame(shaft().s, trocar.p_BTaught());
  trace.clear();
  start_here();
}

void Controller::Impl::start_here() {
  pilot.start(whereabouts());
  halted = false;
  follower.reset(arm.now().q, qd_last);
  end_replay();
  const bool moved = !trace.empty() && (trace.at(0) - arm.now().q).cwiseAbs().maxCoeff() > kSame;
  if (moved) trace.clear();  // by hand: the way back begins elsewhere
  pivot_offset = -shaft().e;
  pivot_offset_rate.setZero();
  force.restart();
  inserted = shaft().depth >= limits.depth_min;
}

void Controller::Impl::leave_enabled() {
  pilot.stop();
  jaw.hold();
}

void Controller::Impl::fault(Reason reason) {
  operating.fault(reason);
  leave_enabled();
}

void Controller::Impl::pause(Reason reason) {
  if (!enabled()) return;
  operating.pause(reason);
  leave_enabled();
}

void Controller::Impl::freeze() {
  halted = true;
  Setpoint& setpoint = pilot.setpoint();
  setpoint.reset(setpoint.p_RTip(), setpoint.s_R(), setpoint.roll());
}

}  // namespace surg
