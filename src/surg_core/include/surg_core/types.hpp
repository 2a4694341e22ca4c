// Value types shared by the whole core: no ROS, no clock, no threads, no heap in the loop.
//
// Frames are in the names (docs/reference/conventions.md): X_AB is the pose of frame B in frame A,
// p_BTip the tip seen from and expressed in the base B. SI units throughout.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>

namespace surg {

/// Most joints an arm may have. Fixed, so that nothing in the loop allocates.
constexpr int kMaxJoints = 8;

using Vector3 = Eigen::Vector3d;
using Vector4 = Eigen::Vector4d;
using Vector6 = Eigen::Matrix<double, 6, 1>;  ///< flange twist: v [m/s], then omega [rad/s], in B.
using Matrix3 = Eigen::Matrix3d;
using Pose = Eigen::Isometry3d;
/// One number per joint, at most kMaxJoints of them, stored inline.
using JointVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;
/// The same padded with zeros: what is done to all joints at once has a fixed size, no loop and no
/// copy of a length that the compiler does not know. The inner loops use it.
using Joints = Eigen::Matrix<double, kMaxJoints, 1>;
inline Joints padded(const JointVector& v) {
  Joints all = Joints::Zero();
  for (Eigen::Index i = 0; i < v.size(); ++i) all[i] = v[i];
  return all;
}
/// Geometric Jacobian of the flange, 6 x n: rows 0-2 linear (flange origin), rows 3-5 angular, in
/// B.
using Jacobian = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxJoints>;

}  // namespace surg
