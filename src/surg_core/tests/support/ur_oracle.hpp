// Inverse kinematics of the UR5e in closed form, written for the tests from the geometry of the
// arm: all eight branches. It shares nothing with the code under test and decides what is
// reachable.
#pragma once

#include <array>
#include <cmath>
#include <optional>

#include "surg_core/types.hpp"

namespace surg::test {

/// Which of the eight branches: shoulder left or right, elbow up or down, wrist flipped or not.
struct UrBranch {
  int shoulder = 1, elbow = 1, wrist = 1;
  bool operator==(const UrBranch& other) const {
    return shoulder == other.shoulder && elbow == other.elbow && wrist == other.wrist;
  }
};

/// Distances from the three singularities, dimensionless, with the branch as their signs.
struct UrMeasures {
  double shoulder, elbow, wrist;
  UrBranch branch() const {
    return {shoulder > 0 ? 1 : -1, elbow > 0 ? 1 : -1, wrist > 0 ? 1 : -1};
  }
  double closest() const {
    return std::min({std::abs(shoulder), std::abs(elbow), std::abs(wrist)});
  }
};

struct UrGeometry {
  double d1 = 0.1625, a2 = -0.425, a3 = -0.3922, d4 = 0.1333, d5 = 0.0997, d6 = 0.0996;

  UrMeasures measures(const JointVector& q) const {
    // Wrist centre in the plane of the arm, measured from axis 1.
    const double reach =
        a2 * std::cos(q[1]) + a3 * std::cos(q[1] + q[2]) + d5 * std::sin(q[1] + q[2] + q[3]);
    return {reach / std::hypot(reach, d4), std::sin(q[2]), std::sin(q[4])};
  }

  /// The joints of a flange pose in one branch, angles in (-pi, pi]; nothing where there are none.
  std::optional<JointVector> solve(const Pose& X, const UrBranch& branch) const {
    const Vector3 p = X.translation();
    const Matrix3 R = X.linear();
    const Vector3 wrist = p - d6 * R.col(2);
    const double rho = std::hypot(wrist.x(), wrist.y());
    if (rho < d4) return std::nullopt;  // the wrist centre cannot come closer to axis 1
    // In the base the wrist centre is reach (c1, s1) + d4 (s1, -c1).
    const double reach = branch.shoulder * std::sqrt(rho * rho - d4 * d4);
    const double q1 = std::atan2(wrist.y(), wrist.x()) + std::atan2(d4, reach);
    const double s1 = std::sin(q1), c1 = std::cos(q1);
    const double c5 = (p.x() * s1 - p.y() * c1 - d4) / d6;
    if (std::abs(c5) > 1) return std::nullopt;
    const double s5 = branch.wrist * std::sqrt(1 - c5 * c5);
    const double q5 = std::atan2(s5, c5);
    // Axis 2 of the base seen from the flange: (-s5 c6, s5 s6, c5) up to sign.
    const Vector3 side(s1, -c1, 0);
    const Vector3 in_F = R.transpose() * side;
    const double q6 = std::atan2(-in_F.y() / s5, in_F.x() / s5);
    // What is left turns in the plane of the arm.
    const auto rz = [](double a) {
      return Matrix3(Eigen::AngleAxisd(a, Vector3::UnitZ()).toRotationMatrix());
    };
    const auto rx = [](double a) {
      return Matrix3(Eigen::AngleAxisd(a, Vector3::UnitX()).toRotationMatrix());
    };
    const Matrix3 R_04 = R * (rz(q5) * rx(-M_PI_2) * rz(q6)).transpose();
    // R_04 = Rz(q1) Rx(90) Rz(q2 + q3 + q4) Rx(90)
    const Matrix3 planar = (rz(q1) * rx(M_PI_2)).transpose() * R_04 * rx(M_PI_2).transpose();
    const double q234 = std::atan2(planar(1, 0), planar(0, 0));
    const double x = reach - d5 * std::sin(q234);
    const double z = wrist.z() - d1 + d5 * std::cos(q234);
    const double c3 = (x * x + z * z - a2 * a2 - a3 * a3) / (2 * a2 * a3);
    if (std::abs(c3) > 1) return std::nullopt;
    const double s3 = branch.elbow * std::sqrt(1 - c3 * c3);
    const double q3 = std::atan2(s3, c3);
    const double q2 = std::atan2(z, x) - std::atan2(a3 * s3, a2 + a3 * c3);
    JointVector q(6);
    q << q1, q2, q3, q234 - q2 - q3, q5, q6;
    for (int i = 0; i < 6; ++i) q[i] = std::remainder(q[i], 2 * M_PI);
    return q;
  }
};

}  // namespace surg::test
