#include "surg_core/limited_step.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "surg_core/flange_cap.hpp"

namespace surg {
namespace {

constexpr int kPasses = 5;                // of interval, step and check
constexpr int kRowPasses = 4;             // of the pivot's rows off the path
constexpr double kPositionGuard = 1e-9;   // [rad] kept from position limits: rounding
constexpr double kApproachGain = 5.0;     // [1/s] speed over distance left, inside the margin
constexpr double kApproachBraking = 0.8;  // of the acceleration, on the way into the margin
constexpr double kOnPivot = 1e-12;        // [m]
constexpr double kRowsKept = 1e-9;        // [m] more than this off the pivot counts as leaving it
constexpr double kPivotTurns = 0.005;     // [m] deeper than that, a moving trocar turns the shaft
constexpr double kStill = 1e-4;  // share of a joint's velocity limit that counts as no motion
constexpr double kHeld = 0.02;   // alpha below which a still arm counts as held

constexpr double kPostureShare = 0.05;  // of the velocity limits, at most, for the null space
constexpr double kSagitta = 0.42e-6;    // [m] off the pivot between two samples

// How a displaced tip returns to its path.
constexpr double kReturnGain = 15;           // [1/s]
constexpr double kReturnAcceleration = 0.3;  // [m/s^2]
constexpr double kReturnAtOnce = 2e-8;  // [m] per cycle, always taken back: no visible joint motion
constexpr double kRollLever = 0.05;     // [m/rad] weighs roll against length

// The preview plans with less than the limits, so that the step has reserves to follow the plan.
constexpr double kPlanAcceleration = 0.8;
constexpr double kPlanVelocity = 0.995;
constexpr int kNodes = 14;
constexpr double kFirstSpacing = 0.002;  // [s] of the clock, and in units of stopping (below)
constexpr double kSpacingGrowth = 1.4;
constexpr double kFirstArc = 0.002;     // [rad]
constexpr double kSmallestArc = 1e-5;   // [rad] a path that cannot be followed this far ends here
constexpr double kTwistSpacing = 1e-4;  // [s] for the path's direction at a node

// How an arm returns to its recorded trace, in joint space.
constexpr double kRetraceReturn = 1.0;    // [rad/s^2]
constexpr double kRetraceAtOnce = 1e-7;   // [rad] per cycle
constexpr double kRetraceHorizon = 0.45;  // [s]
constexpr double kTraceSpacing = 1e-3;    // [s] for the trace's direction

double wrapped(double angle) { return std::remainder(angle, 2 * M_PI); }

double largest(const JointVector& v) { return v.size() > 0 ? v.cwiseAbs().maxCoeff() : 0.0; }

using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// The inverse of one Jacobian for several displacements: as 'inverse_velocity', which solves for
/// one at a time and is a third of the cost of a preview that way.
class Inverse {
 public:
  explicit Inverse(const Jacobian& J) : J_(J), n_(J.cols()) {
    if (n_ == 6) {
      A_ = J;
    } else {
      A_.setZero();
      for (Eigen::Index i = 0; i < n_; ++i) {
        const Vector6 column = J.col(i);
        A_.noalias() += column * column.transpose();
      }
    }
    double smallest = INFINITY, greatest = 0;
    for (int k = 0; k < 6; ++k) {
      int best = k;
      for (int i = k + 1; i < 6; ++i) {
        if (std::abs(A_(i, k)) > std::abs(A_(best, k))) best = i;
      }
      swap_[k] = best;
      if (best != k) {
        for (int c = 0; c < 6; ++c) std::swap(A_(k, c), A_(best, c));
      }
      const double pivot = std::abs(A_(k, k));
      smallest = std::min(smallest, pivot);
      greatest = std::max(greatest, pivot);
      const double inverse = 1.0 / A_(k, k);
      for (int i = k + 1; i < 6; ++i) A_(i, k) *= inverse;
      for (int c = k + 1; c < 6; ++c) {
        for (int i = k + 1; i < 6; ++i) A_(i, c) -= A_(i, k) * A_(k, c);
      }
    }
    // Written so that a NaN fails as well; J J^T has the squares.
    regular_ = n_ >= 6 && smallest > (n_ == 6 ? kSingular : kSingular * kSingular) * greatest;
  }

  bool regular() const { return regular_; }

  /// dq with J dq = x, for redundant arms the one next to 'posture'; zero where J is singular.
  JointVector operator()(Vector6 x, const JointVector& posture) const {
    if (!regular_) return JointVector::Zero(n_);
    if (n_ > 6) {
      for (Eigen::Index i = 0; i < n_; ++i) x -= Vector6(J_.col(i)) * posture[i];
    }
    for (int k = 0; k < 6; ++k) {
      std::swap(x[k], x[swap_[k]]);
    }
    for (int k = 0; k < 6; ++k) {
      for (int i = k + 1; i < 6; ++i) x[i] -= A_(i, k) * x[k];
    }
    for (int k = 5; k >= 0; --k) {
      x[k] /= A_(k, k);
      for (int i = 0; i < k; ++i) x[i] -= A_(i, k) * x[k];
    }
    if (n_ == 6) return x;
    JointVector dq = posture;
    for (Eigen::Index i = 0; i < n_; ++i) dq[i] += J_.col(i).dot(x);
    return dq;
  }

