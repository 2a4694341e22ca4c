// One arm at its trocar and the motion that every law of a table is asked for.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "next_joints.hpp"
#include "surg_core/law/exact.hpp"
#include "test_arm.hpp"

namespace surg::test {

constexpr double kT = 0.002;      // [s] control period
constexpr double kPeriod = 20.0;  // [s] after which the Lissajous figure repeats
constexpr double kDegrees = 180 / M_PI;

/// 300 mm of shaft along the flange's axis, or 60 mm aside and tilted by 10 degrees.
inline Tool straight_tool() { return {Vector3::UnitZ(), Vector3(0, 0, 0.3)}; }
inline Tool tilted_tool() {
  const double tilt = 10 / kDegrees;
  const Vector3 s(std::sin(tilt), 0, std::cos(tilt));
  return {s, Vector3(0.06, 0, 0) + 0.3 * s};
}

/// An arm at home, 120 mm of its shaft behind the trocar.
struct Scene {
  Scene(bool panda, bool tilted)
      : name(panda ? "Panda" : "UR5e"),
        tool_name(tilted ? "60 mm, 10°" : "0"),
        chain(panda ? panda_chain() : ur5e_chain()),
        q_home(panda ? panda_home() : ur5e_home()),
        velocity(panda ? panda_velocity() : JointVector::Constant(6, 3.1416)),
        acceleration(panda ? panda_acceleration() : JointVector::Constant(6, 40)),
        tool(tilted ? tilted_tool() : straight_tool()) {
    const Pose X_BF = chain.forward(q_home);
    home = home_of(X_BF, tool);
    X_BR = rcm_frame(home.s_B, X_BF * tool.p_FTip - 0.12 * home.s_B);
  }
  const Vector3 p_BRcm() const { return X_BR.translation(); }
  ShaftState shaft(const JointVector& q) const {
    return shaft_state(chain.forward(q), tool, p_BRcm());
  }
  /// The joints for a goal some milliradians from q; posture [rad]: wish for the null space.
  JointVector next(const JointVector& q, const ShaftGoal& goal, const JointVector& posture) const {
    return next_joints(chain, q, pose_on_pivot(home, tool, goal), posture);
  }
  JointVector next(const JointVector& q, const ShaftGoal& goal) const {
    return next(q, goal, JointVector::Zero(q.size()));
  }
  RcmRows pivot(const JointVector& q, const Vector3& p_B) const {
    const auto [X_BF, J] = chain.flange(q);
    return rcm_rows(J, shaft_state(X_BF, tool, p_B));
  }
  /// Absolute roll, within half a turn.
  double roll(const JointVector& q) const {
    const Matrix3 R = chain.forward(q).linear();
    return absolute_roll(R, home.R_BF, home.s_B, R * tool.s_F);
  }

  std::string name, tool_name;
  Chain chain;
  JointVector q_home, velocity, acceleration;
  Tool tool;
  Home home;
  Pose X_BR;
};

/// Tip in the trocar frame: +-35, +-35, +-25 mm at 0.2, 0.15, 0.1 Hz round 120 mm depth.
inline Vector3 lissajous(double t) {
  const double w = 2 * M_PI * t;
  return {0.035 * std::sin(0.2 * w), 0.035 * std::sin(0.15 * w), 0.12 + 0.025 * std::sin(0.1 * w)};
}
inline Vector3 lissajous_rate(double t) {
  const double w = 2 * M_PI * t, u = 2 * M_PI;
  return {0.035 * 0.2 * u * std::cos(0.2 * w), 0.035 * 0.15 * u * std::cos(0.15 * w),
          0.025 * 0.1 * u * std::cos(0.1 * w)};
}

/// Mean, root mean square and largest of a series.
struct Series {
  long n = 0;
  double sum = 0, squares = 0, largest = 0;
  void add(double value) {
    ++n;
    sum += value;
    squares += value * value;
    largest = std::max(largest, std::abs(value));
  }
  double mean() const { return n > 0 ? sum / n : 0; }
  double rms() const { return n > 0 ? std::sqrt(squares / n) : 0; }
};

}  // namespace surg::test
