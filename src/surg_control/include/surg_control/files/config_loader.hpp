// Loads everything that one arm needs from a cell folder. yaml-cpp parses, surg_core's schema
// validates; an invalid file causes a surg::ConfigError with file, line, key and allowed values.
#pragma once

#include <cstddef>
#include <string>

#include "surg_core/config.hpp"
#include "surg_core/types.hpp"

namespace surg_control {

/// One arm of a cell with all its files read, checked and frozen. Paths are resolved.
struct ArmSetup {
  std::string cell_name;
  std::string cell_file;
  std::size_t arms_in_cell = 1;
  surg::CellArm arm;
  surg::RobotConfig robot;
  surg::InstrumentConfig instrument;
  surg::ToolCalibration tool;
  surg::TrocarCalibration trocar;
  surg::Limits limits;                       ///< the robot's, tightened by the cell
  surg::Pose X_WB = surg::Pose::Identity();  ///< robot base in the world
  std::string robot_urdf;
  std::string instrument_urdf;
};

/// Flattens one YAML file: nested keys joined by '.', each with its 1-based line. Scalars follow
/// the core schema of YAML 1.2. Throws surg::ConfigError for a missing, oversized or broken file, a
/// duplicate key, a key with a dot in it, an empty value or a sequence of anything but numbers or
/// strings.
surg::Document load_document(const std::string& path);

/// Reads the arm 'arm_name' of a cell (its folder or its cell.yaml); an empty name means the only
/// arm. Throws surg::ConfigError.
ArmSetup load_arm(const std::string& cell, const std::string& arm_name);

}  // namespace surg_control
