#include "surg_core/kinematics/ur_kinematics.hpp"

#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>
#include <vector>

namespace surg {
namespace {

constexpr int kJoints = 6;  // joints of a UR
// Published calibrations move a flange by a few millimetres.
constexpr double kFarthest = 0.02;   // [m] of an axis or the flange from the drawing
constexpr double kMostTilt = 0.035;  // [rad] of an axis or the flange from the drawing

/// Frames 0 to 6 at q = 0, in B. ROS turns UR's own base by 180 degrees about z.
std::array<Pose, kJoints + 1> frames_at_zero(const UrKinematics& own) {
  std::array<Pose, kJoints + 1> frames;
  frames[0] = Pose(Eigen::AngleAxisd(M_PI, Vector3::UnitZ()));
  for (int i = 0; i < kJoints; ++i) {
    frames[i + 1] = frames[i] * Eigen::AngleAxisd(own.theta[i], Vector3::UnitZ()) *
                    Eigen::Translation3d(own.a[i], 0, own.d[i]) *
                    Eigen::AngleAxisd(own.alpha[i], Vector3::UnitX());
  }
  return frames;
}

void check_near(const std::string& what, double distance, double angle) {
  if (distance <= kFarthest && angle <= kMostTilt) return;
  throw std::invalid_argument(what + " is " + std::to_string(1e3 * distance) + " mm and " +
                              std::to_string(angle) +
                              " rad from the drawing's; allowed are 20 mm and 0.035 rad: these "
                              "are the kinematics of another model");
}

}  // namespace

Chain with_kinematics(const Chain& drawn, const UrKinematics& own) {
  if (drawn.dof() != kJoints) {
    throw std::invalid_argument("six joints are needed; the chain has " +
                                std::to_string(drawn.dof()));
  }
  const std::array<Pose, kJoints + 1> frames = frames_at_zero(own);
  std::vector<Joint> joints;
  Pose X_BDrawn = Pose::Identity(), X_BParent = Pose::Identity();
  for (int i = 0; i < kJoints; ++i) {
    const Joint& joint = drawn.joints()[i];
    X_BDrawn = X_BDrawn * joint.X_PJ;
    const Vector3 p_BAxis = frames[i].translation(), axis_B = frames[i].linear().col(2);
    const Eigen::Quaterniond tilt =
        Eigen::Quaterniond::FromTwoVectors(X_BDrawn.linear() * joint.axis, axis_B);
    const Vector3 origin_B = p_BAxis + axis_B * axis_B.dot(X_BDrawn.translation() - p_BAxis);
    check_near("the axis of " + joint.name, (origin_B - X_BDrawn.translation()).norm(),
               Eigen::AngleAxisd(tilt).angle());
    Pose X_BJ = Pose::Identity();
    X_BJ.linear() = tilt.toRotationMatrix() * X_BDrawn.linear();
    X_BJ.translation() = origin_B;
    joints.push_back({joint.name, X_BParent.inverse() * X_BJ, joint.axis, joint.continuous});
    X_BParent = X_BJ;
  }
  const Pose X_BFDrawn = X_BDrawn * drawn.X_LF();
  const Pose& X_BF = frames[kJoints];
  check_near("the flange", (X_BF.translation() - X_BFDrawn.translation()).norm(),
             Eigen::AngleAxisd(X_BFDrawn.linear().transpose() * X_BF.linear()).angle());
  return Chain(std::move(joints), X_BParent.inverse() * X_BF);
}

}  // namespace surg
