// What a cell states of the force sensor between an arm's flange and its tool.
#pragma once

#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// Whether 'force_sensor_<arm>.yaml' beside cell.yaml says that the arm may not move without a
/// known force; false without that file. Throws surg::ConfigError for a value that is no truth
/// value.
bool force_is_required(const surg::ArmSetup& setup);

}  // namespace surg_control
