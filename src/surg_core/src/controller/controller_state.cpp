#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"

namespace surg {
namespace {

constexpr double kMaxHeight = 0.15;     // [m] of a tip above its trocar before 'insert'
constexpr double kRestVelocity = 5e-3;  // [rad/s] at rest; small enough to drop in one cycle
constexpr double kSamePosture = 0.02;   // [rad] an arm that moved less was not led by hand

}  // namespace

Conditions Controller::Impl::conditions() const {
  Conditions now;
  now.state = !state_known                    ? state_reason
              : robot_reason != Reason::kNone ? robot_reason
              : !within_joint_limits()        ? Reason::kJointOutside
              : clock.overrun()               ? Reason::kOverrun
                                              : Reason::kNone;
  if (trocar.taught()) now.rcm = track_reason;
  if (now.rcm == Reason::kNone &&
      (stopping_off_pivot() || !shaft_through_trocar() || shaft().depth <= -kMaxHeight)) {
    now.rcm = Reason::kRcmError;
  }
  now.force_ok = force.acceptable();
  return now;
}

bool Controller::Impl::stopping_off_pivot() const {
  return operating.state() == State::kFault && operating.reason() == Reason::kRcmError &&
         is_moving();
}

bool Controller::Impl::shaft_through_trocar() const {
  return shaft().e.norm() <= limits.rcm_error_fault && shaft().depth < arm.shaft_length();
}

TipPose Controller::Impl::tip_pose() const {
  return {X_BR.inverse() * shaft().p_BTip, X_BR.linear().transpose() * shaft().s,
          arm.measured().roll};
}

Reason Controller::Impl::request(StateCommand command) {
  const State before = operating.state();
  // Many clients send 'home' by default; on a homed, possibly moving arm it has no effect.
  const bool keep_home =
      command == StateCommand::kHome && operating.homed() && before == State::kEnabled;
  // A ramp in progress continues: dropping it would change the velocity in one cycle.
  const bool moving = is_moving();
  if (command == StateCommand::kHome && !keep_home && moving) return Reason::kNotAtRest;
  // An arm that brakes without feedback leaves its pivot: nothing starts before it stands.
  const bool starts = command == StateCommand::kEnable || command == StateCommand::kResume ||
                      (command == StateCommand::kHome && !keep_home);
  if (starts && fading && !may_stop_at_once()) return Reason::kNotAtRest;
  // Without home nothing may move, so the command would drop to zero at once.
  if (command == StateCommand::kUnhome && !enabled() && !may_stop_at_once()) {
    return Reason::kNotAtRest;
  }
  const Reason reason = operating.request(command, conditions());
  if (reason != Reason::kNone) return reason;
  if (command == StateCommand::kHome) {
    home_busy = static_cast<int>(std::lround(Jaw::kEdge / T));
    if (!keep_home) set_home();
  }
  if (before == State::kEnabled && !enabled()) stop_motion();
  if (before != State::kEnabled && enabled()) {
    if (moving) {
      handler.stop();
      force.restart();
    } else {
      start_at_rest();
    }
  }
  return Reason::kNone;
}

Reason Controller::Impl::set_rcm(const Vector3& p_BRcm) {
  const State state = operating.state();
  if (state != State::kDisabled && state != State::kPaused) return Reason::kRcmWhileEnabled;
  if (!finite(p_BRcm)) return Reason::kNotFinite;
  if (!may_stop_at_once()) return Reason::kNotAtRest;
  trocar.teach(p_BRcm);
  X_BR.translation() = p_BRcm;
  place_fixtures();
  operating.request(StateCommand::kUnhome, {});  // the rcm frame has changed
  if (state_known) arm.update_trocar(trocar);
  return Reason::kNone;
}

Reason Controller::Impl::set_fixture(const Fixture& fixture) {
  Fixture checked = fixture;
  if (!check_fixture(checked).empty()) return Reason::kNotFinite;
  const Fixture* present = fixtures.find(fixture.title());
  // A replacement may allow more than what it replaces; one region more never does.
  if (present != nullptr && present->of_cell) return Reason::kFixtureOfCell;
  if (present != nullptr && enabled()) return Reason::kFixtureWhileEnabled;
  if (!fixtures.put(checked)) return Reason::kFixturesFull;
  place_fixtures();
  return Reason::kNone;
}

Reason Controller::Impl::remove_fixture(std::string_view name) {
  const Fixture* present = fixtures.find(name);
  if (present == nullptr) return Reason::kNoFixture;
  if (present->of_cell) return Reason::kFixtureOfCell;
  if (enabled()) return Reason::kFixtureWhileEnabled;
  fixtures.remove(name);
  place_fixtures();
  return Reason::kNone;
}

void Controller::Impl::place_fixtures() {
  const WristMotion& wrist = handler.wrist();
  const double reach = wrist.exists() ? wrist.config().geometry.length() : 0.0;
  const Fixtures there = fixtures.in_frame(X_BR.inverse());
  handler.set_fixtures(reach > 0 ? there.grown(reach) : there);
}

Reason Controller::Impl::change_tool(const InstrumentConfig& instrument,
                                     const ToolCalibration& calibration) {
  const bool rests = may_stop_at_once();
  if (operating.state() != State::kDisabled) return Reason::kToolWhileEnabled;
  if (!rests) return Reason::kNotAtRest;
  const Tool tool = shaft_of(instrument, calibration);
  operating.request(StateCommand::kUnhome, {});  // home shaft and roll belong to the old tool
  fade();
  trace.clear();
  retraced = 0;
  arm.mount(tool, trocar);
  handler.mount(instrument.wrist);
  place_fixtures();
  limited.mount(tool);
  clearance.mount(robot, instrument, calibration);
  jaw = Jaw(instrument, T);
  inserted = false;
  return Reason::kNone;
}

bool Controller::Impl::is_moving() const {
  const bool known = state_known && !fading && operating.homed();
  return known && (handler.setpoint().mode() != Setpoint::Mode::kRest || !reference_at_rest());
}

bool Controller::Impl::reference_at_rest() const {
  const JointVector& qd = law == Law::kExact ? follower.velocity() : qd_last;
  return qd.cwiseAbs().maxCoeff() < kRestVelocity;
}

bool Controller::Impl::may_stop_at_once() const {
  return !is_moving() && (qd_last.array().abs() <= T * robot.acceleration.array()).all();
}

void Controller::Impl::set_home() {
  arm.set_home();
  X_BR = rcm_frame(shaft().s, trocar.p_BTaught());
  if (handler.wrist().exists()) {
    const Vector3 axis_R = X_BR.linear().transpose() * arm.measured().X_BF.linear() *
                           handler.wrist().config().pitch_axis_F;
    handler.wrist().set_turn(std::atan2(-axis_R.x(), axis_R.y()));
  }
  place_fixtures();
  trace.clear();
  elbow.home();
  start_at_rest();
}

void Controller::Impl::start_at_rest() {
  handler.start(tip_pose());
  fading = false;
  follower.reset(arm.measured().q, qd_last);
  elbow.rest();
  end_retrace_step();
  const bool moved =
      !trace.empty() && (trace.at(0) - arm.measured().q).cwiseAbs().maxCoeff() > kSamePosture;
  if (moved) trace.clear();  // moved by hand: start a new trace
  pivot_offset = -shaft().e;
  pivot_offset_rate.setZero();
  force.restart();
  inserted = shaft().depth >= limits.depth_min;
}

void Controller::Impl::stop_motion() {
  handler.stop();
  jaw.hold();
  if (elbow.commanded()) elbow.hold();
}

void Controller::Impl::fault(Reason reason) {
  operating.fault(reason);
  stop_motion();
}

void Controller::Impl::pause(Reason reason) {
  if (!enabled()) return;
  operating.pause(reason);
  stop_motion();
}

void Controller::Impl::fade() {
  fading = true;
  Setpoint& setpoint = handler.setpoint();
  handler.wrist().stop();
  setpoint.reset(setpoint.p_RTip(), setpoint.s_R(), setpoint.roll());
}

}  // namespace surg
