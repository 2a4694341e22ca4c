#include "surg_core/limits/limited_step.hpp"

#include <algorithm>
#include <cmath>

#include "limits/joint_box.hpp"
#include "limits/limited_laws.hpp"
#include "limits/look_ahead.hpp"
#include "surg_core/limits/flange_cap.hpp"

namespace surg {
namespace {

constexpr int kPasses = 5;             // of interval, step and check
constexpr int kRowPasses = 4;          // of the pivot's rows off the path
constexpr double kRowsKept = 1e-9;     // [m] more than this off the pivot counts as leaving it
constexpr double kRoomUsed = 0.9;      // of the way back that the linear picture has room for
constexpr double kInside = 1e-3;       // of alpha's interval, kept from its upper end: rounding
constexpr double kStill = 1e-4;        // share of a joint's velocity limit that is no motion
constexpr double kSagitta = 0.42e-6;   // [m] off the pivot between two samples
constexpr double kSlightBend = 0.25;   // of the bend that caps alpha: less needs no node
constexpr double kLongSecant = 0.9;    // of the cycle: a secant as long shows the path's bend
constexpr double kNearSingular = 0.3;  // of a measure: farther away the barrier has no word

/// Lateral vector e'' of the shaft for the flange's twist and acceleration.
Vector3 lateral_acceleration(const ShaftState& shaft, const Vector6& twist, const Vector6& bias) {
  const Vector3 omega = twist.tail<3>(), turning = bias.tail<3>();
  const Vector3 arm = shaft.p_BTip - shaft.p_BF, d = shaft.depth * shaft.s - shaft.e;
  const Vector3 v = twist.head<3>() + omega.cross(arm);  // of the tip
  const Vector3 a = bias.head<3>() + turning.cross(arm) + omega.cross(omega.cross(arm));
  const Vector3& s = shaft.s;
  const Vector3 s1 = omega.cross(s), s2 = turning.cross(s) + omega.cross(s1);
  // e = L s - d with L = s . d and d from the trocar to the tip.
  const double L1 = s1.dot(d) + s.dot(v), L2 = s2.dot(d) + 2 * s1.dot(v) + s.dot(a);
  return L2 * s + 2 * L1 * s1 + shaft.depth * s2 - a;
}

/// Distance within which every joint has the flange [m].
double reach(const Chain& chain) {
  double sum = chain.X_LF().translation().norm();
  for (const Joint& joint : chain.joints()) sum += joint.X_PJ.translation().norm();
  return sum;
}

}  // namespace

JointLimits joint_limits(const RobotConfig& robot, const Limits& limits) {
  return {robot.position_min, robot.position_max,     robot.velocity,
          robot.acceleration, limits.flange_velocity, limits.joint_margin};
}

LimitedStep::LimitedStep(const Chain& chain, const Tool& tool, const JointLimits& limits, double T)
    : chain_(chain), tool_(tool), limits_(limits), barrier_(chain), reach_(reach(chain)), T_(T) {}

LimitedStep::Here LimitedStep::at(const JointVector& q, const JointVector& qd_last,
                                  double flange_lead, const JointVector& room) const {
  Here here;
  here.n = q.size();
  if (room.size() == here.n) here.room = padded(room);
  here.q = padded(q);
  here.qd_last = padded(qd_last);
  here.flange_velocity = limits_.flange_velocity - flange_lead;
  chain_.forward(q, here.X_BF, here.J);
  return here;
}

Step LimitedStep::exact(const JointVector& q, const JointVector& qd_last, const Home& home,
                        const StepRequest& request) const {
  const Here here = at(q, qd_last, request.flange_lead, request.room);
  return run(ExactLaw(*this, here, home, request), here);
}

Step LimitedStep::velocity(const JointVector& q, const JointVector& qd_last, const Home& home,
                           const Vector3& p_BRcm, const StepRequest& request) const {
  Here here = at(q, qd_last, 0);
  here.shaft = shaft_state(here.X_BF, tool_, p_BRcm);
  return run(VelocityLaw(*this, here, home, request), here);
}

Step LimitedStep::retrace(const JointVector& q, const JointVector& qd_last, const JointTrace& trace,
                          double back, double rate, const Vector3& p_BRcm,
                          double flange_lead) const {
  const Here here = at(q, qd_last, flange_lead);
  return run(RetraceLaw(*this, here, trace, back, rate, p_BRcm), here);
}

/// The reference's pivot comes before the room that the follower's correction asks for.
Step LimitedStep::run(const Law& law, const Here& here) const {
  const Step step = run_with_room(law, here);
  if (step.tier < 2 || here.room.isZero(0)) return step;
  Here whole = here;
  whole.room.setZero();
  const Step on_pivot = run_with_room(law, whole);
  return on_pivot.tier < 2 ? on_pivot : step;
}

Step LimitedStep::run_with_room(const Law& law, const Here& here) const {
  const Box box(limits_, T_, here);
  const Affine affine = law.affine();
  const Cap most = affine.regular ? cap(law, here, affine) : Cap{0.0, ""};
  Step step;
  const bool found = on_path(law, affine, box, most, step);
  // On the path the joints may not be able to brake as hard as the flange needs it.
  const bool too_fast =
      found && flange_twist(here.J, padded(step.qd)).head<3>().norm() > here.flange_velocity;
  if (!found || too_fast) off_path(law, here, affine, box, most, too_fast, step);
  const bool still = (step.qd.array().abs() < kStill * limits_.velocity.array()).all();
  step.held = affine.moves && step.alpha < 1 && still;
  return step;
}

// --- caps of alpha ----------------------------------------------------------------------------

/// Bounds of alpha that are not the joints' own: never below what the joints need to brake.
LimitedStep::Cap LimitedStep::cap(const Law& law, const Here& here, const Affine& affine) const {
  Cap cap;
  if (!affine.moves) return cap;
  const double flange = affine.twist.head<3>().norm();
  if (flange > here.flange_velocity) {
    cap.limit(here.flange_velocity / flange, "flange_velocity");
  }
  if (clearance_ && clearance_->active()) {
    const Joints back = affine.returning ? affine.back : Joints(Joints::Zero());
    const auto unpadded = [&](const Joints& v) -> JointVector { return v.head(here.n); };
    cap.limit(clearance_->cap(unpadded(here.q), unpadded(affine.qd0), unpadded(back),
                              unpadded(affine.qd1), limits_.acceleration),
              "clearance");
  }
  cap_sagitta(law, here, affine, cap);
  if (law.has_barrier()) cap_approach(here, affine, cap);
  if (!affine.regular) return cap;
  if (law.horizon() > 0) {
    const Cap ahead = LookAhead(*this, law, here, affine).cap();
    cap.limit(ahead.alpha, ahead.by);
  } else {
    cap_unseen(law, here, affine, cap);
  }
  return cap;
}

/// Joints go straight between samples, the pivot's curve does not: its sagitta grows with the
/// square of the speed.
void LimitedStep::cap_sagitta(const Law& law, const Here& here, const Affine& affine,
                              Cap& cap) const {
  const double speed = affine.expected(here.qd_last, T_);
  const Joints half = 0.5 * T_ * speed * affine.qd1;
  const Vector3 p_BRcm = law.p_BRcm();
  const ShaftState shaft = shaft_state(here.X_BF, tool_, p_BRcm);
  // An eighth of e'' here, and what its change can add: |e'''| is below (20 reach + 8 |L|) w^3, w
  // the sum of all joints' motion.
  const double part = T_ * speed, w = part * affine.qd1.lpNorm<1>();
  const Vector3 second = lateral_acceleration(shaft, affine.twist, affine.bias);
  const double reach = reach_ + tool_.p_FTip.norm();  // from any joint to the tip
  const double bound =
      part * part * second.norm() / 8 + (20 * reach + 8 * std::abs(shaft.depth)) * w * w * w / 16;
  if (bound < kSagitta) return;
  const auto off = [&](const Pose& X_BF) { return shaft_state(X_BF, tool_, p_BRcm).e; };
  const Vector3 begin = shaft.e, middle = off(chain_.forward(here.q + half)),
                end = off(chain_.forward(here.q + 2 * half));
  const double sagitta = (middle - 0.5 * (end + begin)).norm();
  if (sagitta > kSagitta) {
    cap.limit(speed * std::sqrt(kSagitta / sagitta), "pivot_between_samples");
  }
}

/// Singularity barrier: rate of each measure along the path, from a small step of it.
void LimitedStep::cap_approach(const Here& here, const Affine& affine, Cap& cap) const {
  const SingularityMeasures& now = affine.measures;
  double closest = 1;
  for (int i = 0; i < now.n; ++i) closest = std::min(closest, std::abs(now.phi[i]));
  if (!(closest < kNearSingular)) return;
  const double h = 1e-5 / std::max(largest(affine.qd1), 1e-9);
  const auto [X, J] = chain_.flange(here.q + h * affine.qd1);
  const SingularityMeasures soon = barrier_.measures(X, J);
  for (int i = 0; i < now.n; ++i) {
    const double rate = (std::abs(soon.phi[i]) - std::abs(now.phi[i])) / h;
    if (rate < 0) cap.limit(barrier_.fastest_approach(now.phi[i]) / -rate, "singularity");
  }
}

/// Nobody looks ahead: keep what the path bends here, and what it takes all joints together to stop
/// before the first of them meets its position limit.
void LimitedStep::cap_unseen(const Law& law, const Here& here, const Affine& affine,
                             Cap& cap) const {
  const Eigen::Index n = here.n;
  const double deceleration = clock_braking(affine.qd1, limits_.acceleration);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double speed = std::abs(affine.qd1[i]);
    if (speed < 1e-9) continue;
    const double left = affine.qd1[i] > 0 ? limits_.position_max[i] - here.q[i]
                                          : here.q[i] - limits_.position_min[i];
    const double in =
        approach_speed(speed, left, deceleration * speed, limits_.position_margin, T_);
    if (in < speed) cap.limit(in / speed, "joint_limit");
  }
  if (affine.secant > kLongSecant * T_) {
    // The path's own bend, less what the arm's makes of it.
    const Joints about = 2 / affine.secant * (affine.qd1 - affine.tangent) - affine.qdd;
    bool slight = true;
    for (Eigen::Index i = 0; i < n; ++i) {
      slight &= std::abs(about[i]) < kSlightBend * kPlanAcceleration * limits_.acceleration[i];
    }
    if (slight) return;
  }
  Node next;
  if (!law.node(T_, here.q + T_ * affine.tangent, T_ * largest(affine.tangent), next)) return;
  for (Eigen::Index i = 0; i < n; ++i) {
    const double bend = std::abs(next.direction[i] - affine.tangent[i]) / T_;
    if (bend > 1e-9) {
      cap.limit(std::sqrt(kPlanAcceleration * limits_.acceleration[i] / bend), "path_curvature");
    }
  }
}

