// Messages to values and back. Decoding checks the form (frame, sizes, unit quaternion) and nothing
// else: values, NaN included, are the controller's to judge.
#pragma once

#include <crtk_msgs/StringStamped.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <sensor_msgs/JointState.h>
#include <surg_msgs/Cycle.h>

#include <string>

#include "surg_control/command_item.hpp"
#include "surg_control/source_table.hpp"

namespace surg_control {

/// A decoded message: the item, or why it is refused, and what of it is ignored.
struct Decoded {
  CommandItem item;
  surg::Reason reason = surg::Reason::kNone;  ///< kNone: pass it on
  std::string detail;   ///< with a reason: the values at fault and what is allowed
  std::string ignored;  ///< the part that a 4-DoF instrument cannot follow; said once
};

/// servo_cp, interpolate_cp, move_cp in the rcm frame 'frame' (an empty frame_id means it too).
Decoded decode_pose(const geometry_msgs::PoseStamped& message, surg::Motion motion,
                    const std::string& frame);
/// servo_jp (position) or servo_jv (velocity): yaw, pitch, insertion, roll.
Decoded decode_joints(const sensor_msgs::JointState& message, surg::Motion motion);
/// servo_cv in the rcm frame.
Decoded decode_twist(const geometry_msgs::TwistStamped& message, const std::string& frame);
/// jaw/servo_jp: one position.
Decoded decode_jaw(const sensor_msgs::JointState& message);
/// hold.
Decoded decode_hold();
/// state_command.
Decoded decode_state(const crtk_msgs::StringStamped& message);
/// rcm/set_cp in the base frame 'frame': the position is the trocar point.
Decoded decode_rcm(const geometry_msgs::PoseStamped& message, const std::string& frame);

/// robot/measured_js into 'link'. Returns an empty text, or why the message is unusable. NaN
/// passes.
std::string decode_state_of_robot(const sensor_msgs::JointState& message,
                                  const std::vector<std::string>& names, LinkState& link);

ros::Time to_time(std::uint64_t ns);
geometry_msgs::Point to_point(const surg::Vector3& p);
geometry_msgs::Vector3 to_vector(const surg::Vector3& v);
geometry_msgs::Quaternion to_quaternion(const Eigen::Quaterniond& q);
geometry_msgs::Pose to_pose(const surg::Vector3& p, const Eigen::Quaterniond& q);

/// The whole cycle. 'message' keeps its capacity from tick to tick.
void encode_cycle(const CycleRecord& record, const std::string& frame, const SourceTable& sources,
                  surg_msgs::Cycle& message);

/// CRTK's name of a motion command, for texts.
const char* topic_of(surg::Motion motion);
/// CRTK's word of a state command, for texts.
const char* word_of(surg::StateCommand command);

}  // namespace surg_control
