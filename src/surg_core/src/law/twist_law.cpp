#include "surg_core/law/twist_law.hpp"

#include <algorithm>

#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/workspace.hpp"

namespace surg {
namespace {

/// Mean velocity of the tip over the coming cycle, so that it arrives where the profile says.
Vector3 mean_velocity(const Setpoint& setpoint, const Setpoint& next, const Pose& X_BR, double dt) {
  return X_BR.linear() * (next.p_RTip() - setpoint.p_RTip()) / dt;
}

}  // namespace

TwistParts velocity_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                          const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains,
                          const Vector3& push, const Limits& limits, double dt) {
  const InstrumentState& at = arm.predicted();
  const ShaftState& shaft = at.shaft;
  const Vector3& s = shaft.s;
  const double depth = std::max(shaft.depth, limits.depth_min);
  const double fade = lateral_fade(limits, shaft.depth);
  // The set-point avoids forbidden motion by itself; the feedback towards it does not.
  const auto allowed = [&](const Vector3& requested) {
    const Vector3 v = requested - std::min(0.0, requested.dot(push)) * push;
    return Vector3(s.dot(v) * s + fade * (v - s.dot(v) * s));
  };
  // One term of the law, which is linear in tip velocity, roll rate (without the holonomy of the
  // swing), pivot velocity and gain.
  const auto part = [&](const Vector3& v, double roll_rate, const Vector3& v_pivot, double gain) {
    const Vector3 v_lateral = v_pivot - s * s.dot(v_pivot) + gain * shaft.e;
    const Vector3 s_dot = (v - s * s.dot(v) - v_lateral) / depth;
    const double about = roll_rate + roll_holonomy_rate(arm.s_home(), s, s_dot);
    return rcm_twist(shaft, v, about, v_pivot, gain, limits.depth_min);
  };
  const Vector3 p_BSet = X_BR * setpoint.p_RTip();
  TwistParts twist;
  twist.feedback = part(allowed(gains.tip * (p_BSet - shaft.p_BTip)),
                        gains.roll * (setpoint.roll() - at.roll), v_BRcm, gains.rcm);
  twist.path = part(mean_velocity(setpoint, next, X_BR, dt), (next.roll() - setpoint.roll()) / dt,
                    Vector3::Zero(), 0);
  return twist;
}

TwistParts axial_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                       const Pose& X_BR, const Vector3& v_BRcm, const Gains& gains, double dt) {
  const InstrumentState& at = arm.predicted();
  const ShaftState& shaft = at.shaft;
  const Vector3& s = shaft.s;
  const auto part = [&](double rate, double roll_rate, const Vector3& aside) {
    Vector6 twist;
    const Vector3 omega = roll_rate * s;
    twist.head<3>() = rate * s + aside - omega.cross(Vector3(shaft.p_BTip - shaft.p_BF));
    twist.tail<3>() = omega;
    return twist;
  };
  const Vector3 behind = X_BR * setpoint.p_RTip() - shaft.p_BTip;
  TwistParts twist;
  twist.feedback = part(gains.tip * s.dot(behind), gains.roll * (setpoint.roll() - at.roll),
                        Vector3(v_BRcm - s * s.dot(v_BRcm) + gains.rcm * shaft.e));
  twist.path = part(s.dot(mean_velocity(setpoint, next, X_BR, dt)), 0, Vector3::Zero());
  return twist;
}

TwistParts paper_twist(const ArmState& arm, const Setpoint& setpoint, const Setpoint& next,
                       const Pose& X_BR, const Limits& limits, double dt) {
  const InstrumentState& at = arm.measured();
  const Vector3 p_ee = at.X_BF.translation();
  const Vector3 v_B = mean_velocity(setpoint, next, X_BR, dt);
  const double roll_rate = (next.roll() - setpoint.roll()) / dt;
  TwistParts twist;
  if (next.space() == Space::kCartesian) {
    twist.path = paper_cartesian_twist(p_ee, at.shaft.p_BTip, at.p_BRcm, v_B, roll_rate);
    return twist;
  }
  // The printed law takes omega about base x and y and drops the third component, whatever the
  // trocar's attitude. It therefore gets the profile's pivot rate in base axes.
  const Vector3 p_R = setpoint.p_RTip();
  const double depth = std::max(p_R.norm(), limits.depth_min);
  const Vector3 s_B = X_BR.linear() * p_R / depth;
  const Vector3 omega = s_B.cross(v_B) / depth;
  twist.path =
      paper_spherical_twist(p_ee, at.p_BRcm, omega.x(), omega.y(), roll_rate, s_B.dot(v_B));
  return twist;
}

}  // namespace surg
