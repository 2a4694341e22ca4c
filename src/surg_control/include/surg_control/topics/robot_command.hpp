// Publishes the commands for robot link and tool link once a cycle.
#pragma once

#include <geometry_msgs/TwistStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// Publishes robot/servo_jv or robot/servo_cv, and tool/servo_jp; in free-run an instrument without
/// a jaw gets every fifth cycle only. Reuses its messages, so that a cycle does not allocate.
class RobotCommand {
 public:
  /// 'twist': flange twists instead of joint velocities; 'lockstep': every tick is answered, and
  /// queues have no end.
  RobotCommand(ros::NodeHandle& node, const surg::ArmSetup& setup, bool twist, bool lockstep);

  /// One thread at a time. Sends nothing before there was a joint state.
  void send(const LinkCommand& command);

 private:
  bool twist_;
  bool lockstep_;
  surg::InstrumentConfig at_start_;
  ros::Publisher robot_, tool_;
  sensor_msgs::JointState joint_command_, tool_command_;
  geometry_msgs::TwistStamped twist_command_;
};

}  // namespace surg_control
