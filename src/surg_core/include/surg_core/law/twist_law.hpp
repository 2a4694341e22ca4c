// What the law asks of the flange in one cycle, for a set-point on its way.
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/kinematics/arm_state.hpp"
#include "surg_core/motion/setpoint.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A flange twist in two parts: feedback + alpha * path, where alpha in [0, 1] is the speed of the
/// set-point's clock.
struct TwistWish {
  Vector6 feedback = Vector6::Zero();  ///< what pivot, tip and roll need even if nothing moves on
  Vector6 path = Vector6::Zero();      ///< what the set-point's motion needs
};

/// Gains of the feedback [1/s].
struct Gains {
  double rcm, tip, roll;
};

/// The velocity form (docs/design/control_law.md) at the pose where the command will take
/// effect. setpoint: now; next: after one period dt at full speed; X_BR: the rcm frame; v_BRcm: of
/// a moving trocar;
/// push: unit direction of the force on the tip, zero for none; the feedback does not pull against
/// it.
TwistWish velocity_wish(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                        const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains,
                        const Vector3& push, const Limits& limits, double dt);

/// Along the shaft line only, for a tip near or above its trocar, where the velocity form would
/// divide by the depth: the instrument moves without turning, and sideways onto the pivot.
TwistWish axial_wish(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                     const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains, double dt);

/// The paper's equations as printed: open loop, rates straight from the profiler.
TwistWish paper_wish(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                     const Pose& X_BR, const Limits& limits, double dt);

}  // namespace surg
