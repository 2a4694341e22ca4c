#include "surg_control/topics/robot_command.hpp"

#include <cmath>
#include <string>

#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

constexpr std::uint64_t kJawlessCycles = 5;  // 100 Hz: nothing moves, but its link hears of us

}  // namespace

RobotCommand::RobotCommand(ros::NodeHandle& node, const surg::ArmSetup& setup, bool twist,
                           bool lockstep)
    : twist_(twist), lockstep_(lockstep), at_start_(setup.mounted.instrument) {
  const std::uint32_t queue = lockstep ? 0 : 1;
  const std::string prefix = "/" + setup.arm.name + "/";
  robot_ = twist ? node.advertise<geometry_msgs::TwistStamped>(prefix + "robot/servo_cv", queue)
                 : node.advertise<sensor_msgs::JointState>(prefix + "robot/servo_jv", queue);
  tool_ = node.advertise<sensor_msgs::JointState>(prefix + "tool/servo_jp", queue);
  joint_command_.name = setup.robot.joint_names;
  twist_command_.header.frame_id = setup.arm.name + "_base";
  const std::optional<surg::WristConfig>& wrist = setup.mounted.instrument.wrist;
  tool_command_.name =
      wrist ? std::vector<std::string>{"pitch", "yaw", "jaw"} : std::vector<std::string>{"jaw"};
  if (wrist && wrist->rolls()) tool_command_.name.push_back("roll");
}

void RobotCommand::send(const LinkCommand& command) {
  if (command.stamp_ns == 0) return;
  const ros::Time stamp = to_time(command.stamp_ns);
  if (twist_) {
    const surg::Vector6& twist = command.twist;
    twist_command_.header.stamp = stamp;
    twist_command_.twist.linear = to_vector(twist.head<3>());
    twist_command_.twist.angular = to_vector(twist.tail<3>());
    robot_.publish(twist_command_);
  } else {
    const surg::JointVector& qd = command.qd;
    joint_command_.header.stamp = stamp;
    joint_command_.velocity.assign(qd.data(), qd.data() + qd.size());
    robot_.publish(joint_command_);
  }
  const surg::InstrumentConfig& mounted = command.tool ? command.tool->instrument : at_start_;
  const bool every_cycle = lockstep_ || mounted.jaw_min < mounted.jaw_max || mounted.wrist;
  if (!every_cycle && command.tick % kJawlessCycles != 0) return;
  if (!std::isfinite(command.jaw)) return;  // F31: an unknown jaw is not told to move
  tool_command_.header.stamp = stamp;
  tool_command_.position.assign(1, command.jaw);
  if (mounted.wrist) {
    if (!command.wrist.allFinite()) return;
    tool_command_.position = {command.wrist[0], command.wrist[1], command.jaw};
    if (mounted.wrist->rolls()) tool_command_.position.push_back(command.wrist[2]);
  }
  tool_.publish(tool_command_);
}

}  // namespace surg_control
