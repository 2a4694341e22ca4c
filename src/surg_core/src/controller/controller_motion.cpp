#include <algorithm>
#include <cmath>

#include "controller/controller_impl.hpp"
#include "surg_core/limits/flange_cap.hpp"

namespace surg {
namespace {

constexpr double kStandstill = 0.05;  // alpha below it: the limit has stopped the arm
constexpr double kMostLead = 0.5;  // of the flange's speed: the follower may not stop the reference
constexpr double kOntoPivot = 8;   // [1/s] pole with which a start off the pivot comes onto it
constexpr double kHorizon = 0.45;  // [s] of the set-point's clock that is looked ahead
constexpr double kRetraceRate = 0.15;  // [rad/s] of the fastest joint
constexpr double kStill = 1e-3;        // [rad, rad/s] nothing that anybody would see

}  // namespace

void Controller::Impl::move() {
  JointVector qd = JointVector::Zero(arm.chain().dof());
  bool moving = false;
  out.scale = 1;
  out.limited_by = "";
  out.tier = 0;
  out.v_set.setZero();
  Setpoint& setpoint = pilot.setpoint();
  setpoint.elapse(T);
  if (!sensed || !trocar.taught() || !operating.homed()) {
    // Geometry unknown: a ramp through the law would be blind (F02, F10), and so would be going
    // on with one when the state comes back.
    freeze();
  } else if (!halted && (enabled() || ramping())) {
    moving = true;
    setpoint.yield_to(X_BR.linear().transpose() * force.push());
    Setpoint next = setpoint;
    next.advance(T);
    const Step step = next_step(next, qd);
    out.scale = step.alpha;
    out.limited_by = step.limited_by;
    out.tier = step.tier;
    if (step.held && enabled()) out.reason = Reason::kUnreachable;
    const Vector3 p_before = setpoint.p_RTip();
    if (!replaying) advance_setpoint(step, next);  // else it has gone along
    if (setpoint.at_wall() && step.alpha == 1) out.limited_by = "workspace";
    out.v_set = X_BR.linear() * (setpoint.p_RTip() - p_before) / T;
  } else if (!halted) {
    moving = true;
    qd = fading_command();
  }
  command(qd, moving);
}

/// The set-point's clock runs as fast as the arm may follow. 'next' is a whole cycle on.
void Controller::Impl::advance_setpoint(const Step& step, const Setpoint& next) {
  Setpoint& setpoint = pilot.setpoint();
  if ((step.tier > 0 && setpoint.has_no_path()) ||
      (step.alpha < 1 && setpoint.mode() == Setpoint::Mode::kStopping)) {
    setpoint = next;
    slip(step.qd);
  } else if (step.alpha < kStandstill) {
    setpoint.stand();
  } else if (step.alpha < 1) {
    setpoint.advance(step.alpha * T);
  } else {
    setpoint = next;
  }
}

/// The last statement before the wire.
void Controller::Impl::command(JointVector qd, bool moving) {
  Vector6 twist = Vector6::Zero();
  if (moving) twist = arm.ahead().J * qd;
  if (!qd.allFinite() || !twist.allFinite()) {
    fault(Reason::kNotFinite);
    freeze();
    qd.setZero();
    twist.setZero();
  }
  qd_last = qd;
  arm.remember(qd);
  out.qd_command = qd;
  out.twist_command = twist;
}

Step Controller::Impl::next_step(const Setpoint& next, JointVector& qd) {
  if (pilot.retracing() && pilot.setpoint().mode() == Setpoint::Mode::kRest) {
    return retrace_step(qd);
  }
  end_replay();
  trace.record(law == Law::kExact ? follower.reference() : arm.now().q);
  return law == Law::kExact ? exact_step(next, qd) : velocity_step(next, qd);
}

void Controller::Impl::end_replay() {
  trace.shorten(back);
  back = 0;
  replaying = false;
}

Step Controller::Impl::exact_step(const Setpoint& next, JointVector& qd) {
  // Critically damped: no jump in velocity at the start.
  const Vector3 pull = -kOntoPivot * (kOntoPivot * pivot_offset + 2 * pivot_offset_rate);
  pivot_offset_rate += T * pull;
  pivot_offset += T * pivot_offset_rate;
  const auto path = [&](double t) { return goal_at(next, t); };
  Wish wish;
  wish.path = PathView(path);
  wish.horizon = horizon();
  wish.v_BRcm = trocar.v_B() + pivot_offset_rate;
  wish.posture = posture_at(follower.reference());
  wish.flange_lead = flange_lead();
  const Home home{arm.s_home(), arm.R_home()};
  const Step step = limited.exact(follower.reference(), follower.velocity(), home, wish);
  qd = follower.advance(T * step.qd, arm.now().q, arm.now().J, trust());
  return step;
}

Step Controller::Impl::velocity_step(const Setpoint& next, JointVector& qd) const {
  const TwistWish wished = wish_for(next);
  const auto path = [&](double t) { return goal_at(next, t); };
  Wish wish;
  wish.feedback = wished.feedback;
  wish.forward = wished.path;
  wish.posture = posture_at(arm.now().q);
  if (law == Law::kVelocity && gains.rcm > 0) {  // an open loop is not where its path is
    wish.path = PathView(path);
    wish.horizon = horizon();
  }
  const Home home{arm.s_home(), arm.R_home()};
  const Step step = limited.velocity(arm.ahead().q, qd_last, home, trocar.p_B(), wish);
  qd = step.qd;
  return step;
}

Step Controller::Impl::retrace_step(JointVector& qd) {
  // Joints are replayed, so a reference is followed whatever the law: the replay's way onto the
  // pivot takes one cycle, and from the state of an arm that answers late it would swing.
  if (!replaying && law != Law::kExact) follower.reset(arm.now().q, qd_last);
  replaying = true;
  const JointVector q = follower.reference();
  const Step step = limited.retrace(q, follower.velocity(), trace, back, kRetraceRate, trocar.p_B(),
                                    flange_lead());
  qd = follower.advance(T * step.qd, arm.now().q, arm.now().J, trust());
  back += step.alpha * kRetraceRate * T;
  const Pose X_BF = arm.chain().forward(JointVector(q + T * step.qd));
  const Vector3 s_B = X_BF.linear() * arm.tool().s_F;
  const double turn = absolute_roll(X_BF.linear(), arm.R_home(), arm.s_home(), s_B);
  const double roll = pilot.setpoint().roll();
  pilot.setpoint().reset(X_BR.inverse() * (X_BF * arm.tool().p_FTip),
                         X_BR.linear().transpose() * s_B, roll + wrapped(turn - roll));
  const bool arrived = back >= trace.length() && step.qd.cwiseAbs().maxCoeff() < kStill;
  if (trace.empty() || arrived) {
    if (back < kStill) out.reason = Reason::kNoTrace;
    pilot.end_retrace();
    trace.clear();
    back = 0;
  }
  return step;
}

TwistWish Controller::Impl::wish_for(const Setpoint& next) const {
  const Setpoint& setpoint = pilot.setpoint();
  if (law == Law::kPaper) return paper_wish(arm, setpoint, next, X_BR, limits, T);
  const double share = trust();
  const Gains left{share * gains.rcm, share * gains.tip, share * gains.roll};
  return setpoint.axial() ? axial_wish(arm, setpoint, next, X_BR, trocar.v_B(), left, T)
                          : velocity_wish(arm, setpoint, next, X_BR, trocar.v_B(), left,
                                          force.push(), limits, T);
}

ShaftGoal Controller::Impl::goal_at(const Setpoint& next, double t) const {
  const Setpoint& setpoint = pilot.setpoint();
  const Setpoint::Place there = t < T ? setpoint.after(t) : next.foreseen(t - T);
  const double arrives = T + (law == Law::kExact ? follower.delay() : 0.0);
  const Vector3 p_BRcm = trocar.p_B() + arrives * trocar.v_B() + pivot_offset;
  const Vector3 p_B = X_BR * there.p_RTip;
  if (!setpoint.axial()) return tip_goal(p_BRcm, p_B, there.roll, shaft().s);
  const Vector3 s_B = X_BR.linear() * setpoint.s_R();
  return {p_BRcm, s_B, s_B.dot(p_B - p_BRcm), there.roll};
}

double Controller::Impl::horizon() const {
  return pilot.setpoint().mode() == Setpoint::Mode::kStream ? 0.0 : kHorizon;
}

JointVector Controller::Impl::posture_at(const JointVector& q) const {
  return robot.tuning.posture_gain * (robot.home - q);
}

void Controller::Impl::slip(const JointVector& qd) {
  Pose X_BF;
  Jacobian J;
  arm.chain().forward(
      law == Law::kExact ? follower.reference() : JointVector(arm.ahead().q + T * qd), X_BF, J);
  const Vector3 p_BTip = X_BF * arm.tool().p_FTip;
  const Vector6 twist = J * qd;
  const Vector3 v_BTip =
      twist.head<3>() + Vector3(twist.tail<3>()).cross(Vector3(p_BTip - X_BF.translation()));
  pilot.setpoint().slip(X_BR.inverse() * p_BTip, X_BR.linear().transpose() * v_BTip);
}

double Controller::Impl::flange_lead() const {
  const Jacobian& J = arm.now().J;
  const double lead = (J * qd_last).head<3>().norm() - (J * follower.velocity()).head<3>().norm();
  return std::clamp(lead, 0.0, kMostLead * limits.flange_velocity);
}

JointVector Controller::Impl::fading_command() const {
  return braked_together(qd_last, robot.acceleration, T);
}

}  // namespace surg
