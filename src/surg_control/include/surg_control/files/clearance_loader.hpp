// What an arm keeps clear of: the cell's obstacles, and the other arms with their own files.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "surg_core/files/arm_setup.hpp"
#include "surg_core/limits/clearance.hpp"

namespace surg_control {

/// The clearance setup of an arm, and what else the node needs to follow the other arms.
struct ClearanceFiles {
  surg::ClearanceSetup setup;
  std::vector<std::vector<std::string>> joint_names;  ///< of setup.others
  std::string missing;  ///< why there is no guard although there are other arms; for people
};

/// Loads the shapes of 'setup' and of the arms 'others' (none: all other arms of the cell). Without
/// a clearance section, a robot without capsules means no guard. Throws surg::ConfigError.
ClearanceFiles load_clearance(const surg::ArmSetup& setup,
                              const std::optional<std::vector<std::string>>& others);

}  // namespace surg_control
