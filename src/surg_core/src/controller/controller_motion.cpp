#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/flange_cap.hpp"

namespace surg {
namespace {

constexpr double kStandstillScale = 0.05;  // alpha below it counts as stopped by a limit
constexpr double kHoldNamed = 0.1;         // [s] behind a held cycle: the clock restarts meanwhile
constexpr double kPivotOffsetPole = 8;  // [1/s] pole of the convergence to the pivot after a start
constexpr double kRetraceRate = 0.15;   // [rad/s] of the fastest joint of `rcm/retrace`
constexpr double kOffPath = 1e-6;       // [m] of the reference's tip beside its set-point
constexpr double kNegligible = 1e-3;    // [rad, rad/s] a retrace has arrived

}  // namespace

void Controller::Impl::move() {
  JointVector qd = JointVector::Zero(arm.chain().dof());
  bool moving = false;
  out.scale = 1;
  out.limited_by = "";
  out.tier = 0;
  out.v_set.setZero();
  Setpoint& setpoint = handler.setpoint();
  setpoint.elapse(T);
  handler.wrist().elapse(T, true, setpoint.stream_delay());
  setpoint.set_rest_time(time_to_rest(qd_last));
  if (!state_known || !trocar.taught() || !operating.homed()) {
    // The geometry is unknown (F02, F10): a ramp through the law would be blind, also when the
    // state returns.
    fade();
  }
  if (follows_setpoint()) {
    moving = true;
    setpoint.yield_to(X_BR.linear().transpose() * force.push());
    if (law == Law::kExact) yield_return();
    const Vector3 p_before = setpoint.p_RTip();
    const Step step = advance_motion(qd);
    if (operating.state() == State::kFault) qd = no_faster(qd);
    out.scale = step.alpha;
    out.limited_by = step.limited_by;
    out.tier = step.tier;
    unreachable = step.held ? kHoldNamed : std::max(0.0, unreachable - T);
    if (unreachable > 0 && enabled()) out.reason = Reason::kUnreachable;
    if (step.alpha < 1 && clearance.other_lost()) out.reason = Reason::kOtherArmLost;
    if (setpoint.at_wall() && step.alpha == 1) out.limited_by = "workspace";
    if (handler.at_fixture() && step.alpha == 1) out.limited_by = "fixture";
    if (!retrace_active) out.v_set = X_BR.linear() * (setpoint.p_RTip() - p_before) / T;
    const Reason progress = handler.check_progress(step.alpha < 1 || step.tier > 0);
    if (progress != Reason::kNone) out.reason = progress;
  } else {
    // Blind behind a gap: the link may have stopped the arm meanwhile.
    handler.wrist().advance(T);
    qd = fading_command(!state_known && clock.gap() ? clock.periods() : 1);
    moving = !qd.isZero(0);
  }
  output_command(qd, moving);
}

bool Controller::Impl::follows_setpoint() const {
  const bool known = state_known && trocar.taught() && operating.homed() && !fading;
  return known && (enabled() || is_moving());
}

Step Controller::Impl::advance_motion(JointVector& qd) {
  Setpoint& setpoint = handler.setpoint();
  Setpoint next = setpoint;
  next.advance(T, handler.fixtures());
  const Step step = next_step(next, qd);
  if (!retrace_active) advance_setpoint(step, next);  // a retrace has moved it already
  if (retrace_active) handler.wrist().advance(T);
  return step;
}

/// A reference that a limit moved off its path does not return against a force on the tip (F25).
/// (Velocity form: see velocity_twist.)
void Controller::Impl::yield_return() {
  Setpoint& setpoint = handler.setpoint();
  const Vector3 push_R = X_BR.linear().transpose() * force.push();
  if (push_R.isZero(0) || handler.retracing()) return;
  const Pose X_BF = arm.chain().forward(follower.reference());
  const Vector3 p_RTip = X_BR.inverse() * (X_BF * arm.tool().p_FTip);
  const double back = (setpoint.p_RTip() - p_RTip).dot(push_R);
  if (back < -kOffPath) setpoint.shift(-back * push_R);
}

/// Advances the set-point's clock as far as the arm can follow. 'next' is one whole cycle later.
void Controller::Impl::advance_setpoint(const Step& step, const Setpoint& next) {
  Setpoint& setpoint = handler.setpoint();
  handler.wrist().advance(setpoint.has_no_path() ? T : step.alpha * T);
  if ((step.tier > 0 && setpoint.has_no_path()) ||
      (step.alpha < 1 && setpoint.mode() == Setpoint::Mode::kStopping)) {
    setpoint = next;
    resync_setpoint(step.qd);
  } else if (step.alpha < kStandstillScale) {
    setpoint.restart_from_rest(handler.fixtures());
  } else if (step.alpha < 1) {
    setpoint.advance(step.alpha * T, handler.fixtures());
  } else {
    setpoint = next;
  }
}

/// The last check before a command leaves the controller.
void Controller::Impl::output_command(JointVector qd, bool moving) {
  Vector6 twist = Vector6::Zero();
  if (moving) twist = arm.predicted().J * qd;
  if (!qd.allFinite() || !twist.allFinite()) {
    fault(Reason::kNotFinite);
    fade();
    qd = fading_command();
    twist = arm.predicted().J * qd;
    if (!twist.allFinite()) twist.setZero();
  }
  out.withheld = clock.starved() && !qd.isZero(0);
  if (out.withheld) {  // nothing new reaches the arm
    qd = qd_last;
    twist = arm.predicted().J * qd;
    follower.take_up(qd);
  }
  qd_last = qd;
  arm.record_command(qd);
  commanded.add(qd);
  stops.add(qd);
  out.qd_command = qd;
  out.twist_command = twist;
}

Step Controller::Impl::next_step(const Setpoint& next, JointVector& qd) {
  if (handler.retracing() && handler.setpoint().mode() == Setpoint::Mode::kRest) {
    return retrace_step(qd);
  }
  end_retrace_step();
  trace.record(law == Law::kExact ? follower.reference() : arm.measured().q);
  return law == Law::kExact ? exact_step(next, qd) : velocity_step(next, qd);
}

void Controller::Impl::end_retrace_step() {
  trace.shorten(retraced);
  retraced = 0;
  retrace_active = false;
}

Step Controller::Impl::exact_step(const Setpoint& next, JointVector& qd) {
  // Critically damped: no jump in velocity at the start.
  const Vector3 pull =
      -kPivotOffsetPole * (kPivotOffsetPole * pivot_offset + 2 * pivot_offset_rate);
  pivot_offset_rate += T * pull;
  pivot_offset += T * pivot_offset_rate;
  const auto path = [&](double t) { return goal_at(next, t); };
  StepRequest request;
  request.path = PathView(path);
  request.horizon = horizon();
  request.v_BRcm = trocar.v_B() + pivot_offset_rate;
  request.posture = elbow.has_goal() ? elbow.advance(follower.reference(), enabled())
                                     : posture_at(follower.reference());
  request.posture = clear_posture(follower.reference(), request.posture);
  request.flange_lead = flange_lead();
  request.room = follower.wanted_room();
  const Home home{arm.s_home(), arm.R_home()};
  const Step step = limited.exact(follower.reference(), follower.velocity(), home, request);
  qd = follow(step, trocar.p_B() + pivot_offset);
  return step;
}

JointVector Controller::Impl::follow(const Step& step, const Vector3& p_BPivot) {
  const JointVector dq = T * step.qd;
  if (catching_up) {
    follower.skip(dq);
    return qd_last;
  }
  ExactFollower::Push push;
  const bool pushed = !force.push().isZero(0) && !handler.retracing();
  if (pushed) push = push_on_joints();
  const Jacobian& J = arm.measured().J;
  const RcmRows pivot = rcm_rows(J, shaft_state(arm.measured().X_BF, arm.tool(), p_BPivot));
  return follower.advance(dq, arm.measured().q, J, feedback_scale(), clock.rest(),
                          pushed ? &push : nullptr, &pivot);
}

ExactFollower::Push Controller::Impl::push_on_joints() const {
  const Jacobian& J = arm.measured().J;
  const Vector3 f = force.push(), lever = shaft().p_BTip - shaft().p_BF;
  Vector6 wrench;
  wrench << f, lever.cross(f);
  const Vector6 twist = rcm_twist(shaft(), f, 0, Vector3::Zero(), 0, limits.depth_min);
  return {J.transpose() * wrench, inverse_velocity(J, twist, JointVector::Zero(J.cols())).qd};
}

Step Controller::Impl::velocity_step(const Setpoint& next, JointVector& qd) const {
  if (catching_up) {  // as far as the last command went
    Step step;
    step.qd = qd_last;
    step.alpha = out.scale;
    step.tier = out.tier;
    return step;
  }
  const TwistParts wished = twist_for(next);
  const auto path = [&](double t) { return goal_at(next, t); };
  StepRequest request;
  request.feedback = wished.feedback;
  request.forward = wished.path;
  request.posture = clear_posture(arm.measured().q, posture_at(arm.measured().q));
  if (law == Law::kVelocity && gains.rcm > 0) {  // an open loop leaves its path
    request.path = PathView(path);
    request.horizon = horizon();
  }
  const Home home{arm.s_home(), arm.R_home()};
  const Step step = limited.velocity(arm.predicted().q, qd_last, home, trocar.p_B(), request);
  qd = step.qd;
  return step;
}

Step Controller::Impl::retrace_step(JointVector& qd) {
  // A retrace follows a reference under every law: it converges to the pivot in one cycle, which
  // would overshoot from the measured state of an arm with lag.
  if (!retrace_active && law != Law::kExact) follower.reset(arm.measured().q, qd_last);
  retrace_active = true;
  elbow.hold();  // where the trace leads it
  elbow.rest();
  const JointVector q = follower.reference();
  const Step step = limited.retrace(q, follower.velocity(), trace, retraced, kRetraceRate,
                                    trocar.p_B(), flange_lead());
  qd = follow(step, trocar.p_B());
  retraced += step.alpha * kRetraceRate * T;
  const Pose X_BF = arm.chain().forward(JointVector(q + T * step.qd));
  const Vector3 s_B = X_BF.linear() * arm.tool().s_F;
  const double turn = absolute_roll(X_BF.linear(), arm.R_home(), arm.s_home(), s_B);
  const double roll = handler.setpoint().roll();
  handler.setpoint().reset(X_BR.inverse() * (X_BF * arm.tool().p_FTip),
                           X_BR.linear().transpose() * s_B, roll + wrapped(turn - roll));
  const bool at_end = retraced >= trace.length();
  retrace_settling = at_end ? retrace_settling + T : 0;
  const bool arrived = at_end && (step.qd.cwiseAbs().maxCoeff() < kNegligible ||
                                  retrace_settling > CommandHandler::kArriveWithin);
  if (trace.empty() || arrived) {
    if (retraced < kNegligible) out.reason = Reason::kNoTrace;
    handler.end_retrace();
    trace.clear();
    retraced = 0;
  }
  return step;
}

TwistParts Controller::Impl::twist_for(const Setpoint& next) const {
  const Setpoint& setpoint = handler.setpoint();
  if (law == Law::kPaper) return paper_twist(arm, setpoint, next, X_BR, limits, T);
  const double share = feedback_scale();
  const Gains left{share * gains.rcm, share * gains.tip, share * gains.roll};
  return setpoint.axial() ? axial_twist(arm, setpoint, next, X_BR, trocar.v_B(), left, T)
                          : velocity_twist(arm, setpoint, next, X_BR, trocar.v_B(), left,
                                           force.push(), limits, T);
}

ShaftGoal Controller::Impl::goal_at(const Setpoint& next, double t) const {
  const Setpoint& setpoint = handler.setpoint();
  const Setpoint::TipAndRoll there =
      t < T ? setpoint.after(t, handler.fixtures()) : next.predict(t - T);
  const double arrives = T + (law == Law::kExact ? follower.delay() : 0.0);
  const Vector3 p_BRcm = trocar.p_B() + arrives * trocar.v_B() + pivot_offset;
  const Vector3 p_B = X_BR * there.p_RTip;
  if (!setpoint.axial()) return tip_goal(p_BRcm, p_B, there.roll, shaft().s);
  const Vector3 s_B = X_BR.linear() * setpoint.s_R();
  return {p_BRcm, s_B, s_B.dot(p_B - p_BRcm), there.roll};
}

double Controller::Impl::horizon() const {
  return handler.setpoint().mode() == Setpoint::Mode::kStream ? 0.0 : LimitedStep::kHorizon;
}

JointVector Controller::Impl::posture_at(const JointVector& q) const {
  return robot.tuning.posture_gain * (robot.home - q);
}

JointVector Controller::Impl::clear_posture(const JointVector& q,
                                            const JointVector& posture) const {
  const double share = clearance.posture_share(out.clearance);
  if (!(share < 1) || posture.size() != q.size()) return posture;
  constexpr double kAhead = 0.01;  // [s] over which the null space's motion is judged
  const Jacobian J = arm.chain().flange(q).J;
  const JointVector qd = inverse_velocity(J, Vector6::Zero(), posture).qd;
  const bool closes = clearance.distance(q + kAhead * qd) < clearance.distance(q);
  return closes ? JointVector(share * posture) : posture;
}

void Controller::Impl::resync_setpoint(const JointVector& qd) {
  const auto [X_BF, J] = arm.chain().flange(
      law == Law::kExact ? follower.reference() : JointVector(arm.predicted().q + T * qd));
  const Vector3 p_BTip = X_BF * arm.tool().p_FTip;
  const Vector6 twist = J * qd;
  const Vector3 v_BTip =
      twist.head<3>() + Vector3(twist.tail<3>()).cross(Vector3(p_BTip - X_BF.translation()));
  handler.setpoint().resync(X_BR.inverse() * p_BTip, X_BR.linear().transpose() * v_BTip);
}

double Controller::Impl::flange_lead() const {
  const Jacobian& J = arm.measured().J;
  const double lead = (J * qd_last).head<3>().norm() - (J * follower.velocity()).head<3>().norm();
  const double slower = (1 - follower.flange_share()) * limits.flange_velocity;
  return std::clamp(lead + slower, 0.0, LimitedStep::kMostLead * limits.flange_velocity);
}

double Controller::Impl::time_to_rest(const JointVector& of) const {
  return (of.array().abs() / robot.acceleration.array()).maxCoeff();
}

JointVector Controller::Impl::no_faster(const JointVector& qd_wanted) {
  if (!qd_wanted.allFinite() || time_to_rest(qd_wanted) <= time_to_rest(qd_last)) return qd_wanted;
  const JointVector slower = fading_command();
  follower.take_up(slower);
  return slower;
}

JointVector Controller::Impl::fading_command(int periods) const {
  return braked_together(qd_last, robot.acceleration, periods * T);
}

}  // namespace surg