 private:
  static constexpr double kSingular = 1e-12;
  const Jacobian& J_;
  Eigen::Index n_;
  Matrix6 A_;
  std::array<int, 6> swap_{};
  bool regular_ = false;
};

/// From one flange pose to another as a small twist: translation, then rotation vector to the fifth
/// order of its angle.
Vector6 displacement(const Pose& from, const Pose& to) {
  const Matrix3 R = to.linear() * from.linear().transpose();
  const Vector3 sine = 0.5 * Vector3(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  Vector6 twist;
  twist.head<3>() = to.translation() - from.translation();
  twist.tail<3>() = (1.0 + sine.squaredNorm() / 6.0) * sine;
  return twist;
}

/// Fastest speed towards a limit at 'distance' from which braking by 'a' in steps of T still stops
/// before it: T v + v^2 / (2 a) <= distance, which the next cycle's v - a T fulfils again.
double braking_speed(double distance, double a, double T) {
  if (!(distance > 0)) return 0;
  const double aT = a * T;
  return std::sqrt(aT * aT + 2 * a * distance) - aT;
}

/// Fastest speed towards a position limit. A joint that brakes as hard as it may right at its limit
/// is overtaken by an arm that answers late; inside the margin it comes in gently.
double approach_speed(double distance, double a, double margin, double T) {
  const double hardest = braking_speed(distance, a, T);
  if (!(margin > 0)) return hardest;
  const double gentle = kApproachGain * std::clamp(distance, 0.0, margin);
  const double before = braking_speed(distance - margin, kApproachBraking * a, T);
  return std::min(hardest, std::hypot(gentle, before));
}

/// The interval of alpha that the joints leave, with the reason for its upper end.
struct Interval {
  double low = 0, high = 1;
  const char* high_by = "";

  void keep(double at_0, double rate, double lowest, double highest, const char* low_by,
            const char* top_by) {
    if (std::abs(rate) < 1e-12) {
      if (at_0 < lowest || at_0 > highest) low = INFINITY;
      return;
    }
    double from = (lowest - at_0) / rate, to = (highest - at_0) / rate;
    const char* by = top_by;
    if (rate < 0) {
      std::swap(from, to);
      by = low_by;
    }
    low = std::max(low, from);
    if (to < high) {
      high = to;
      high_by = by;
    }
  }
  bool empty() const { return !(low <= high); }
};

/// Largest x with A x + B y <= c for all rows, 0 <= x <= X, 0 <= y <= Y; the origin must be inside.
/// Seidel's incremental method: each row that the optimum so far breaks becomes the line on which
/// the new one lies.
struct Row {
  double A, B, c;
};
double largest_x(const std::array<Row, 2 * kMaxJoints + 4>& rows, int n, double X, double Y) {
  double x = X, y = Y;
  for (int i = 0; i < n; ++i) {
    const Row& row = rows[i];
    const double size = std::hypot(row.A, row.B);
    if (row.A * x + row.B * y <= row.c + 1e-12 * row.c) continue;
    if (!(size > 0)) return 0;
    // The line: foot of the origin, then along (B, -A).
    const double ux = row.B / size, uy = -row.A / size;
    const double fx = row.A / size * (row.c / size), fy = row.B / size * (row.c / size);
    double from = -INFINITY, to = INFINITY;
    const auto keep = [&](double A, double B, double c) {
      const double rate = A * ux + B * uy, rest = c - A * fx - B * fy;
      if (std::abs(rate) < 1e-15 * (std::abs(A) + std::abs(B))) return;
      if (rate > 0) {
        to = std::min(to, rest / rate);
      } else {
        from = std::max(from, rest / rate);
      }
    };
    keep(1, 0, X);
    keep(-1, 0, 0);
    keep(0, 1, Y);
    keep(0, -1, 0);
    for (int k = 0; k < i; ++k) keep(rows[k].A, rows[k].B, rows[k].c);
    if (!(from <= to)) return 0;  // rounding only: the origin is inside
    const double s = ux >= 0 ? to : from;
    x = fx + s * ux;
    y = fy + s * uy;
  }
  return std::clamp(x, 0.0, X);
}

}  // namespace

JointLimits joint_limits(const RobotConfig& robot, const Limits& limits) {
  return {robot.position_min, robot.position_max,     robot.velocity,
          robot.acceleration, limits.flange_velocity, limits.joint_margin};
}

/// Where the arm is at the beginning of the cycle.
struct LimitedStep::Here {
  JointVector q, qd_last;
  Pose X_BF;
  Jacobian J;
  ShaftState shaft;
  double flange_velocity = 0;  ///< [m/s] what there is of the limit
};

struct LimitedStep::Box {
  JointVector low, high;
  std::array<const char*, kMaxJoints> low_by, high_by;

  bool holds(const JointVector& qd) const {
    for (Eigen::Index i = 0; i < qd.size(); ++i) {
      if (!(qd[i] >= low[i] && qd[i] <= high[i])) return false;
    }
    return true;
  }
  JointVector clamped(const JointVector& qd) const { return qd.cwiseMax(low).cwiseMin(high); }
  Interval interval(const JointVector& qd0, const JointVector& qd1) const {
    Interval interval;
    for (Eigen::Index i = 0; i < qd0.size(); ++i) {
      interval.keep(qd0[i], qd1[i], low[i], high[i], low_by[i], high_by[i]);
    }
    return interval;
  }
  /// The alpha in [0, highest] that leaves the box least. Convex in alpha: ternary search.
  double nearest(const JointVector& qd0, const JointVector& qd1, double highest) const {
    const auto excess = [&](double alpha) {
      double worst = 0;
      for (Eigen::Index i = 0; i < qd0.size(); ++i) {
        const double v = qd0[i] + alpha * qd1[i];
        worst = std::max({worst, low[i] - v, v - high[i]});
      }
      return worst;
    };
    double from = 0, to = highest;
    for (int i = 0; i < 40; ++i) {
      const double third = (to - from) / 3;
      if (excess(from + third) <= excess(to - third)) {
        to -= third;
      } else {
        from += third;
      }
    }
    return 0.5 * (from + to);
  }
};

/// q_dot(alpha) to first order. 'back' is the part of the correction that may wait.
struct LimitedStep::Affine {
  JointVector qd0, qd1;
  JointVector tangent;  ///< d q / d clock at the beginning
  JointVector back;
  bool returning = false;  ///< 'back' is not zero
  bool moves = false;      ///< the path is not at rest
  bool regular = true;     ///< J could be inverted

