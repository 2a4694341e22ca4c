#include "surg_core/limits.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

/// Gain of the approach to a joint limit: speed <= this times the distance left [1/s].
constexpr double kApproachGain = 5.0;

/// Interval of alpha, with the reason for each end.
struct Interval {
  double low = 0, high = 1;
  const char* low_by = "";
  const char* high_by = "";

  /// Keeps alpha * rate within [lowest, highest].
  void keep(double rate, double lowest, double highest, const char* by) {
    if (std::abs(rate) < 1e-12) return;
    double from = lowest / rate, to = highest / rate;
    if (from > to) std::swap(from, to);
    if (from > low) {
      low = from;
      low_by = by;
    }
    if (to < high) {
      high = to;
      high_by = by;
    }
  }
};

/// The alpha in [0, highest] with the smallest worst ratio of a joint's acceleration to its limit.
/// The worst ratio is convex in alpha: ternary search, a fixed number of steps.
double least_acceleration_excess(const RobotConfig& robot, const JointVector& qd,
                                 const JointVector& qd_last, double T, double highest) {
  const auto worst = [&](double alpha) {
    double ratio = 0;
    for (int i = 0; i < qd.size(); ++i) {
      ratio = std::max(ratio, std::abs(alpha * qd[i] - qd_last[i]) / (robot.acceleration[i] * T));
    }
    return ratio;
  };
  double low = 0, high = highest;
  for (int i = 0; i < 40; ++i) {
    const double third = (high - low) / 3;
    if (worst(low + third) < worst(high - third)) {
      high -= third;
    } else {
      low += third;
    }
  }
  return worst(highest) <= worst(low) ? highest : 0.5 * (low + high);
}

}  // namespace

Scale uniform_scale(const RobotConfig& robot, const Limits& limits, const JointVector& qd,
                    const JointVector& qd_last, const JointVector& q, double flange_speed,
                    double T) {
  Interval hard;  // velocity, position, flange: never exceeded
  Interval soft;  // acceleration: met wherever the hard ones leave room
  for (int i = 0; i < qd.size(); ++i) {
    const double v = robot.velocity[i];
    // The margin only shapes the approach; motion away from a limit is never hindered.
    const double up = robot.position_max[i] - q[i];
    const double down = q[i] - robot.position_min[i];
    const bool near_up = up < limits.joint_margin, near_down = down < limits.joint_margin;
    const double highest = near_up ? std::clamp(kApproachGain * up, 0.0, v) : v;
    const double lowest = near_down ? -std::clamp(kApproachGain * down, 0.0, v) : -v;
    hard.keep(qd[i], -v, v, "joint_velocity");
    if (near_up || near_down) hard.keep(qd[i], lowest, highest, "joint_limit");
    const double dv = robot.acceleration[i] * T;
    soft.keep(qd[i], qd_last[i] - dv, qd_last[i] + dv, "joint_acceleration");
  }
  hard.keep(flange_speed, -limits.flange_velocity, limits.flange_velocity, "flange_velocity");

  Scale scale;
  scale.alpha = std::max(hard.high, 0.0);
  scale.limited_by = hard.high_by;
  if (soft.high < scale.alpha && soft.high >= soft.low) {
    scale.alpha = soft.high;
    scale.limited_by = soft.high_by;
  } else if (soft.high < soft.low) {
    // Joints pull apart: no alpha meets all accelerations.
    const double least = least_acceleration_excess(robot, qd, qd_last, T, scale.alpha);
    if (least < scale.alpha) {
      scale.alpha = least;
      scale.limited_by = "joint_acceleration";
    }
  }
  scale.alpha = std::clamp(scale.alpha, 0.0, 1.0);
  if (scale.alpha >= 1.0) scale.limited_by = "";
  return scale;
}

double outside_workspace(const Limits& limits, const Vector3& p_RTip) {
  const double depth = p_RTip.norm();
  return std::max({limits.depth_min - depth, depth - limits.depth_max,
                   depth * std::cos(limits.cone) - p_RTip.z()});
}

bool inside_workspace(const Limits& limits, const Vector3& p_RTip) {
  return p_RTip.allFinite() && outside_workspace(limits, p_RTip) <= 0;
}

double lateral_fade(const Limits& limits, double depth) {
  return std::clamp((depth - limits.depth_min) / (limits.depth_slow - limits.depth_min), 0.0, 1.0);
}

}  // namespace surg
