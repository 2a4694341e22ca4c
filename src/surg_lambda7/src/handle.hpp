// One Force Dimension device from opening to closing, in the order that its library requires. No
// ROS, no clock.
#pragma once

#include <Eigen/Core>
#include <string>

#include "sdk.hpp"

namespace surg_teleop {

/// What the hand holds, in the device's axes: x towards the operator, y to the right, z up.
struct Reading {
  Eigen::Vector3d p_MH;  // [m]
  Eigen::Matrix3d R_MH;
  double gripper = 0.0;      // [rad], 0 closed, growing as it opens on either hand's device
  unsigned int buttons = 0;  // one bit each
};

enum class ReadResult {
  kNew,   // a new reading
  kOld,   // the device had nothing new
  kLost,  // the device failed; every later cycle returns this too
};

class Handle {
 public:
  explicit Handle(const Sdk& sdk) : sdk_(sdk) {}
  /// Switches the forces off and closes the device.
  ~Handle();
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;

  /// Opens a device by its number, or with -1 the first free one. Empty, or why it cannot be used
  /// and the cure.
  std::string open(int number);

  /// Whether the device has found its reference since it was switched on.
  bool initialized() const { return sdk_.is_initialized(id_); }

  /// Lets the device find its reference: the handle moves by itself. Empty, or why it failed.
  std::string initialize();

  /// Gravity compensation, force limit [N], forces on. Empty, or why it failed.
  std::string start(double max_force);

  /// Reads; every cycle commands a force after it.
  ReadResult read(Reading* reading);

  /// Commands a force in the device's axes [N]; zero leaves the handle free. kLost, or `result`.
  ReadResult command(const Eigen::Vector3d& f_M, ReadResult result);

  /// Why the device failed, after kLost.
  const std::string& error() const { return error_; }
  /// The device's own name.
  std::string name() const;
  bool has_gripper() const { return has_gripper_; }

 private:
  ReadResult lose(const std::string& what);
  std::string library_error() const;

  Sdk sdk_;
  DeviceId id_ = -1;
  bool open_ = false;
  bool lost_ = false;
  bool has_gripper_ = false;
  double gripper_sign_ = 1.0;
  std::string error_;
};

}  // namespace surg_teleop