  /// The clock speed that the arm's momentum suggests. qd1 is the path's secant over that much of
  /// the cycle: the one over all of it misses a bent path by more than the joints can brake.
  double expected(const JointVector& qd_last, double T) const {
    const double squared = tangent.squaredNorm();
    return squared > 0 ? std::clamp(qd_last.dot(tangent) / squared, kTwistSpacing / T, 1.0) : 1.0;
  }
};

/// A point of the path ahead.
struct LimitedStep::Node {
  JointVector q, direction;  ///< direction: d q / d clock
  SingularityMeasures measures;
  double flange = 0;  ///< [m/s] speed of its origin at full clock
};

struct LimitedStep::Preview {
  int n = 1;                                     ///< nodes; the first is here
  std::array<double, kNodes + 1> t{}, square{};  ///< [s] of the clock; its largest squared speed
  const char* by = "preview";

  /// Largest alpha with which the clock may go on: alpha^2 below the curve here and after alpha T.
  double alpha(double T) const {
    double alpha = std::min(1.0, std::sqrt(square[0]));
    for (int pass = 0; pass < 4; ++pass) {
      const double at = alpha * T;
      int k = 0;
      while (k + 2 < n && t[k + 1] <= at) ++k;
      if (n < 2) return 0;
      const double slope = (square[k + 1] - square[k]) / std::max(t[k + 1] - t[k], 1e-15);
      if (slope >= 0 && k == 0) return alpha;
      // alpha^2 = square_k + slope (alpha T - t_k), for a falling line the larger root.
      const double free = std::max(square[k] - slope * t[k], 0.0);
      const double b = 0.5 * slope * T;
      const double root = b + std::sqrt(b * b + free);
      const double next = std::clamp(root, 0.0, alpha);
      if (!(next < alpha * (1 - 1e-9))) return alpha;
      alpha = next;
    }
    return alpha;
  }
};

// --- the two laws -----------------------------------------------------------------------------

/// The exact form: joints of a pose that is on the constraint by construction.
class LimitedStep::ExactLaw {
 public:
  static constexpr bool kBarrier = true;

  ExactLaw(const LimitedStep& self, const Here& here, const Home& home, const Wish& wish)
      : self_(self), here_(here), home_(home), wish_(wish) {
    still_ = JointVector::Zero(here.q.size());
    ShaftGoal goal = wish.path(0);
    if (!wish.v_BRcm.isZero(0)) {  // the trocar is still where it was
      const Vector3 p_BTip = goal.p_BTip();
      goal.p_BRcm -= self.T_ * wish.v_BRcm;
      if (goal.depth > kPivotTurns) goal = tip_goal(goal.p_BRcm, p_BTip, goal.roll, goal.s_B);
    }
    // Where the instrument is, relative to where its path is now: zero unless a limit pushed it
    // off.
    const ShaftState shaft = shaft_state(here.X_BF, self.tool_, goal.p_BRcm);
    const Vector3 axis = goal.s_B.cross(shaft.s);
    const double sine = axis.norm(), cosine = goal.s_B.dot(shaft.s);
    off_swing_ =
        sine > 1e-15 ? Vector3(axis * (std::atan2(sine, cosine) / sine)) : Vector3(Vector3::Zero());
    off_depth_ = shaft.depth - goal.depth;
    off_roll_ =
        wrapped(absolute_roll(here.X_BF.linear(), home.R_BF, home.s_B, shaft.s) - goal.roll);
    const double off = off_swing_.norm() * std::max(std::abs(shaft.depth), kRollLever) +
                       std::abs(off_depth_) + std::abs(off_roll_) * kRollLever;
    const double T = self.T_;
    if (off > 0) {
      const double gentle =
          std::min(kReturnGain * off, std::sqrt(2 * kReturnAcceleration * off)) * T;
      keep_ = 1 - std::min(std::max(gentle, kReturnAtOnce) / off, 1.0);
    }
    returning_ = off > kReturnAtOnce;
  }

  Affine affine() const {
    const double T = self_.T_;
    Affine a;
    const JointVector posture = T * self_.gentle(wish_.posture);
    const bool pulled = posture.squaredNorm() > 0;
    const Inverse inverse(here_.J);
    const auto to = [&](const Pose& pose) {
      return inverse(displacement(here_.X_BF, pose), posture);
    };
    a.regular = inverse.regular();
    const JointVector rest = to(pose(0, keep_));
    a.tangent = (to(pose(kTwistSpacing, keep_)) - rest) / kTwistSpacing;
    const double expected = a.expected(here_.qd_last, T);
    a.qd0 = rest / T;
    a.qd1 = (to(pose(expected * T, keep_)) - rest) / (expected * T);
    a.returning = (returning_ || pulled) && a.regular;
    if (a.returning) {
      a.back = (rest - inverse(displacement(here_.X_BF, pose(0, 1.0)), still_)) / T;
    }
    a.moves = a.qd1.cwiseAbs().maxCoeff() > 1e-9;
    return a;
  }

