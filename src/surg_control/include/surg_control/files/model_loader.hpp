// Builds the kinematic chain from a URDF. urdfdom parses, our own code builds the chain, and KDL
// verifies it independently.
#pragma once

#include <string>

#include "surg_control/files/config_loader.hpp"
#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"

namespace surg_control {

/// A robot's model as loaded.
struct Model {
  surg::Chain chain;  ///< base_link to flange_link
  std::string urdf;   ///< text of the URDF, for robot_description
  double kdl_error;   ///< largest difference to KDL over the checked postures [m, rad]
  /// The URDF's root link and where it is in B, for whoever draws the URDF's own links; empty where
  /// a movable joint lies between them, or where the root is called 'world', which has a meaning.
  std::string root_link;
  surg::Pose X_BRoot = surg::Pose::Identity();
};

/// Loads the URDF of a robot and checks it: the movable joints between base and flange are exactly
/// robot.joint_names in that order, revolute or continuous; the YAML's limits are not looser than
/// the URDF's; forward kinematics and Jacobian agree with KDL to 1e-9 on 100 random postures.
/// Throws surg::ConfigError.
Model load_model(const surg::RobotConfig& robot, const std::string& urdf_path);

/// The model of a cell's arm: the same, with the arm's own kinematics in the chain where the cell
/// has them.
Model load_model(const ArmSetup& setup);

/// Largest difference between 'chain' and KDL's chain of the same URDF text: pose entries and
/// Jacobian entries, over 'postures' seeded random postures within the robot's limits. Throws
/// surg::ConfigError when KDL cannot build the chain.
double difference_to_kdl(const surg::Chain& chain, const surg::RobotConfig& robot,
                         const std::string& urdf_text, int postures);

}  // namespace surg_control
