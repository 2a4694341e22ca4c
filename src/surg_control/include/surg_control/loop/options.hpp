// The node's parameters: read once at start, checked, frozen.
#pragma once

#include <ros/ros.h>

#include <optional>
#include <string>
#include <vector>

#include "surg_core/controller.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// What a person may choose at start.
struct Options {
  std::string cell;                       ///< ~cell: cell folder or cell.yaml
  std::string arm;                        ///< ~arm: CRTK name; empty: the cell's only arm
  bool lockstep = true;                   ///< ~mode: lockstep (default) or freerun
  std::vector<std::string> participants;  ///< ~participants: commanders to wait for, lock-step only
  /// ~others: arms of the cell that run beside this one, to keep clear of; absent: all of them.
  std::optional<std::vector<std::string>> others;
  surg::Law law = surg::Law::kExact;  ///< ~law: ours, velocity or paper; twist links: velocity
  std::string link;                   ///< ~link: joint or twist; empty: as the robot's YAML says
  double feedback_gain = -1;          ///< ~feedback_gain [1/s]; negative: as the robot's YAML says
  std::string black_box;   ///< ~black_box: folder for black boxes; default: ROS's log folder
  bool track_rcm = false;  ///< ~track_rcm: the trocar moves; somebody publishes rcm/track
  bool realtime = false;   ///< ~realtime: lock memory; warn if that or SCHED_FIFO is refused
};

/// Reads the private parameters. Throws surg::ConfigError for an unknown name or a wrong value.
Options read_options(const ros::NodeHandle& private_node);

/// Refuses what only a simulator may do (~law paper, ~feedback_gain). Throws surg::ConfigError.
void check_for_arm(const Options& options, const surg::ArmSetup& setup);

/// Whether the arm is commanded by flange twists (robot/servo_cv) instead of joint velocities.
bool commands_twist(const Options& options, const surg::ArmSetup& setup);

}  // namespace surg_control
