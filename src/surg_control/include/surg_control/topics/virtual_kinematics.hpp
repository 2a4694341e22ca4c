// The four virtual joints (yaw, pitch, insertion, roll) and the tool pose in the rcm frame, both
// ways (docs/reference/conventions.md, "Virtual joints"). Pure.
#pragma once

#include "surg_control/topics/base_frame.hpp"
#include "surg_core/types.hpp"

namespace surg_control {

/// X_RTool of the virtual joints [rad, rad, m, rad].
ToolPose forward_kinematics(const surg::Vector4& joints);

/// Virtual joints of a tool pose. Of the orientation only the roll about the shaft counts
/// (swing-twist); it is given as the turn nearest to 'roll_near' [rad]. The position must not be
/// the trocar point itself, from which no direction can be read.
surg::Vector4 inverse_kinematics(const ToolPose& X_RTool, double roll_near);

/// Angle [rad] between the tool's z axis and the shaft direction for its position: the part of an
/// orientation that four degrees of freedom cannot follow. 0 at the trocar point and for NaN.
double ignored_tilt(const ToolPose& X_RTool);

}  // namespace surg_control
