// Keeps the flange's speed in a command by braking, without exceeding a joint limit.
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// The last command scaled down by one factor for all joints, so that the tip stays near its
/// tangent, as fast as the first joint at its limit may brake.
///
/// qd_last: [rad/s]. acceleration: limits [rad/s^2]. T: control period [s].
JointVector braked_together(const JointVector& qd_last, const JointVector& acceleration, double T);

/// Mixes 'fast' with 'slow' [rad/s] so that the flange moves at 'limit' [m/s] at most. Convex
/// limits (velocity, acceleration) that hold for both hold for the mixture. Returns 'fast' if it is
/// slow enough and 'slow' if even that is too fast.
JointVector slowed_flange(const Jacobian& J, double limit, const JointVector& fast,
                          const JointVector& slow);

}  // namespace surg
