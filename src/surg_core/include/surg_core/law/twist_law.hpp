// Flange twists of the velocity laws for one cycle of the set-point's motion.
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/kinematics/arm_state.hpp"
#include "surg_core/motion/setpoint.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A flange twist feedback + alpha * path; alpha in [0, 1] is the rate of the set-point's clock.
struct TwistParts {
  Vector6 feedback = Vector6::Zero();  ///< what pivot, tip and roll need even if nothing moves on
  Vector6 path = Vector6::Zero();      ///< what the set-point's motion needs
};

/// Gains of the feedback [1/s].
struct Gains {
  double rcm, tip, roll;
};

/// The velocity form (docs/design/control_law.md) at the predicted state. setpoint: now; next:
/// after one period dt at full rate; X_BR: the rcm frame; v_BRcm: velocity of a moving trocar;
/// push: unit direction of the force on the tip, zero for none; the feedback does not act against
/// it.
TwistParts velocity_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                          const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains,
                          const Vector3& push, const Limits& limits, double dt);

/// Motion along the shaft line only, for a tip near or above its trocar, where the velocity form
/// would divide by a small depth. The instrument does not turn; lateral feedback acts by
/// translation.
TwistParts axial_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                       const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains, double dt);

/// The paper's equations as printed: open loop, rates straight from the profiler.
TwistParts paper_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                       const Pose& X_BR, const Limits& limits, double dt);

}  // namespace surg
