#include "limits/joint_box.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/limits/workspace.hpp"

namespace surg {
namespace {

constexpr double kPositionGuard = 1e-9;  // [rad] kept from position limits: rounding

/// Fastest speed towards a limit at 'distance' from which braking by 'a' in steps of T still stops
/// before it: T v + v^2 / (2 a) <= distance, which the next cycle's v - a T fulfils again.
double braking_speed(double distance, double a, double T) {
  if (!(distance > 0)) return 0;
  const double aT = a * T;
  return std::sqrt(aT * aT + 2 * a * distance) - aT;
}

}  // namespace

double approach_speed(double distance, double a, double margin, double T) {
  const double hardest = braking_speed(distance, a, T);
  if (!(margin > 0)) return hardest;
  const double gentle = kApproachGain * std::clamp(distance, 0.0, margin);
  const double before = braking_speed(distance - margin, kPlanAcceleration * a, T);
  return std::min(hardest, std::hypot(gentle, before));
}

void AlphaRange::keep(double at_0, double rate, double lowest, double highest, const char* low_by,
                      const char* top_by) {
  if (std::abs(rate) < 1e-12) {
    if (at_0 < lowest || at_0 > highest) low = INFINITY;
    return;
  }
  const double per = 1 / rate;
  double from = (lowest - at_0) * per, to = (highest - at_0) * per;
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

LimitedStep::Box::Box(const JointLimits& limits, double T, const Here& here) : n_(here.n) {
  const Joints &q = here.q, &qd_last = here.qd_last;
  for (Eigen::Index i = 0; i < n_; ++i) {
    const double a = limits.acceleration[i], v = limits.velocity[i];
    const double margin = limits.position_margin;
    const double to_top = limits.position_max[i] - q[i] - kPositionGuard;
    const double to_bottom = q[i] - limits.position_min[i] - kPositionGuard;
    const double high = approach_speed(v, to_top, a, margin, T);
    const double low = -approach_speed(v, to_bottom, a, margin, T);
    // Shrunk by rounding, so that who divides the difference by T finds it inside.
    const double change = a * T * (1 - 1e-9);
    const double fastest = qd_last[i] + change, slowest = qd_last[i] - change;
    // Where both cannot be (a state from outside), acceleration wins: it brakes as it may.
    high_[i] = std::clamp(high, slowest, fastest);
    low_[i] = std::clamp(low, slowest, fastest);
    // Position limits come before the correction's room.
    const double room = std::clamp(here.room[i], -kMostLead * change, kMostLead * change);
    if (room > 0) high_[i] = std::max(low_[i], std::min(high_[i], fastest - room));
    if (room < 0) low_[i] = std::min(high_[i], std::max(low_[i], slowest - room));
    high_by_[i] =
        fastest <= high ? "joint_acceleration" : (high < v ? "joint_limit" : "joint_velocity");
    low_by_[i] =
        slowest >= low ? "joint_acceleration" : (low > -v ? "joint_limit" : "joint_velocity");
  }
}

bool LimitedStep::Box::holds(const Joints& qd) const {
  return (qd.array() >= low_.array()).all() && (qd.array() <= high_.array()).all();
}

Joints LimitedStep::Box::clamped(const Joints& qd) const {
  return qd.cwiseMax(low_).cwiseMin(high_);
}

AlphaRange LimitedStep::Box::alphas(const Joints& qd0, const Joints& qd1) const {
  AlphaRange range;
  for (Eigen::Index i = 0; i < n_; ++i) {
    range.keep(qd0[i], qd1[i], low_[i], high_[i], low_by_[i], high_by_[i]);
  }
  return range;
}

/// Each joint bounds alpha from below and above by a line over the share; every lower line must
/// stay below every upper one.
AlphaRange LimitedStep::Box::shares(const Joints& qd0, const Joints& back,
                                    const Joints& qd1) const {
  struct Line {
    double at_0, slope;
  };
  std::array<Line, kMaxJoints + 1> lower, upper;
  lower[0] = {0, 0};
  upper[0] = {1, 0};
  int n = 1;
  AlphaRange range;
  for (Eigen::Index i = 0; i < n_; ++i) {
    if (std::abs(qd1[i]) < 1e-12) {
      range.keep(qd0[i], back[i], low_[i], high_[i], "", "");
      continue;
    }
    const double slope = -back[i] / qd1[i];
    lower[n] = {(low_[i] - qd0[i]) / qd1[i], slope};
    upper[n] = {(high_[i] - qd0[i]) / qd1[i], slope};
    if (qd1[i] < 0) std::swap(lower[n], upper[n]);
    ++n;
  }
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < n; ++k) {
      range.keep(upper[k].at_0 - lower[i].at_0, upper[k].slope - lower[i].slope, 0, INFINITY, "",
                 "");
    }
  }
  return range;
}

/// Convex in alpha: ternary search.
double LimitedStep::Box::least_beyond(const Joints& qd0, const Joints& qd1, double highest) const {
  const auto excess = [&](double alpha) {
    const Joints v = qd0 + alpha * qd1;
    return std::max(0.0, (low_ - v).cwiseMax(v - high_).maxCoeff());
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

/// Dual Newton method on two multipliers: qd = clamp(wanted + J^T lambda).
double LimitedStep::Box::nearest_on_rows(const RcmRows& rows, const JointVector& wanted,
                                         JointVector& qd) const {
  const Eigen::Index n = wanted.size();
  double l0 = 0, l1 = 0;
  const auto residual = [&](double m0, double m1, Eigen::Vector2d& r, Eigen::Matrix2d& H) {
    r = rows.e;
    H.setZero();
    for (Eigen::Index i = 0; i < n; ++i) {
      const double free = wanted[i] + rows.J(0, i) * m0 + rows.J(1, i) * m1;
      qd[i] = std::clamp(free, low_[i], high_[i]);
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

}  // namespace surg
