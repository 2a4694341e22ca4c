// KDL's opinion of our kinematics. Both work on the same joints as read, so that it judges
// arithmetic and never a file.
#pragma once

#include <kdl/chain.hpp>
#include <vector>

#include "surg_core/files/robot_model.hpp"

namespace surg_control {

KDL::Chain to_kdl(const std::vector<surg::UrdfJoint>& joints);

/// Largest difference between our chain and KDL's: pose entries and Jacobian entries, over 100
/// seeded random postures within the robot's limits [m, rad]; infinite for another number of
/// joints.
double difference_to_kdl(const surg::Chain& chain, const KDL::Chain& kdl,
                         const surg::RobotConfig& robot);

/// Throws std::runtime_error where a robot's chain differs from KDL's by more than 1e-9 in 100
/// postures: an arm is not driven on a doubtful model.
void check_against_kdl(const surg::RobotConfig& robot);

}  // namespace surg_control
