#include "surg_core/kinematics/wrist.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kFreeRoll = 1e-6;  // sine from yaw axis to the trocar: below, the roll is free
constexpr double kDamping = 2e-4;   // [m] of the inverse rates: at most 2500 rad per metre

Matrix3 about_y(double angle) {
  return Eigen::AngleAxisd(angle, Vector3::UnitY()).toRotationMatrix();
}

Matrix3 about_x(double angle) {
  return Eigen::AngleAxisd(angle, Vector3::UnitX()).toRotationMatrix();
}

Matrix3 about_z(double angle) {
  return Eigen::AngleAxisd(angle, Vector3::UnitZ()).toRotationMatrix();
}

/// The yaw axis, which the yaw does not turn.
Vector3 yaw_axis(const WristGeometry& wrist, const Matrix3& R_Tip) {
  return R_Tip * Vector3(std::cos(wrist.turn), std::sin(wrist.turn), 0);
}

/// One branch: u is the direction of the link from the pitch axis to the yaw axis.
WristPose with_link_along(const Vector3& u, const WristGeometry& wrist, const TipFrame& tip) {
  const Vector3 a = yaw_axis(wrist, tip.R), y = u.cross(a), z = tip.R.col(2);
  WristPose pose;
  pose.centre.p = tip.p - wrist.yaw_to_tip * z - wrist.pitch_to_yaw * u;
  const Vector3 s = pose.centre.p.normalized();
  const double pitch = std::atan2(-s.dot(a), s.dot(u));
  pose.joints = {pitch, std::atan2(-z.dot(y), z.dot(u))};
  Matrix3 R_pitched;
  R_pitched << a, y, u;
  pose.centre.R = R_pitched * about_y(-pitch) * about_z(-wrist.turn);
  return pose;
}

}  // namespace

TipFrame tip_of_wrist(const WristGeometry& wrist, const WristPose& pose) {
  const Matrix3 R_pitched = pose.centre.R * about_z(wrist.turn) * about_y(pose.joints[0]);
  TipFrame tip;
  tip.R = R_pitched * about_x(pose.joints[1]) * about_z(-wrist.turn);
  tip.p = pose.centre.p + wrist.pitch_to_yaw * R_pitched.col(2) + wrist.yaw_to_tip * tip.R.col(2);
  return tip;
}

std::optional<std::array<WristPose, 2>> wrists_of_tip(const WristGeometry& wrist,
                                                      const TipFrame& tip) {
  // Shaft, link and yaw axis lie in one plane, across the pitch axis, and the trocar is in it.
  const Vector3 a = yaw_axis(wrist, tip.R);
  const Vector3 p_yaw = tip.p - wrist.yaw_to_tip * tip.R.col(2);
  const Vector3 across = p_yaw - a * a.dot(p_yaw);
  const double length = across.norm();
  if (!(length > kFreeRoll * p_yaw.norm())) return std::nullopt;
  const Vector3 u = across / length;
  return std::array{with_link_along(u, wrist, tip), with_link_along(-u, wrist, tip)};
}

FrameRate tip_rate(const WristGeometry& wrist, const WristPose& pose, const FrameRate& centre,
                   const WristJoints& rates) {
  const TipFrame tip = tip_of_wrist(wrist, pose);
  const Vector3 pitch_axis =
      pose.centre.R * Vector3(-std::sin(wrist.turn), std::cos(wrist.turn), 0);
  const Vector3 from_yaw = wrist.yaw_to_tip * tip.R.col(2), lever = tip.p - pose.centre.p;
  const Vector3 pitched = centre.omega + rates[0] * pitch_axis,
                yawed = rates[1] * yaw_axis(wrist, tip.R);
  return {centre.v + pitched.cross(lever) + yawed.cross(from_yaw), pitched + yawed};
}

WristRate wrist_rates(const WristGeometry& wrist, const WristPose& pose, const FrameRate& tip) {
  // Columns: x, y, z of the centre, roll, pitch, yaw.
  const double depth = std::max(pose.centre.p.norm(), wrist.length());
  const Vector3 s = pose.centre.R.col(2);
  Eigen::Matrix<double, 6, 6> J;
  for (int i = 0; i < 6; ++i) {
    FrameRate centre;
    WristJoints joints = WristJoints::Zero();
    if (i < 3) {
      centre.v[i] = 1;
      centre.omega = s.cross(Vector3::Unit(i)) / depth;
    } else if (i == 3) {
      centre.omega = s;
    } else {
      joints[i - 4] = 1;
    }
    const FrameRate column = tip_rate(wrist, pose, centre, joints);
    J.col(i) << column.v, wrist.length() * column.omega;
  }
  Vector6 wanted;
  wanted << tip.v, wrist.length() * tip.omega;
  const Eigen::Matrix<double, 6, 6> damped =
      J * J.transpose() + kDamping * kDamping * Eigen::Matrix<double, 6, 6>::Identity();
  const Vector6 x = J.transpose() * damped.partialPivLu().solve(wanted);
  return {x.head<3>(), x[3], x.tail<2>()};
}

}  // namespace surg
