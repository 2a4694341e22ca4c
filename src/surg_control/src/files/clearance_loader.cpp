#include "surg_control/files/clearance_loader.hpp"

#include <algorithm>

namespace surg_control {
namespace {

surg::ArmShape shape_of(const surg::ArmSetup& arm) {
  return surg::arm_shape(arm.arm.name, arm.model.chain, arm.X_WB, arm.robot, arm.mounted.instrument,
                         arm.mounted.tool);
}

std::vector<std::string> names_of_others(const surg::ArmSetup& setup,
                                         const std::optional<std::vector<std::string>>& chosen) {
  std::vector<std::string> names;
  for (const std::string& name : setup.arms_in_cell) {
    const bool wanted = !chosen || std::count(chosen->begin(), chosen->end(), name) > 0;
    if (name != setup.arm.name && wanted) names.push_back(name);
  }
  for (const std::string& name : chosen.value_or(std::vector<std::string>{})) {
    if (std::count(names.begin(), names.end(), name) > 0) continue;
    throw surg::ConfigError("parameter ~others names '" + name + "', which is no other arm of " +
                            setup.cell_file);
  }
  return names;
}

}  // namespace

ClearanceFiles load_clearance(const surg::ArmSetup& setup,
                              const std::optional<std::vector<std::string>>& others) {
  ClearanceFiles files;
  const std::vector<std::string> names = names_of_others(setup, others);
  if (names.empty() && setup.clearance.obstacles.empty()) return files;
  try {
    files.setup.own = shape_of(setup);
    for (const std::string& name : names) {
      const surg::ArmSetup other = surg::load_arm(setup.cell_file, name);
      files.setup.others.push_back(shape_of(other));
      files.joint_names.push_back(other.robot.joint_names);
    }
  } catch (const surg::ConfigError& error) {
    if (setup.clearance.line > 0) throw;
    return {{}, {}, error.what()};
  }
  files.setup.distance = setup.clearance.distance;
  files.setup.shafts = setup.clearance.shafts;
  files.setup.obstacles = setup.clearance.obstacles;
  return files;
}

}  // namespace surg_control