  /// The step without linearisation. beta: how much of the way back to the path is taken.
  JointVector finish(double alpha, double beta, const JointVector& qd) const {
    const double T = self_.T_;
    const double keep = 1 - beta * (1 - keep_);
    JointVector q = here_.q + T * qd;
    Pose X;
    Jacobian J;
    self_.chain_.forward(q, X, J);
    q += Inverse(J)(displacement(X, pose(alpha * T, keep)), still_);
    // The pivot's own rows: well conditioned even where J is singular.
    for (int pass = 0; pass < 2; ++pass) {
      X = self_.chain_.forward(q);
      const ShaftState shaft = shaft_state(X, self_.tool_, wish_.path(0).p_BRcm);
      if (shaft.e.squaredNorm() < kOnPivot * kOnPivot) break;
      q += rcm_correction(rcm_rows(J, shaft)).dq;
    }
    return (q - here_.q) / T;
  }

  /// Rows of the pivot at the end of a cycle with qd: J qd' = J qd + e / T puts it on the trocar.
  RcmRows rows(const JointVector& qd) const {
    Pose X;
    Jacobian J;
    self_.chain_.forward(here_.q + self_.T_ * qd, X, J);
    RcmRows rows = rcm_rows(J, shaft_state(X, self_.tool_, wish_.path(0).p_BRcm));
    rows.e /= self_.T_;
    return rows;
  }

  double horizon() const { return wish_.path ? wish_.horizon : 0.0; }
  Vector3 p_BRcm() const { return wish_.path(0).p_BRcm; }
  bool node(double t, const JointVector& guess, double arc, Node& node) const {
    return self_.pose_node(guess, pose(t, 1.0), pose(t + kTwistSpacing, 1.0), arc, node);
  }

 private:
  Pose pose(double t, double keep) const {
    ShaftGoal goal = wish_.path(t);
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

  const LimitedStep& self_;
  const Here& here_;
  const Home& home_;
  const Wish& wish_;
  JointVector still_;
  Vector3 off_swing_;
  double off_depth_ = 0, off_roll_ = 0;
  double keep_ = 0;  ///< share of the distance to the path that is left after this cycle
  bool returning_ = false;
};

/// The velocity form: a twist, linear in alpha.
class LimitedStep::VelocityLaw {
 public:
  static constexpr bool kBarrier = true;

  VelocityLaw(const LimitedStep& self, const Here& here, const Home& home, const Wish& wish)
      : self_(self), here_(here), home_(home), wish_(wish), rows_(rcm_rows(here.J, here.shaft)) {}

  Affine affine() const {
    Affine a;
    const Eigen::Index n = here_.q.size();
    const JointVector none = JointVector::Zero(n);
    const JointVector posture = self_.gentle(wish_.posture);
    const Inverse inverse(here_.J);
    a.regular = inverse.regular();
    a.qd0 = inverse(wish_.feedback, posture);
    a.qd1 = a.tangent = inverse(wish_.forward, none);
    a.moves = a.qd1.cwiseAbs().maxCoeff() > 1e-9;
    // Lateral velocity that the pivot needs; the rest of the feedback may wait.
    Vector6 pivot = Vector6::Zero();
    const Vector3 v =
        wish_.feedback.head<3>() +
        Vector3(wish_.feedback.tail<3>()).cross(Vector3(here_.shaft.p_BNear - here_.shaft.p_BF));
    pivot.head<3>() = v - here_.shaft.s * here_.shaft.s.dot(v);
    a.back = a.qd0 - inverse(pivot, none);
    a.returning = a.regular;
    return a;
  }

  JointVector finish(double, double, const JointVector& qd) const { return qd; }

  RcmRows rows(const JointVector& qd) const {
    RcmRows rows = rows_;
    const Vector3& s = here_.shaft.s;
    const Vector3 u = s.unitOrthogonal(), w = s.cross(u);
    const Vector3 v =
        wish_.feedback.head<3>() +
        Vector3(wish_.feedback.tail<3>()).cross(Vector3(here_.shaft.p_BNear - here_.shaft.p_BF));
    rows.e = {u.dot(v), w.dot(v)};
    for (Eigen::Index i = 0; i < qd.size(); ++i) {
      rows.e[0] -= rows.J(0, i) * qd[i];
      rows.e[1] -= rows.J(1, i) * qd[i];
    }
    return rows;
  }

  Vector3 p_BRcm() const { return here_.shaft.p_BNear + here_.shaft.e; }
  double horizon() const { return wish_.path ? wish_.horizon : 0.0; }
  bool node(double t, const JointVector& guess, double arc, Node& node) const {
    if (!wish_.path) return false;
    return self_.pose_node(guess, pose_on_pivot(home_, self_.tool_, wish_.path(t)),
                           pose_on_pivot(home_, self_.tool_, wish_.path(t + kTwistSpacing)), arc,
                           node);
  }

 private:
  const LimitedStep& self_;
  const Here& here_;
  const Home& home_;
  const Wish& wish_;
  RcmRows rows_;
};

/// The recorded joint path backwards, put back on the pivot by its own rows alone: no inverse of J,
/// so no singularity can stop it.
class LimitedStep::RetraceLaw {
 public:
  static constexpr bool kBarrier = false;

  RetraceLaw(const LimitedStep& self, const Here& here, const JointTrace& trace, double back,
             double rate, const Vector3& p_BRcm)
      : self_(self), here_(here), trace_(trace), back_(back), rate_(rate), p_BRcm_(p_BRcm) {
    at_0_ = on_pivot(trace.at(back));
    off_ = here.q - at_0_;
    const double off = largest(off_);
    if (off > 0) {
      const double gentle =
          std::min(kReturnGain * off, std::sqrt(2 * kRetraceReturn * off)) * self.T_;
      keep_ = 1 - std::min(std::max(gentle, kRetraceAtOnce) / off, 1.0);
    }
  }

