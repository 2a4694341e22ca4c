// Limits without leaving the pivot: one factor for all joints, so that direction and RCM are kept
// (clamping joints one by one moved the pivot by 33 mm in a prototype).
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// The factor alpha in [0, 1] for joint and flange velocities, and what set it.
struct Scale {
  double alpha = 1;
  const char* limited_by = "";  ///< static string; empty when alpha is 1
};

/// Largest alpha for which alpha * qd keeps every joint inside its velocity limit, its acceleration
/// limit against the last command, the approach speed to its position limit (F20), and the flange
/// inside its speed cap. Where velocity and acceleration cannot both be met, velocity wins.
///
/// qd, qd_last, q: wanted, last commanded velocities [rad/s] and positions [rad]; T: period [s];
/// flange_speed: of the unscaled command [m/s].
Scale uniform_scale(const RobotConfig& robot, const Limits& limits, const JointVector& qd,
                    const JointVector& qd_last, const JointVector& q, double flange_speed,
                    double T);

/// How far [m] a tip position in the rcm frame lies outside depth_min..depth_max and the cone;
/// negative: inside.
double outside_workspace(const Limits& limits, const Vector3& p_RTip);

/// Whether a tip target in the rcm frame lies within depth_min..depth_max and the cone.
bool inside_workspace(const Limits& limits, const Vector3& p_RTip);

/// Factor for lateral tip motion near the trocar (F24): 1 above depth_slow, 0 below depth_min.
double lateral_fade(const Limits& limits, double depth);

}  // namespace surg
