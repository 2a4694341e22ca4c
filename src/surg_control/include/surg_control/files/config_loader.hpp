// Loads everything that one arm needs from a cell folder. yaml-cpp parses, surg_core's schema
// validates; an invalid file causes a surg::ConfigError with file, line, key and allowed values.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "surg_core/config.hpp"
#include "surg_core/types.hpp"

namespace surg_control {

/// An instrument with its calibration, read and checked. Paths are relative to the cell's folder.
struct MountedTool {
  std::string instrument_file, calibration_file;
  surg::InstrumentConfig instrument;
  surg::ToolCalibration tool;
  std::string instrument_urdf;  ///< resolved
};

/// One arm of a cell with all its files read, checked and frozen. Paths are resolved.
struct ArmSetup {
  std::string cell_name;
  std::string cell_file;
  std::vector<std::string> arms_in_cell;
  surg::CellClearance clearance;
  surg::CellArm arm;
  surg::RobotConfig robot;
  MountedTool mounted;
  surg::TrocarCalibration trocar;
  surg::Limits limits;                       ///< the robot's, tightened by the cell
  surg::Pose X_WB = surg::Pose::Identity();  ///< robot base in the world, as measured where known
  std::string robot_urdf;
  std::optional<surg::UrKinematics> kinematics;  ///< the arm's own, where its file is there
};

/// Flattens one YAML file: nested keys joined by '.', each with its 1-based line. Scalars follow
/// the core schema of YAML 1.2. Throws surg::ConfigError for a missing, oversized or broken file, a
/// duplicate key, a key with a dot in it, an empty value or a sequence of anything but numbers or
/// strings.
surg::Document load_document(const std::string& path);

/// Reads the arm 'arm_name' of a cell (its folder or its cell.yaml); an empty name means the only
/// arm. Throws surg::ConfigError.
ArmSetup load_arm(const std::string& cell, const std::string& arm_name);

/// Reads another tool for an arm with the checks of a start. 'words': the instrument's YAML and,
/// after a blank, its calibration file; both relative to the cell's folder. Without words: what the
/// cell states. Another instrument than the cell's needs its own calibration file. Throws
/// surg::ConfigError.
MountedTool load_tool(const ArmSetup& setup, const std::string& words);

}  // namespace surg_control