// --- tiers ------------------------------------------------------------------------------------

/// First tier: on the path. How much of the way back is taken goes down before the path is left;
/// the last try is what the joints have room for beside some motion along the path, or an arm of
/// small accelerations would never start back.
bool LimitedStep::on_path(const Law& law, const Affine& affine, const Box& box, const Cap& cap,
                          Step& step) const {
  if (!affine.regular) return false;
  for (const double beta : {1.0, 0.4, 0.16}) {
    if (on_path(law, affine, box, cap, beta, step)) return true;
    if (!affine.returning) return false;
  }
  const AlphaRange room = box.shares(affine.qd0 - affine.back, affine.back, affine.qd1);
  const double most = std::max(std::min(room.high, 0.16), room.low);
  const double beta = room.empty() ? 0.0 : room.low + kRoomUsed * (most - room.low);
  return on_path(law, affine, box, cap, beta, step) ||
         (beta > 0 && on_path(law, affine, box, cap, 0.0, step));
}

/// With a share 'beta' of the way back: alpha from the linear picture, the step without it, what
/// was missed into the picture, and again. The picture knows how the arm itself bends, at the alpha
/// before.
bool LimitedStep::on_path(const Law& law, const Affine& affine, const Box& box, const Cap& cap,
                          double beta, Step& step) const {
  Joints back = Joints::Zero();
  if (beta < 1 && affine.returning) back = (1 - beta) * affine.back;
  const AlphaRange straight = box.alphas(affine.qd0 - back, affine.qd1);
  if (straight.empty()) return false;
  double alpha = std::clamp(cap.alpha, straight.low, straight.high);
  const auto bend = [&]() -> Joints { return 0.5 * T_ * alpha * alpha * affine.qdd; };
  Joints missed = Joints::Zero();
  bool found = false;
  for (int pass = 0; pass < kPasses; ++pass) {
    const Joints qd0 = affine.qd0 + missed - back;
    const AlphaRange range = box.alphas(qd0 - bend(), affine.qd1);
    const bool bent = range.empty();  // the linear picture is worthless: go back by halves
    if (bent && found) break;
    const double inside = range.high < 1 ? kInside * (range.high - range.low) : 0.0;
    double next = bent ? (pass + 1 < kPasses ? 0.3 * alpha : 0.0)
                       : std::clamp(cap.alpha, range.low, range.high - inside);
    // A little inside the edge, or rounding would throw the harder braking away.
    if (found) next += 0.1 * std::max(alpha - next, 0.0);
    if (found && !(next < alpha)) break;
    alpha = next;
    const Joints linear = qd0 + alpha * affine.qd1 - bend();
    const Joints qd = law.finish(affine, alpha, beta, box.clamped(linear));
    const bool holds = box.holds(qd);
    if (holds) {
      found = true;
      step.qd = box.unpadded(qd);
      step.alpha = alpha;
      step.limited_by = alpha >= 1 ? "" : (range.high <= cap.alpha ? range.high_by : cap.by);
    }
    // Done, unless the joints are to brake harder than the linear picture could tell.
    if (found && (!holds || !(alpha > cap.alpha) || pass > 1)) break;
    missed += qd - linear;
  }
  return found;
}

