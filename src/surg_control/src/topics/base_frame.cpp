#include "surg_control/topics/base_frame.hpp"

namespace surg_control {

ToolPose pose_to_rcm(const surg::Pose& X_UR, const ToolPose& X_UTool) {
  const surg::Matrix3 R_RU = X_UR.linear().transpose();
  return {R_RU * (X_UTool.p - X_UR.translation()), Eigen::Quaterniond(R_RU) * X_UTool.q};
}

ToolPose pose_from_rcm(const surg::Pose& X_UR, const ToolPose& X_RTool) {
  return {X_UR * X_RTool.p, Eigen::Quaterniond(X_UR.linear()) * X_RTool.q};
}

ToolTwist twist_to_rcm(const surg::Pose& X_UR, const ToolTwist& in_U) {
  const surg::Matrix3 R_RU = X_UR.linear().transpose();
  return {R_RU * in_U.v, R_RU * in_U.omega};
}

ToolTwist twist_from_rcm(const surg::Pose& X_UR, const ToolTwist& in_R) {
  return {X_UR.linear() * in_R.v, X_UR.linear() * in_R.omega};
}

}  // namespace surg_control
