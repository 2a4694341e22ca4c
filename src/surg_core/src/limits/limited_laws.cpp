#include "limits/limited_laws.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/limits/workspace.hpp"

namespace surg {
namespace {

constexpr double kExact = 1e-15;        // [m] left on the pivot: not worth a look
constexpr double kOnPath = 1e-9;        // [m, rad] beside the path: taken back at once
constexpr double kNearlyFull = 0.98;    // of the clock's rate: the whole cycle's secant, bent back
constexpr double kBent = 0.1;           // of a step, that the arm's own bending may be
constexpr double kPivotTurns = 0.005;   // [m] deeper than that, a moving trocar turns the shaft
constexpr double kPostureShare = 0.05;  // of the velocity limits, at most, for the null space

// How a displaced tip returns to its path.
constexpr double kReturnGain = 15;           // [1/s] speed over distance
constexpr double kReturnAcceleration = 0.3;  // [m/s^2] of the return
constexpr double kReturnAtOnce = 2e-8;  // [m] per cycle, always taken back: no visible joint motion

// How an arm returns to its recorded trace, in joint space.
constexpr double kRetraceReturn = 1.0;   // [rad/s^2] of the return
constexpr double kRetraceAtOnce = 1e-7;  // [rad] per cycle, always taken back
constexpr double kTraceSpacing = 1e-3;   // [s] for the trace's direction

/// Share of a displacement that is left after a cycle of T: taken back gently, and at once where
/// nobody could see it.
double kept(double off, double acceleration, double at_once, double T) {
  if (!(off > 0)) return 0;
  const double gentle = std::min(kReturnGain * off, std::sqrt(2 * acceleration * off)) * T;
  return 1 - std::min(std::max(gentle, at_once) / off, 1.0);
}

}  // namespace

double LimitedStep::Affine::expected(const Joints& qd_last, double T) const {
  const double squared = tangent.squaredNorm();
  const double rate = squared > 0 ? qd_last.dot(tangent) / squared : 1.0;
  return std::clamp(rate, kTwistSpacing / T, 1.0);
}

// --- what the laws share ----------------------------------------------------------------------

/// Newton's method from 'guess', one step: joints, and their direction from the second pose. A step
/// as long as the arc itself has left the path or is at its end.
bool LimitedStep::Law::pose_node(const Joints& guess, const Pose& pose, const Pose& later,
                                 double arc, Node& node) const {
  const auto [X, J] = self_.chain_.flange(guess);
  Vectors6<2> twists;
  twists.col(0) = displacement(X, pose);
  twists.col(1) = (displacement(X, later) - twists.col(0)) / kTwistSpacing;
  const Steps<2> steps = least_steps<2>(J, twists);
  const Joints &rest = steps.dq[0], &direction = steps.dq[1];
  if (!(steps.pivots.ratio() > 0) || largest(rest) > 0.35 * arc + kFirstArc) return false;
  node.q = guess + rest;
  node.direction = direction;
  node.measures = self_.barrier_.measures(X, J, steps.pivots);
  node.flange = (later.translation() - pose.translation()).norm() / kTwistSpacing;
  return true;
}

RcmRows LimitedStep::Law::rows_after(const Joints& qd, const Vector3& p_BRcm) const {
  const auto [X, J] = self_.chain_.flange(here_.q + self_.T_ * qd);
  RcmRows rows = rcm_rows(J, shaft_state(X, self_.tool_, p_BRcm));
  rows.e /= self_.T_;
  return rows;
}

/// A wish for the null space, small beside what the joints need for the path; zero where there is
/// no null space or no wish.
Joints LimitedStep::Law::gentle(const JointVector& posture) const {
  if (here_.n <= 6 || posture.size() != here_.n || !posture.allFinite()) return Joints::Zero();
  const double share = (posture.array() / self_.limits_.velocity.array()).abs().maxCoeff();
  return padded(posture) * std::min(1.0, kPostureShare / std::max(share, 1e-12));
}

// --- the exact form ---------------------------------------------------------------------------

LimitedStep::ExactLaw::ExactLaw(const LimitedStep& self, const Here& here, const Home& home,
                                const StepRequest& request)
    : Law(self, here), home_(home), request_(request), inverse_(here.J) {
  ShaftGoal goal = request.path(0);
  p_BRcm_ = goal.p_BRcm;
  to_0_ = displacement(here.X_BF, pose_on_pivot(home, self.tool_, goal));
  const bool turns = !request.v_BRcm.isZero(0);
  if (!turns && to_0_.cwiseAbs().maxCoeff() < kOnPath) return;
  if (turns) {  // the trocar is still where it was
    const Vector3 p_BTip = goal.p_BTip();
    goal.p_BRcm -= self.T_ * request.v_BRcm;
    if (goal.depth > kPivotTurns) goal = tip_goal(goal.p_BRcm, p_BTip, goal.roll, goal.s_B);
  }
  measure_displacement(goal);
  if (returning_) to_0_ = displacement(here.X_BF, pose(0, keep_));
}

/// Where the instrument is, relative to where its path is now: zero unless a limit pushed it off.
void LimitedStep::ExactLaw::measure_displacement(const ShaftGoal& goal) {
  const ShaftState shaft = shaft_state(here_.X_BF, self_.tool_, goal.p_BRcm);
  const Vector3 axis = goal.s_B.cross(shaft.s);
  const double sine = axis.norm(), cosine = goal.s_B.dot(shaft.s);
  off_swing_ =
      sine > 1e-15 ? Vector3(axis * (std::atan2(sine, cosine) / sine)) : Vector3(Vector3::Zero());
  off_depth_ = shaft.depth - goal.depth;
  off_roll_ =
      wrapped(absolute_roll(here_.X_BF.linear(), home_.R_BF, home_.s_B, shaft.s) - goal.roll);
  const double off = off_swing_.norm() * std::max(std::abs(shaft.depth), kRollLever) +
                     std::abs(off_depth_) + std::abs(off_roll_) * kRollLever;
  keep_ = kept(off, kReturnAcceleration, kReturnAtOnce, self_.T_);
  returning_ = off > kReturnAtOnce;
}

LimitedStep::Affine LimitedStep::ExactLaw::affine() const {
  const double T = self_.T_;
  Affine a;
  const Joints posture = T * gentle(request_.posture);
  const bool pulled = posture.squaredNorm() > 0;
  a.regular = inverse_.regular();
  a.measures = self_.barrier_.measures(here_.X_BF, here_.J, inverse_.pivots());
  const Joints rest = inverse_(to_0_, posture);
  const auto along = [&](const Pose& pose, double t) -> Vector6 {
    return (displacement(here_.X_BF, pose) - to_0_) / t;
  };
  const Vector6 tangent = along(pose(kTwistSpacing, keep_), kTwistSpacing);
  a.tangent = inverse_(tangent);
  const double expected = a.expected(here_.qd_last, T), t = expected * T;
  // The whole cycle's end is where the step most often ends: not to be computed twice.
  const double end_at = expected > kNearlyFull ? T : t;
  end_ = pose(end_at, keep_);
  end_at_ = end_at;
  a.qd0 = rest / T;
  a.twist = along(end_, end_at_);
  if (t < end_at_) a.twist += (t - end_at_) / (end_at_ - kTwistSpacing) * (a.twist - tangent);
  a.qd1 = inverse_(a.twist);
  a.returning = (returning_ || pulled) && a.regular;
  if (a.returning) {
    const Vector6 all = returning_ ? displacement(here_.X_BF, pose(0, 1.0)) : to_0_;
    a.back = (rest - inverse_(all)) / T;
  }
  a.moves = a.qd1.cwiseAbs().maxCoeff() > 1e-9;
  a.bias = bias_acceleration(here_.J, a.qd1);
  a.qdd = inverse_(a.bias);
  const bool bent = !(T * largest(a.qdd) < kBent * largest(a.qd1));
  if (bent) a.qdd.setZero();
  // Redundant arms bend in their null space as well.
  if (!bent && here_.n == 6) a.secant = t;
  return a;
}

Joints LimitedStep::ExactLaw::finish(const Affine&, double alpha, double beta,
                                     const Joints& qd) const {
  const double T = self_.T_;
  const double keep = 1 - beta * (1 - keep_);
  Joints q = here_.q + T * qd;
  const auto [X, J] = self_.chain_.flange(q);
  const double t = alpha * T;
  const Vector6 to_path = displacement(X, pose(t, keep));
  // What Newton's method leaves is of second order.
  const auto exact = [&](double moved) { return 2 * self_.reach_ * moved * moved < kExact; };
  // The inverse of the Jacobian at the beginning, refined once with the one here: what that leaves
  // is less by the factor by which the second part was less than the first.
  if (inverse_.regular()) {
    const Joints step = inverse_(to_path);
    const Joints more = inverse_(to_path - flange_twist(J, step));
    const double moved = step.lpNorm<1>(), again = more.lpNorm<1>();
    if (exact(moved) && self_.reach_ * again * again <= kExact * moved) {
      return (q + step + more - here_.q) / T;
    }
  }
  const Steps<1> left = least_steps<1>(J, to_path);
  if (left.pivots.ratio() > 0) {
    const Joints& step = left.dq[0];
    q += step;
    if (exact(step.lpNorm<1>())) return (q - here_.q) / T;
  }
  // The pivot's own rows: well conditioned even where J is singular.
  for (int pass = 0; pass < 2; ++pass) {
    const ShaftState shaft = shaft_state(self_.chain_.forward(q), self_.tool_, p_BRcm());
    if (shaft.e.squaredNorm() < kOnPivot * kOnPivot) break;
    q += padded(rcm_correction(rcm_rows(J, shaft)).dq);
  }
  return (q - here_.q) / T;
}

bool LimitedStep::ExactLaw::node(double t, const Joints& guess, double arc, Node& node) const {
  return pose_node(guess, pose(t, 1.0), pose(t + kTwistSpacing, 1.0), arc, node);
}

/// The path's pose at t, displaced by the share 'keep' of what the arm is off it now.
Pose LimitedStep::ExactLaw::pose(double t, double keep) const {
  if (t == end_at_ && (!returning_ || keep == keep_)) return end_;
  ShaftGoal goal = request_.path(t);
  if (returning_ && keep > 0) {
    const Vector3 swing = keep * off_swing_;
    const double angle = swing.norm();
    if (angle > 1e-15) {
      goal.s_B = Eigen::AngleAxisd(angle, swing / angle) * goal.s_B;
      goal.s_B.normalize();
    }
    goal.depth += keep * off_depth_;
    goal.roll += keep * off_roll_;
  }
  return pose_on_pivot(home_, self_.tool_, goal);
}

// --- the velocity form ------------------------------------------------------------------------

LimitedStep::Affine LimitedStep::VelocityLaw::affine() const {
  Affine a;
  const Joints posture = gentle(request_.posture);
  const Inverse inverse(here_.J);
  a.regular = inverse.regular();
  a.measures = self_.barrier_.measures(here_.X_BF, here_.J, inverse.pivots());
  a.qd0 = inverse(request_.feedback, posture);
  a.twist = request_.forward;
  a.qd1 = a.tangent = inverse(a.twist);
  a.moves = a.qd1.cwiseAbs().maxCoeff() > 1e-9;
  a.bias = bias_acceleration(here_.J, a.qd1);
  // Lateral velocity that the pivot needs; the rest of the feedback may wait.
  Vector6 pivot = Vector6::Zero();
  const Vector3 v = feedback_at_pivot();
  pivot.head<3>() = v - here_.shaft.s * here_.shaft.s.dot(v);
  a.back = a.qd0 - inverse(pivot);
  a.returning = a.regular;
  return a;
}

RcmRows LimitedStep::VelocityLaw::rows(const Joints& qd) const {
  RcmRows rows = rows_;
  const Vector3& s = here_.shaft.s;
  const Vector3 u = s.unitOrthogonal(), w = s.cross(u);
  const Vector3 v = feedback_at_pivot();
  rows.e = {u.dot(v), w.dot(v)};
  for (Eigen::Index i = 0; i < here_.n; ++i) {
    rows.e[0] -= rows.J(0, i) * qd[i];
    rows.e[1] -= rows.J(1, i) * qd[i];
  }
  return rows;
}

bool LimitedStep::VelocityLaw::node(double t, const Joints& guess, double arc, Node& node) const {
  if (!request_.path) return false;
  return pose_node(guess, pose_on_pivot(home_, self_.tool_, request_.path(t)),
                   pose_on_pivot(home_, self_.tool_, request_.path(t + kTwistSpacing)), arc, node);
}

/// Velocity that the feedback gives the shaft's point at the pivot.
Vector3 LimitedStep::VelocityLaw::feedback_at_pivot() const {
  return request_.feedback.head<3>() + Vector3(request_.feedback.tail<3>())
                                           .cross(Vector3(here_.shaft.p_BNear - here_.shaft.p_BF));
}

// --- back along the trace ---------------------------------------------------------------------

LimitedStep::RetraceLaw::RetraceLaw(const LimitedStep& self, const Here& here,
                                    const JointTrace& trace, double back, double rate,
                                    const Vector3& p_BRcm)
    : Law(self, here), trace_(trace), back_(back), rate_(rate), p_BRcm_(p_BRcm) {
  at_0_ = on_pivot(padded(trace.at(back)));
  off_ = here.q - at_0_;
  keep_ = kept(largest(off_), kRetraceReturn, kRetraceAtOnce, self.T_);
}

LimitedStep::Affine LimitedStep::RetraceLaw::affine() const {
  const double T = self_.T_;
  Affine a;
  a.qd0 = (at_0_ + keep_ * off_ - here_.q) / T;
  a.tangent = (on_pivot(padded(trace_.at(back_ + rate_ * kTraceSpacing))) - at_0_) / kTraceSpacing;
  const double expected = a.expected(here_.qd_last, T);
  a.qd1 = (on_pivot(padded(trace_.at(back_ + expected * rate_ * T))) - at_0_) / (expected * T);
  a.back = (keep_ - 1) * off_ / T;
  a.returning = true;
  a.twist = flange_twist(here_.J, a.qd1);
  a.moves = back_ < trace_.length();
  a.bias = bias_acceleration(here_.J, a.qd1);
  return a;
}

Joints LimitedStep::RetraceLaw::finish(const Affine&, double alpha, double beta,
                                       const Joints&) const {
  const double T = self_.T_;
  const double keep = 1 - beta * (1 - keep_);
  const Joints on_trace = on_pivot(padded(trace_.at(back_ + alpha * rate_ * T)));
  return (on_pivot(on_trace + keep * off_) - here_.q) / T;
}

bool LimitedStep::RetraceLaw::node(double t, const Joints&, double, Node& node) const {
  node.q = on_pivot(padded(trace_.at(back_ + rate_ * t)));
  node.direction =
      (on_pivot(padded(trace_.at(back_ + rate_ * (t + kTraceSpacing)))) - node.q) / kTraceSpacing;
  const auto [X, J] = self_.chain_.flange(node.q);
  node.flange = flange_twist(J, node.direction).head<3>().norm();
  return true;
}

Joints LimitedStep::RetraceLaw::on_pivot(Joints q) const {
  for (int pass = 0; pass < 3; ++pass) {
    const auto [X, J] = self_.chain_.flange(q);
    const ShaftState shaft = shaft_state(X, self_.tool_, p_BRcm_);
    if (shaft.e.squaredNorm() < kOnPivot * kOnPivot) break;
    q += padded(rcm_correction(rcm_rows(J, shaft)).dq);
  }
  return q;
}

}  // namespace surg
