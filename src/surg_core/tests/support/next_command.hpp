// Commands for a controller under test, and the law that it runs.
#pragma once

#include <cstdint>

#include "surg_core/controller.hpp"

namespace surg::test {

constexpr std::uint32_t kMe = 7, kOther = 8;  ///< senders

/// An empty command; the caller fills it.
inline MotionCommand command(Motion motion, std::uint32_t source = kMe) {
  MotionCommand out;
  out.motion = motion;
  out.source = source;
  return out;
}

/// One with a position or a velocity.
inline MotionCommand command(Motion motion, const Vector3& p) {
  MotionCommand out = command(motion);
  out.p = p;
  return out;
}

/// One with joints of the trocar frame.
inline MotionCommand joints(Motion motion, const Vector4& values) {
  MotionCommand out = command(motion);
  out.joints = values;
  return out;
}

/// Adds one to the inputs.
inline MotionCommand& next_command(Inputs& in, Motion motion, std::uint32_t source = kMe) {
  return in.commands[in.n_commands++] = command(motion, source);
}

/// A pose of the tip in the rcm frame: position [m] and roll [rad].
inline MotionCommand pose(const Controller& controller, Motion motion, const Vector3& p_RTip,
                          double roll = 0) {
  MotionCommand out = command(motion);
  out.p = p_RTip;
  const Vector3 s_B = controller.X_BR().linear() * p_RTip.normalized();
  out.rotation = controller.tool_orientation(s_B, roll);
  return out;
}

/// Distance of the shaft's line from a point in B [m].
inline double off_shaft(const Chain& chain, const JointVector& q, const ToolCalibration& tool,
                        const Vector3& p_B) {
  const Pose X_BF = chain.forward(q);
  return Vector3(X_BF.linear() * tool.s_F).cross(Vector3(p_B - X_BF * tool.p_FTip)).norm();
}

}  // namespace surg::test