/// Second tier: the pivot's rows stay exact, the tip as near to the path as the joints can. All
/// joints brake together, so that the tip stays near its tangent, down to what a moving trocar
/// takes of them: braked to zero in every cycle they would never be fast enough for the path, that
/// moves along, to be reached again. Where the step on the path is too fast for the flange, only as
/// much braking as that takes. Third: brake, as near to the pivot as may be.
void LimitedStep::off_path(const Law& law, const Here& here, const Affine& affine, const Box& box,
                           const Cap& cap, bool too_fast, Step& step) const {
  step.tier = 1;
  step.alpha = affine.regular ? box.least_beyond(affine.qd0, affine.qd1, cap.alpha) : 0.0;
  step.limited_by = !affine.regular ? "singularity"
                    : too_fast      ? "flange_velocity"
                                    : "joint_acceleration";
  Joints still = Joints::Zero();  // what the set-point at rest asks for
  if (affine.regular) still = affine.qd0;
  if (affine.regular && affine.returning) still -= affine.back;
  const JointVector moving = (here.qd_last - still).head(here.n);
  JointVector wanted = still.head(here.n) + braked_together(moving, limits_.acceleration, T_);
  if (too_fast) wanted = slowed_flange(here.J, here.flange_velocity, step.qd, wanted);
  if (on_rows(law, box, wanted, step.qd)) return;
  step.tier = 2;
  step.alpha = 0;
  on_rows(law, box, JointVector::Zero(here.n), step.qd);
  // Joints that brake one by one may speed the flange up.
  const JointVector last = here.qd_last.head(here.n);
  const Joints together = padded(braked_together(last, limits_.acceleration, T_));
  step.qd =
      slowed_flange(here.J, here.flange_velocity, step.qd, box.unpadded(box.clamped(together)));
}

/// The joint velocities nearest to 'wanted' on the pivot; whether they are on it.
bool LimitedStep::on_rows(const Law& law, const Box& box, const JointVector& wanted,
                          JointVector& qd) const {
  qd = box.unpadded(box.clamped(padded(wanted)));
  double left = INFINITY;
  for (int pass = 0; pass < kRowPasses; ++pass) {
    RcmRows rows = law.rows(padded(qd));
    if (pass > 0 && rows.e.norm() * T_ < kOnPivot) return true;
    // Rows that hold at 'qd', written for 'wanted'.
    for (Eigen::Index i = 0; i < qd.size(); ++i) {
      rows.e[0] += rows.J(0, i) * (qd[i] - wanted[i]);
      rows.e[1] += rows.J(1, i) * (qd[i] - wanted[i]);
    }
    left = box.nearest_on_rows(rows, wanted, qd) * T_;
  }
  return left < kRowsKept;
}

}  // namespace surg
