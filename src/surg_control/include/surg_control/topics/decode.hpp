// Converts messages to commands. Decoding checks the form only (sizes, names, unit quaternion,
// fixed frames); the controller judges the values, NaN included.
#pragma once

#include <crtk_msgs/StringStamped.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <sensor_msgs/JointState.h>
#include <surg_msgs/Fixture.h>
#include <surg_msgs/PointVelocityStamped.h>

#include <string>
#include <vector>

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// A decoded message: the item, or the reason of refusal.
struct Decoded {
  CommandItem item;
  surg::Reason reason = surg::Reason::kNone;  ///< kNone: pass it on
  std::string detail;  ///< with a reason: the value at fault, what is allowed, what to do
};

/// servo_cp, interpolate_cp, move_cp. The cycle that takes it judges its frame_id.
Decoded decode_pose(const geometry_msgs::PoseStamped& message, surg::Motion motion);
/// servo_cv; frame_id as for poses.
Decoded decode_twist(const geometry_msgs::TwistStamped& message);
/// servo_jp, servo_jr, interpolate_jp, move_jp, move_jr (position) or servo_jv (velocity): yaw,
/// pitch, insertion, roll, and wrist_pitch, wrist_yaw where the instrument has a wrist.
Decoded decode_joints(const sensor_msgs::JointState& message, surg::Motion motion,
                      bool wristed = false);
/// Names of the virtual joints, four or six.
const std::vector<std::string>& joint_names(bool wristed);
/// Names in one line, for texts.
std::string listed(const std::vector<std::string>& names);
/// jaw/servo_jp, jaw/move_jp: one position; elbow/move_jp: one swivel angle.
Decoded decode_angle(const sensor_msgs::JointState& message, surg::Motion motion);
/// hold.
Decoded decode_hold();
/// rcm/insert, rcm/withdraw, rcm/retrace: 'start' means 'motion', 'stop' means hold.
Decoded decode_start_stop(const crtk_msgs::StringStamped& message, surg::Motion motion);
/// authority/claim.
Decoded decode_claim();
/// What becomes of the sender's servo_cp outside the workspace: "slide" or "refuse".
Decoded decode_at_wall(const crtk_msgs::StringStamped& message);
/// state_command.
Decoded decode_state(const crtk_msgs::StringStamped& message);
/// rcm/set_cp in the base frame 'frame': the position is the trocar point.
Decoded decode_rcm(const geometry_msgs::PoseStamped& message, const std::string& frame);
/// fixtures/set in the base frame 'frame'.
Decoded decode_fixture(const surg_msgs::Fixture& message, const std::string& frame);
/// fixtures/remove: a fixture's name.
Decoded decode_fixture_name(const std::string& name);
/// The message that says a fixture.
surg_msgs::Fixture encode_fixture(const surg::Fixture& fixture);
/// rcm/track in the base frame 'frame'.
Decoded decode_track(const surg_msgs::PointVelocityStamped& message, const std::string& frame);
/// set_base_frame: the pose of the rcm frame 'rcm' in the user's frame U, whose name is the
/// frame_id; without one, U is 'rcm' again (identity) or 'user' (any other pose).
Decoded decode_base_frame(const geometry_msgs::PoseStamped& message, const std::string& rcm,
                          const std::string& user);

/// Copies robot/measured_js into 'link' (stamp, q, qd). Returns an empty text, or why the message
/// is unusable. NaN passes.
std::string decode_state_of_robot(const sensor_msgs::JointState& message,
                                  const std::vector<std::string>& names, LinkState& link);

/// Converts a quaternion to a unit rotation. Returns an empty text, or why it is invalid. Values
/// that are not finite pass.
std::string decode_rotation(const geometry_msgs::Quaternion& q, Eigen::Quaterniond& rotation);

/// CRTK's name of a motion command, for texts.
const char* topic_of(surg::Motion motion);
/// CRTK's word of a state command, for texts.
const char* word_of(surg::StateCommand command);

}  // namespace surg_control
