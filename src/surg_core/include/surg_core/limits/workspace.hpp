// Workspace of the tip (a cone about the home axis between two depths) and restrictions near the
// trocar. limited_step.hpp has the joint limits.
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/types.hpp"

namespace surg {

constexpr double kApproachGain = 5.0;  ///< [1/s] speed towards an end over the distance left
constexpr double kRollLever = 0.05;    ///< [m/rad] weighs roll against length

/// How far [m] a tip position in the rcm frame lies outside depth_min..depth_max and the cone;
/// negative: inside.
double outside_workspace(const Limits& limits, const Vector3& p_RTip);

/// Whether a tip target in the rcm frame lies within depth_min..depth_max and the cone.
bool inside_workspace(const Limits& limits, const Vector3& p_RTip);

/// The point nearest to a finite tip position in the rcm frame that lies at least 'margin' [m]
/// inside the workspace.
Vector3 nearest_inside(const Limits& limits, const Vector3& p_RTip, double margin);

/// Whether a tip position less than 'depth' [m] from the trocar lies beside the shaft (unit s_R).
/// There, targets and profiles may only lead along the shaft (F24).
bool aside_near_trocar(const Vector3& p_RTip, const Vector3& s_R, double depth);

/// Factor for lateral tip motion near the trocar (F24): 1 above depth_slow, 0 below depth_min.
double lateral_fade(const Limits& limits, double depth);

}  // namespace surg
