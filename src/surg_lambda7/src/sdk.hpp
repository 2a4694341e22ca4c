// The vendor's library for Force Dimension devices, loaded at run time, so that the build needs
// nothing of it. Only the functions that a leader needs are declared, by their documentation.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace surg_teleop {

/// A device of the library; every function takes one. -1 is the one opened last.
using DeviceId = signed char;

/// Return of a reading that is not new, because it follows the last one too soon.
constexpr int kTimeGuard = 1;

/// A function that returns an int returns a negative one on failure.
struct Sdk {
  int (*open)();                     // drdOpen: the first device that is free; its id
  int (*open_id)(DeviceId);          // drdOpenID: by its number from 0; its id
  int (*close)(DeviceId);            // drdClose
  int (*stop)(bool, DeviceId);       // drdStop: ends the motion of auto_init; true: forces stay on
  bool (*is_initialized)(DeviceId);  // drdIsInitialized
  int (*auto_init)(DeviceId);        // drdAutoInit: drives the handle to its reference by itself
  bool (*has_wrist)(DeviceId);       // dhdHasWrist
  bool (*has_gripper)(DeviceId);     // dhdHasGripper
  bool (*is_left_handed)(DeviceId);  // dhdIsLeftHanded
  int (*set_gravity_compensation)(int, DeviceId);  // dhdSetGravityCompensation: 1 on
  int (*set_max_force)(double, DeviceId);          // dhdSetMaxForce [N]
  int (*enable_force)(unsigned char, DeviceId);    // dhdEnableForce: 1 on
  /// dhdGetPositionAndOrientationFrame: position [m], orientation row by row.
  int (*get_pose)(double*, double*, double*, double (*)[3], DeviceId);
  int (*get_gripper_angle)(double*, DeviceId);  // dhdGetGripperAngleRad
  unsigned int (*get_buttons)(DeviceId);        // dhdGetButtonMask: one bit per button
  /// dhdSetForceAndTorqueAndGripperForce: force [N], torque [Nm], gripper [N].
  int (*set_force)(double, double, double, double, double, double, double, DeviceId);
  const char* (*last_error)();           // dhdErrorGetLastStr
  const char* (*system_name)(DeviceId);  // dhdGetSystemName
};

struct Loaded {
  std::optional<Sdk> sdk;
  /// The file.
  std::string path;
  /// One line per place that failed, with the reason.
  std::vector<std::string> tried;
};

/// Files that may be the library, in the order in which they are tried: $FORCEDIM_LIBRARY, then in
/// $FDSDK/lib/release/lin-x86_64-gcc, ~/.local/lib and /usr/local/lib, then what the loader finds.
std::vector<std::string> places();

/// Loads the library from the first place that has it with all functions; it stays loaded.
Loaded load(const std::vector<std::string>& places);

}  // namespace surg_teleop
