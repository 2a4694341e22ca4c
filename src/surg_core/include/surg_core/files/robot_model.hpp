// A robot's kinematic chain from its YAML and its URDF.
#pragma once

#include <string>
#include <vector>

#include "surg_core/files/urdf.hpp"

namespace surg {

/// A robot's model as loaded.
struct Model {
  Chain chain;                    ///< base_link to flange_link
  std::vector<UrdfJoint> joints;  ///< of the drawing, from base_link to flange_link
  std::string urdf;               ///< text of the URDF, for robot_description
  /// The URDF's root link and where it is in B, for whoever draws the URDF's own links; empty where
  /// a movable joint lies between them, or where the root is called 'world', which has a meaning.
  std::string root_link;
  Pose X_BRoot = Pose::Identity();
};

/// The URDF that a robot's YAML names, resolved.
std::string urdf_of(const RobotConfig& robot);

/// Loads the URDF of a robot and checks it: the turning joints between base and flange are exactly
/// robot.joint_names in that order, and the YAML's limits are not looser than the URDF's. Throws
/// ConfigError.
Model load_model(const RobotConfig& robot);

}  // namespace surg