  double horizon() const { return kRetraceHorizon; }
  Vector3 p_BRcm() const { return p_BRcm_; }

  Affine affine() const {
    const double T = self_.T_;
    Affine a;
    a.qd0 = (at_0_ + keep_ * off_ - here_.q) / T;
    a.tangent = (on_pivot(trace_.at(back_ + rate_ * kTraceSpacing)) - at_0_) / kTraceSpacing;
    const double expected = a.expected(here_.qd_last, T);
    a.qd1 = (on_pivot(trace_.at(back_ + expected * rate_ * T)) - at_0_) / (expected * T);
    a.back = (keep_ - 1) * off_ / T;
    a.returning = true;
    a.moves = back_ < trace_.length();
    return a;
  }

  JointVector finish(double alpha, double beta, const JointVector&) const {
    const double T = self_.T_;
    const double keep = 1 - beta * (1 - keep_);
    const JointVector on_trace = on_pivot(trace_.at(back_ + alpha * rate_ * T));
    return (on_pivot(on_trace + keep * off_) - here_.q) / T;
  }

  RcmRows rows(const JointVector& qd) const {
    Pose X;
    Jacobian J;
    self_.chain_.forward(here_.q + self_.T_ * qd, X, J);
    RcmRows rows = rcm_rows(J, shaft_state(X, self_.tool_, p_BRcm_));
    rows.e /= self_.T_;
    return rows;
  }

  bool node(double t, const JointVector&, double, Node& node) const {
    node.q = on_pivot(trace_.at(back_ + rate_ * t));
    node.direction =
        (on_pivot(trace_.at(back_ + rate_ * (t + kTraceSpacing))) - node.q) / kTraceSpacing;
    node.flange = self_.flange_speed(node.q, node.direction);
    return true;
  }

 private:
  JointVector on_pivot(JointVector q) const {
    for (int pass = 0; pass < 3; ++pass) {
      Pose X;
      Jacobian J;
      self_.chain_.forward(q, X, J);
      const ShaftState shaft = shaft_state(X, self_.tool_, p_BRcm_);
      if (shaft.e.squaredNorm() < kOnPivot * kOnPivot) break;
      q += rcm_correction(rcm_rows(J, shaft)).dq;
    }
    return q;
  }

