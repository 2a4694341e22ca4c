// Everything that one arm needs, from a cell's folder.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "surg_core/files/robot_model.hpp"

namespace surg {

/// An instrument with its calibration, read and checked. The two files are relative to the cell's
/// folder.
struct MountedTool {
  std::string instrument_file, calibration_file;
  InstrumentConfig instrument;
  ToolCalibration tool;
  std::string instrument_urdf;  ///< resolved
};

/// One arm of a cell with all its files read and checked. Paths are resolved.
struct ArmSetup {
  std::string cell_name;
  std::string cell_file;
  std::vector<std::string> arms_in_cell;
  CellClearance clearance;
  CellArm arm;
  RobotConfig robot;  ///< with the cell's home posture, and as its link drives it
  LinkConfig link;
  std::string driver;                          ///< folder of the link's driver; empty: none
  std::map<std::string, Value> link_settings;  ///< for that driver
  MountedTool mounted;
  TrocarCalibration trocar;
  Limits limits;                        ///< the robot's, tightened by the cell
  Pose X_WB = Pose::Identity();         ///< robot base in the world, as measured where known
  Pose X_WB_stated = Pose::Identity();  ///< as cell.yaml states it
  std::string robot_urdf;
  Model model;                             ///< with the arm's own kinematics, where known
  std::optional<UrKinematics> kinematics;  ///< the arm's own, where its file is there
};

/// The cell.yaml of a cell: its folder, or the file itself. Absolute.
std::string cell_file_of(const std::string& cell);

/// Reads the arm 'arm_name' of a cell (its folder or its cell.yaml); an empty name means the only
/// arm. Throws ConfigError.
ArmSetup load_arm(const std::string& cell, const std::string& arm_name);

/// Reads another tool for an arm with the checks of a start. 'words': the instrument's YAML and,
/// after a blank, its calibration file; both relative to the cell's folder. Without words: what the
/// cell states. Another instrument than the cell's needs its own calibration file. Throws
/// ConfigError.
MountedTool load_tool(const ArmSetup& setup, const std::string& words);

}  // namespace surg
