// What the hand on the device feels: the newest /<name>/servo_cf through HapticFeedback. No ROS;
// the time is the caller's.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <mutex>

#include "haptics.hpp"

namespace surg_teleop {

/// Force on the tip in, force on the handle out. `take` and `step` may come from two threads.
class FeltForce {
 public:
  /// R_VM turns the device's axes M into the view V.
  FeltForce(const HapticLimits& limits, const Eigen::Matrix3d& R_VM)
      : feedback_(limits), R_VM_(R_VM) {}

  /// A force on the tip [N] in the view frame, and whether it may be felt: while the hand is
  /// clutched, or the arm paused, it may not. `now` [s] runs steadily.
  void take(const Eigen::Vector3d& f_V, bool allowed, double now);

  /// The force on the handle until the next step [N], in the device's axes; p_MH [m].
  Eigen::Vector3d step(const Eigen::Vector3d& p_MH, double now);

  /// A cycle without a place of the hand: nothing is felt.
  void skip(double now) { before_ = now; }

 private:
  HapticFeedback feedback_;
  Eigen::Matrix3d R_VM_;
  double before_ = std::numeric_limits<double>::quiet_NaN();  // the last step [s]
  std::mutex mutex_;                                          // of what follows
  Eigen::Vector3d f_V_ = Eigen::Vector3d::Zero();
  bool allowed_ = false;
  double received_ = 0.0;  // [s]
};

}  // namespace surg_teleop