  const LimitedStep& self_;
  const Here& here_;
  const JointTrace& trace_;
  double back_, rate_;
  Vector3 p_BRcm_;
  JointVector at_0_, off_;
  double keep_ = 0;
};

// --- the step ---------------------------------------------------------------------------------

LimitedStep::LimitedStep(const Chain& chain, const Tool& tool, const JointLimits& limits, double T)
    : chain_(chain), tool_(tool), limits_(limits), barrier_(chain), T_(T) {}

LimitedStep::Box LimitedStep::box(const JointVector& q, const JointVector& qd_last) const {
  Box box;
  const Eigen::Index n = q.size();
  box.low.resize(n);
  box.high.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double a = limits_.acceleration[i], v = limits_.velocity[i];
    const double margin = limits_.position_margin;
    const double up =
        approach_speed(limits_.position_max[i] - q[i] - kPositionGuard, a, margin, T_);
    const double down =
        approach_speed(q[i] - limits_.position_min[i] - kPositionGuard, a, margin, T_);
    const double high = std::min(v, up), low = -std::min(v, down);
    // Shrunk by rounding, so that who divides the difference by T finds it inside.
    const double change = a * T_ * (1 - 1e-9);
    const double fastest = qd_last[i] + change, slowest = qd_last[i] - change;
    // Where both cannot be (a state from outside), acceleration wins: it brakes as it may.
    box.high[i] = std::clamp(high, slowest, fastest);
    box.low[i] = std::clamp(low, slowest, fastest);
    box.high_by[i] =
        fastest <= high ? "joint_acceleration" : (up < v ? "joint_limit" : "joint_velocity");
    box.low_by[i] =
        slowest >= low ? "joint_acceleration" : (down < v ? "joint_limit" : "joint_velocity");
  }
  return box;
}

/// A wish for the null space, small beside what the joints need for the path; zero where there is
/// no null space or no wish.
JointVector LimitedStep::gentle(const JointVector& posture) const {
  const Eigen::Index n = chain_.dof();
  if (n <= 6 || posture.size() != n || !posture.allFinite()) return JointVector::Zero(n);
  const double share = (posture.array() / limits_.velocity.array()).abs().maxCoeff();
  return posture * std::min(1.0, kPostureShare / std::max(share, 1e-12));
}

/// Whether a node of the preview may follow one with the measures 'from': neither through a
/// singularity nor, on the way there, closer than the barrier allows.
bool LimitedStep::passes(const SingularityMeasures& from, const SingularityMeasures& to) const {
  for (int i = 0; i < std::min(from.n, to.n); ++i) {
    const double before = std::abs(from.phi[i]), after = std::abs(to.phi[i]);
    if (to.phi[i] * from.phi[i] <= 0) return false;
    if (after < barrier_.phi_min() && after < before) return false;
  }
  return true;
}

/// Within the position limits, or not further beyond one than 'from'.
bool LimitedStep::inside_positions(const JointVector& q, const JointVector& from) const {
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    if (q[i] > std::max(limits_.position_max[i], from[i])) return false;
    if (q[i] < std::min(limits_.position_min[i], from[i])) return false;
  }
  return true;
}

/// Newton's method from 'guess', one step, to the pose of a path: joints, and their direction from
/// a second pose a little later. A step as long as the arc itself has left the path or is at its
/// end.
bool LimitedStep::pose_node(const JointVector& guess, const Pose& pose, const Pose& later,
                            double arc, Node& node) const {
  const JointVector still = JointVector::Zero(guess.size());
  Pose X;
  Jacobian J;
  chain_.forward(guess, X, J);
  const Inverse inverse(J);
  if (!inverse.regular()) return false;
  const JointVector rest = inverse(displacement(X, pose), still);
  if (largest(rest) > 0.35 * arc + 2e-3) return false;
  node.q = guess + rest;
  node.direction = (inverse(displacement(X, later), still) - rest) / kTwistSpacing;
  node.measures = barrier_.measures(X, J);
  node.flange = (later.translation() - pose.translation()).norm() / kTwistSpacing;
  return true;
}

/// Nodes ahead on the path, spaced wider the farther away, in clock and in joint space, and from
/// the last one backwards the clock's largest speed from which the joints can still brake to
/// standstill at the end: a plan to stop exists in every cycle.
template <typename Law>
LimitedStep::Preview LimitedStep::look_ahead(const Law& law, const Here& here,
                                             const Affine& affine) const {
  const Eigen::Index n = here.q.size();
  const double horizon = law.horizon();
  Preview preview;
  std::array<JointVector, kNodes + 1> direction;  // d q / d clock
  std::array<double, kNodes + 1> flange{};
  std::array<JointVector, kNodes + 1> at;  // q
  direction[0] = affine.tangent;
  flange[0] = (here.J * affine.tangent).head<3>().norm();
  preview.t[0] = 0;
  at[0] = here.q;
  SingularityMeasures last;
  if (Law::kBarrier) last = barrier_.measures(here.X_BF, here.J);
  JointVector q = here.q;
  double spacing = kFirstSpacing, arc = kFirstArc;
  int evaluations = 0;
  int k = 0;
  while (k < kNodes && evaluations < 2 * kNodes && preview.t[k] < horizon) {
    const double speed = largest(direction[k]);
    double dt = std::min(spacing, horizon - preview.t[k]);
    if (speed * dt > arc) dt = arc / speed;
    bool reached = false;
    for (; evaluations < 2 * kNodes; dt *= 0.4) {
      if (speed * dt < kSmallestArc && dt < 1e-4) break;
      ++evaluations;
      const double t = preview.t[k] + dt;
      Node node;
      if (!law.node(t, q + dt * direction[k], speed * dt, node)) continue;
      if (!passes(last, node.measures)) {
        preview.by = "singularity";
        continue;
      }
      if (!inside_positions(node.q, here.q)) {
        preview.by = "joint_limit";
        continue;
      }
      ++k;
      preview.t[k] = t;
      direction[k] = node.direction;
      flange[k] = node.flange;
      at[k] = q = node.q;
      last = node.measures;
      spacing = std::min(spacing, 2 * dt) * kSpacingGrowth;
      arc *= kSpacingGrowth;
      reached = true;
      break;
    }
    if (!reached) {
      if (preview.by[0] == 'p') preview.by = "unreachable";
      break;
    }
  }
  preview.n = k + 1;
  // Backwards: the largest squared clock speed at each node.
  preview.square[k] = 0;
  for (int i = k - 1; i >= 0; --i) {
    const double dt = preview.t[i + 1] - preview.t[i];
    const double top = kPlanVelocity * here.flange_velocity / std::max(flange[i], 1e-9);
    double most = std::min(1.0, top * top);
    for (Eigen::Index j = 0; j < n; ++j) {
      const double speed = std::max(std::abs(direction[i][j]), 1e-9);
      const double left = direction[i][j] > 0 ? limits_.position_max[j] - at[i][j]
                                              : at[i][j] - limits_.position_min[j];
      const double in = approach_speed(left, limits_.acceleration[j], limits_.position_margin, T_);
      const double v = kPlanVelocity * std::min(limits_.velocity[j], in) / speed;
      most = std::min(most, v * v);
    }
    std::array<Row, 2 * kMaxJoints + 4> rows;
    int n_rows = 0;
    for (Eigen::Index j = 0; j < n; ++j) {
      // q_ddot = u q'' + u' q' / 2 with u the squared clock speed, in the middle of the interval.
      const double bend = (direction[i + 1][j] - direction[i][j]) / dt;
      const double along = 0.5 * (direction[i + 1][j] + direction[i][j]) / dt;
      const double a = kPlanAcceleration * limits_.acceleration[j];
      const double A = 0.5 * (bend - along), B = 0.5 * (bend + along);
      if (std::abs(A) + std::abs(B) < 1e-12) continue;
      rows[n_rows++] = {A, B, a};
      rows[n_rows++] = {-A, -B, a};
    }
    preview.square[i] = largest_x(rows, n_rows, most, preview.square[i + 1]);
  }
  return preview;
}

/// Bounds of alpha that are not the joints' own: never below what the joints need to brake.
template <typename Law>
double LimitedStep::caps(const Law& law, const Here& here, const Affine& affine,
                         const char*& by) const {
  double cap = 1;
  by = "";
  const auto limit = [&](double alpha, const char* reason) {
    if (!(alpha < cap)) return;
    cap = std::max(alpha, 0.0);
    by = reason;
  };
  if (!affine.moves) return cap;
  const Vector6 forward = here.J * affine.qd1;
  const double flange = forward.head<3>().norm();
  if (flange > here.flange_velocity) limit(here.flange_velocity / flange, "flange_velocity");
  // Joints go straight between samples, the pivot's curve does not: its sagitta grows with the
  // square of the speed.
  {
    const double speed = affine.expected(here.qd_last, T_);
    const JointVector half = 0.5 * T_ * speed * affine.qd1;
    const Vector3 p_BRcm = law.p_BRcm();
    const auto off = [&](const JointVector& q) {
      return shaft_state(chain_.forward(q), tool_, p_BRcm).e;
    };
    const Vector3 here_off = shaft_state(here.X_BF, tool_, p_BRcm).e;
    const double sagitta = (off(here.q + half) - 0.5 * (off(here.q + 2 * half) + here_off)).norm();
    if (sagitta > kSagitta) limit(speed * std::sqrt(kSagitta / sagitta), "pivot_between_samples");
  }
  // Singularity barrier: rate of each measure along the path, from a small step of it.
  SingularityMeasures now;
  if (Law::kBarrier) now = barrier_.measures(here.X_BF, here.J);
  double closest = 1;
  for (int i = 0; i < now.n; ++i) closest = std::min(closest, std::abs(now.phi[i]));
  if (closest < 0.3) {
    const double h = 1e-5 / std::max(largest(affine.qd1), 1e-9);
    Pose X;
    Jacobian J;
    chain_.forward(here.q + h * affine.qd1, X, J);
    const SingularityMeasures soon = barrier_.measures(X, J);
    for (int i = 0; i < now.n; ++i) {
      const double rate = (std::abs(soon.phi[i]) - std::abs(now.phi[i])) / h;
      if (rate < 0) limit(barrier_.fastest_approach(now.phi[i]) / -rate, "singularity");
    }
  }
  if (affine.regular && !(law.horizon() > 0)) {
    // Nobody looks ahead: keep what the path bends here, and what it takes all joints together to
    // stop before the first of them meets its position limit.
    double deceleration = INFINITY;  // of the clock
    for (Eigen::Index i = 0; i < here.q.size(); ++i) {
      const double speed = std::max(std::abs(affine.qd1[i]), 1e-9);
      deceleration = std::min(deceleration, kPlanAcceleration * limits_.acceleration[i] / speed);
    }
    for (Eigen::Index i = 0; i < here.q.size(); ++i) {
      const double speed = affine.qd1[i];
      if (std::abs(speed) < 1e-9) continue;
      const double left =
          speed > 0 ? limits_.position_max[i] - here.q[i] : here.q[i] - limits_.position_min[i];
      const double a = deceleration * std::abs(speed);
      limit(approach_speed(left, a, limits_.position_margin, T_) / std::abs(speed), "joint_limit");
    }
    Node next;
    if (law.node(T_, here.q + T_ * affine.tangent, T_ * largest(affine.tangent), next)) {
      for (Eigen::Index i = 0; i < here.q.size(); ++i) {
        const double bend = std::abs(next.direction[i] - affine.tangent[i]) / T_;
        if (bend > 1e-9) {
          limit(std::sqrt(kPlanAcceleration * limits_.acceleration[i] / bend), "path_curvature");
        }
      }
    }
  }
  if (law.horizon() > 0 && affine.regular) {
    const Preview preview = look_ahead(law, here, affine);
    limit(preview.alpha(T_), preview.by);
  }
  return cap;
}

namespace {

/// The joint velocities nearest to 'wanted' inside a box with rows J qd = J wanted + e. Dual Newton
/// method on two multipliers: qd = clamp(wanted + J^T lambda). Returns what is left of the rows.
double nearest_on_rows(const RcmRows& rows, const JointVector& wanted, const JointVector& low,
                       const JointVector& high, JointVector& qd) {
  const Eigen::Index n = wanted.size();
  double l0 = 0, l1 = 0;
  const auto residual = [&](double m0, double m1, Eigen::Vector2d& r, Eigen::Matrix2d& H) {
    r = rows.e;
    H.setZero();
    for (Eigen::Index i = 0; i < n; ++i) {
      const double free = wanted[i] + rows.J(0, i) * m0 + rows.J(1, i) * m1;
      qd[i] = std::clamp(free, low[i], high[i]);
      const double moved = qd[i] - wanted[i];
      r[0] -= rows.J(0, i) * moved;
      r[1] -= rows.J(1, i) * moved;
      if (free == qd[i]) {
        H(0, 0) += rows.J(0, i) * rows.J(0, i);
        H(0, 1) += rows.J(0, i) * rows.J(1, i);
        H(1, 1) += rows.J(1, i) * rows.J(1, i);
      }
    }
  };
  Eigen::Vector2d r;
  Eigen::Matrix2d H;
  residual(l0, l1, r, H);
  for (int pass = 0; pass < 12 && r.squaredNorm() > 1e-28; ++pass) {
    const double ridge = 1e-9 + 1e-3 * (H(0, 0) + H(1, 1) < 1e-6);
    const double a = H(0, 0) + ridge, b = H(0, 1), c = H(1, 1) + ridge;
    const double determinant = a * c - b * b;
    const double d0 = (c * r[0] - b * r[1]) / determinant;
    const double d1 = (a * r[1] - b * r[0]) / determinant;
    // The residual is the gradient of a concave function: go on until it turns.
    double step = 1;
    Eigen::Vector2d r_next;
    for (int half = 0; half < 6; ++half, step *= 0.5) {
      residual(l0 + step * d0, l1 + step * d1, r_next, H);
      if (r_next[0] * d0 + r_next[1] * d1 >= -0.5 * std::abs(r[0] * d0 + r[1] * d1)) break;
    }
    l0 += step * d0;
    l1 += step * d1;
    r = r_next;
  }
  return r.norm();
}

}  // namespace

double LimitedStep::flange_speed(const JointVector& q, const JointVector& qd) const {
  Pose X;
  Jacobian J;
  chain_.forward(q, X, J);
  return (J * qd).head<3>().norm();
}

template <typename Law>
Step LimitedStep::run(const Law& law, const Here& here, const Box& box) const {
  const Affine affine = law.affine();
  Step step;
  const char* cap_by = "";
  const double cap = affine.regular ? caps(law, here, affine, cap_by) : 0.0;

  // First tier: on the path. How much of the way back is taken goes down before the path is left.
  JointVector missed = JointVector::Zero(here.q.size());
  bool too_fast = false;  // for the flange: on the path the joints cannot brake as hard as it takes
  for (double beta = 1; affine.regular; beta = beta > 0.2 ? 0.4 * beta : 0.0) {
    missed.setZero();
    double alpha = 0;
    bool found = false;
    for (int pass = 0; pass < kPasses; ++pass) {
      JointVector qd0 = affine.qd0 + missed;
      if (beta < 1 && affine.returning) qd0 -= (1 - beta) * affine.back;
      const Interval interval = box.interval(qd0, affine.qd1);
      const bool bent = interval.empty();  // the linear picture is worthless: go back by halves
      if (bent && (pass == 0 || found)) break;
      double next = bent ? (pass + 1 < kPasses ? 0.3 * alpha : 0.0)
                         : std::clamp(cap, interval.low, interval.high);
      // A little inside the edge, or rounding would throw the harder braking away.
      if (found) next += 0.1 * std::max(alpha - next, 0.0);
      if (found && !(next < alpha)) break;
      alpha = next;
      const JointVector linear = qd0 + alpha * affine.qd1;
      const JointVector qd = law.finish(alpha, beta, box.clamped(linear));
      const bool holds = box.holds(qd);
      if (holds) {
        found = true;
        step.qd = qd;
        step.alpha = alpha;
        step.limited_by = alpha >= 1 ? "" : (interval.high <= cap ? interval.high_by : cap_by);
      }
      // Done, unless the joints are to brake harder than the linear picture could tell.
      if (found && (!holds || !(alpha > cap) || pass > 1)) break;
      missed += qd - linear;
    }
    if (found) {
      step.held = affine.moves && step.alpha < kHeld &&
                  (step.qd.array().abs() < kStill * limits_.velocity.array()).all();
      if (!((here.J * step.qd).head<3>().norm() > here.flange_velocity)) return step;
      too_fast = true;
      break;
    }
    if (!affine.returning || beta == 0) break;
  }

  // Second tier: the pivot's rows stay exact, the tip as near to the path as the joints can.
  step.tier = 1;
  step.alpha = affine.regular ? box.nearest(affine.qd0, affine.qd1, cap) : 0.0;
  step.limited_by = !affine.regular ? "singularity"
                    : too_fast      ? "flange_velocity"
                                    : "joint_acceleration";
  // All joints brake together, so that the tip stays near its tangent; from rest the path is tried
  // again.
  JointVector wanted = braked_together(here.qd_last, limits_.acceleration, T_);
  if (too_fast) wanted = slowed_flange(here.J, here.flange_velocity, step.qd, wanted);
  for (int attempt = 0; attempt < 2; ++attempt) {
    JointVector qd = box.clamped(wanted);
    double left = INFINITY;
    for (int pass = 0; pass < kRowPasses; ++pass) {
      RcmRows rows = law.rows(qd);
      if (pass > 0 && rows.e.norm() * T_ < kOnPivot) {
        left = 0;
        break;
      }
      // Rows that hold at 'qd', written for 'wanted'.
      for (Eigen::Index i = 0; i < qd.size(); ++i) {
        rows.e[0] += rows.J(0, i) * (qd[i] - wanted[i]);
        rows.e[1] += rows.J(1, i) * (qd[i] - wanted[i]);
      }
      left = nearest_on_rows(rows, wanted, box.low, box.high, qd) * T_;
    }
    step.qd = qd;
    if (left < kRowsKept) break;
    // Third: brake, as near to the pivot as may be.
    step.tier = 2;
    step.alpha = 0;
    wanted.setZero();
  }
  step.held = affine.moves && (step.qd.array().abs() < kStill * limits_.velocity.array()).all();
  return step;
}

Step LimitedStep::exact(const JointVector& q, const JointVector& qd_last, const Home& home,
                        const Wish& wish) const {
  Here here;
  here.q = q;
  here.qd_last = qd_last;
  here.flange_velocity = limits_.flange_velocity - wish.flange_lead;
  chain_.forward(q, here.X_BF, here.J);
  const ExactLaw law(*this, here, home, wish);
  return run(law, here, box(q, qd_last));
}

Step LimitedStep::velocity(const JointVector& q, const JointVector& qd_last, const Home& home,
                           const Vector3& p_BRcm, const Wish& wish) const {
  Here here;
  here.q = q;
  here.qd_last = qd_last;
  here.flange_velocity = limits_.flange_velocity;
  chain_.forward(q, here.X_BF, here.J);
  here.shaft = shaft_state(here.X_BF, tool_, p_BRcm);
  const VelocityLaw law(*this, here, home, wish);
  return run(law, here, box(q, qd_last));
}

Step LimitedStep::retrace(const JointVector& q, const JointVector& qd_last, const JointTrace& trace,
                          double back, double rate, const Vector3& p_BRcm,
                          double flange_lead) const {
  Here here;
  here.q = q;
  here.qd_last = qd_last;
  here.flange_velocity = limits_.flange_velocity - flange_lead;
  chain_.forward(q, here.X_BF, here.J);
  const RetraceLaw law(*this, here, trace, back, rate, p_BRcm);
  return run(law, here, box(q, qd_last));
}

}  // namespace surg
