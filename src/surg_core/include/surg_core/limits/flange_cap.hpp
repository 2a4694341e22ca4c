// The flange's speed in a command: kept by braking, so that no joint limit is broken for it.
#pragma once

#include "surg_core/types.hpp"

namespace surg {

/// The last command on its way to zero: all joints slower by one factor, so that the tip stays near
/// its tangent, as hard as the first of them may brake.
///
/// qd_last: [rad/s]. acceleration: limits [rad/s^2]. T: control period [s].
JointVector braked_together(const JointVector& qd_last, const JointVector& acceleration, double T);

/// As much of 'fast' as leaves the flange 'limit' [m/s], mixed with 'slow' [rad/s]. What holds for
/// both and is convex (velocity and acceleration limits) holds for the mixture. 'fast' itself where
/// it is slow enough; 'slow' where that is too fast as well.
JointVector slowed_flange(const Jacobian& J, double limit, const JointVector& fast,
                          const JointVector& slow);

}  // namespace surg
