#include "surg_control/topics/virtual_kinematics.hpp"

#include <cmath>

#include "surg_core/law/rcm.hpp"

namespace surg_control {
namespace {

constexpr double kNoDirection =
    1e-6;  // [m] nearer to the trocar point there is no shaft to speak of

}  // namespace

ToolPose forward_kinematics(const surg::Vector4& joints) {
  const surg::Vector3 s = surg::shaft_direction(joints[0], joints[1]);
  const surg::Matrix3 swing = surg::minimal_rotation(surg::Vector3::UnitZ(), s);
  return {joints[2] * s, Eigen::Quaterniond(swing) * Eigen::Quaterniond(Eigen::AngleAxisd(
                                                         joints[3], surg::Vector3::UnitZ()))};
}

surg::Vector4 inverse_kinematics(const ToolPose& X_RTool, double roll_near) {
  const double depth = X_RTool.p.norm();
  const surg::Vector3 s = X_RTool.p / depth;
  const Eigen::Vector2d angles = surg::shaft_angles(s);
  const surg::Matrix3 swing = surg::minimal_rotation(surg::Vector3::UnitZ(), s);
  const Eigen::Quaterniond rest = Eigen::Quaterniond(swing).conjugate() * X_RTool.q;
  const double roll = 2 * std::atan2(rest.z(), rest.w());
  return {angles[0], angles[1], depth, roll_near + std::remainder(roll - roll_near, 2 * M_PI)};
}

double ignored_tilt(const ToolPose& X_RTool) {
  const double depth = X_RTool.p.norm();
  if (!(depth > kNoDirection) || !std::isfinite(depth)) return 0;
  const surg::Vector3 z = X_RTool.q * surg::Vector3::UnitZ();
  return std::atan2(z.cross(X_RTool.p).norm(), z.dot(X_RTool.p));
}

}  // namespace surg_control
