#include "surg_control/topics/decode.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "surg_core/config_keys.hpp"

namespace surg_control {
namespace {

constexpr double kUnitTolerance = 1e-3;  // of a quaternion's norm

using surg::config::kParts;
using surg::config::kShapes;
using surg::config::kSides;
using surg::config::word_of;
using surg::config::word_to;

// In the order of surg::Motion.
constexpr std::array<const char*, 18> kTopics{
    "nothing", "servo_cp",    "servo_jp",     "servo_cv",     "servo_jv",       "interpolate_cp",
    "move_cp", "hold",        "jaw/servo_jp", "servo_jr",     "interpolate_jp", "move_jp",
    "move_jr", "jaw/move_jp", "rcm/insert",   "rcm/withdraw", "rcm/retrace",    "elbow/move_jp",
};
constexpr std::array<std::pair<const char*, surg::StateCommand>, 6> kStateWords{{
    {"enable", surg::StateCommand::kEnable},
    {"disable", surg::StateCommand::kDisable},
    {"pause", surg::StateCommand::kPause},
    {"resume", surg::StateCommand::kResume},
    {"home", surg::StateCommand::kHome},
    {"unhome", surg::StateCommand::kUnhome},
}};

Decoded refused(surg::Reason reason, std::string detail) {
  Decoded decoded;
  decoded.reason = reason;
  decoded.detail = std::move(detail);
  return decoded;
}

Decoded motion_of(surg::Motion motion) {
  Decoded decoded;
  decoded.item.motion.motion = motion;
  return decoded;
}

/// A text of a message in quotes, short enough to be said.
std::string quoted(const std::string& text) {
  return text.size() <= 40 ? "'" + text + "'" : "'" + text.substr(0, 40) + "…'";
}

/// Empty, or why the frame_id is not the one fixed frame of its topic.
std::string wrong_frame(const std::string& is, const std::string& expected) {
  if (is.empty() || is == expected) return {};
  return "frame_id is " + quoted(is) + "; allowed is '" + expected +
         "' or an empty one; nothing is converted";
}

surg::Vector3 to_eigen(const geometry_msgs::Point& p) { return {p.x, p.y, p.z}; }
surg::Vector3 to_eigen(const geometry_msgs::Vector3& v) { return {v.x, v.y, v.z}; }

Decoded refuse_long_frame(const std::string& is) {
  return refused(surg::Reason::kWrongFrame,
                 "frame_id is " + quoted(is) + "; allowed are names of at most " +
                     std::to_string(FrameName::kLongest) + " characters");
}

}  // namespace

std::string decode_rotation(const geometry_msgs::Quaternion& q, Eigen::Quaterniond& rotation) {
  rotation.coeffs() << q.x, q.y, q.z, q.w;
  if (!rotation.coeffs().allFinite()) return {};
  const double norm = rotation.norm();
  if (!(std::abs(norm - 1.0) <= kUnitTolerance)) {
    return "orientation (x, y, z, w) has norm " + std::to_string(norm) +
           "; a unit quaternion is needed, (0, 0, 0, 1) for no rotation";
  }
  rotation.normalize();
  return {};
}

Decoded decode_pose(const geometry_msgs::PoseStamped& message, surg::Motion motion) {
  if (!FrameName::fits(message.header.frame_id)) return refuse_long_frame(message.header.frame_id);
  Decoded decoded = motion_of(motion);
  surg::MotionCommand& command = decoded.item.motion;
  decoded.item.frame = FrameName(message.header.frame_id);
  command.p = to_eigen(message.pose.position);
  const std::string problem = decode_rotation(message.pose.orientation, command.rotation);
  if (!problem.empty()) return refused(surg::Reason::kNotFinite, problem);
  if (!command.rotation.coeffs().allFinite()) {
    // Not finite is the controller's FAULT. The position carries it there, so that no law of
    // rotations can lose it on the way.
    command.p.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  return decoded;
}

Decoded decode_twist(const geometry_msgs::TwistStamped& message) {
  if (!FrameName::fits(message.header.frame_id)) return refuse_long_frame(message.header.frame_id);
  Decoded decoded = motion_of(surg::Motion::kServoCv);
  decoded.item.frame = FrameName(message.header.frame_id);
  decoded.item.motion.p = to_eigen(message.twist.linear);
  decoded.item.angular = to_eigen(message.twist.angular);
  return decoded;
}

std::string listed(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

const std::vector<std::string>& joint_names(bool wristed) {
  static const std::vector<std::string> kStraight{"yaw", "pitch", "insertion", "roll"};
  static const std::vector<std::string> kWristed{"yaw",  "pitch",       "insertion",
                                                 "roll", "wrist_pitch", "wrist_yaw"};
  return wristed ? kWristed : kStraight;
}

Decoded decode_joints(const sensor_msgs::JointState& message, surg::Motion motion, bool wristed) {
  const bool velocity = motion == surg::Motion::kServoJv;
  const std::vector<double>& values = velocity ? message.velocity : message.position;
  const std::vector<std::string>& names = joint_names(wristed);
  if (values.size() != names.size()) {
    return refused(surg::Reason::kWrongSize,
                   std::string(velocity ? "velocity" : "position") + " has " +
                       std::to_string(values.size()) + " values; needed are " +
                       std::to_string(names.size()) + ": " + listed(names));
  }
  if (!message.name.empty() && message.name != names) {
    return refused(surg::Reason::kWrongSize,
                   "name has " + std::to_string(message.name.size()) + " entries, the first " +
                       quoted(message.name.front()) + "; allowed is none, or [" + listed(names) +
                       "] in this order");
  }
  Decoded decoded = motion_of(motion);
  decoded.item.motion.joints = surg::Vector4(values[0], values[1], values[2], values[3]);
  if (wristed) decoded.item.motion.wrist = {values[4], values[5], 0};
  return decoded;
}

Decoded decode_angle(const sensor_msgs::JointState& message, surg::Motion motion) {
  const bool elbow = motion == surg::Motion::kElbowMoveJp;
  if (message.position.size() != 1) {
    return refused(surg::Reason::kWrongSize,
                   "position has " + std::to_string(message.position.size()) +
                       " values; needed is 1: the " +
                       (elbow ? "elbow's swivel angle" : "jaw's opening angle"));
  }
  Decoded decoded = motion_of(motion);
  (elbow ? decoded.item.motion.elbow : decoded.item.motion.jaw) = message.position[0];
  return decoded;
}

Decoded decode_hold() { return motion_of(surg::Motion::kHold); }

Decoded decode_start_stop(const crtk_msgs::StringStamped& message, surg::Motion motion) {
  if (message.string == "start") return motion_of(motion);
  if (message.string == "stop") return decode_hold();
  return refused(surg::Reason::kRefusedTransition,
                 "string is " + quoted(message.string) + "; allowed are start, stop");
}

Decoded decode_claim() {
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kClaim;
  return decoded;
}

Decoded decode_at_wall(const crtk_msgs::StringStamped& message) {
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kAtWall;
  decoded.item.slide = message.string == "slide";
  if (decoded.item.slide || message.string == "refuse") return decoded;
  return refused(surg::Reason::kRefusedTransition,
                 "string is " + quoted(message.string) + "; allowed are slide, refuse");
}

Decoded decode_state(const crtk_msgs::StringStamped& message) {
  for (const auto& [word, command] : kStateWords) {
    if (message.string != word) continue;
    Decoded decoded;
    decoded.item.kind = CommandItem::Kind::kState;
    decoded.item.state = command;
    return decoded;
  }
  return refused(
      surg::Reason::kRefusedTransition,
      "string is " + quoted(message.string) +
          ", which is no state command; allowed are enable, disable, pause, resume, home, unhome");
}

Decoded decode_rcm(const geometry_msgs::PoseStamped& message, const std::string& frame) {
  const std::string problem = wrong_frame(message.header.frame_id, frame);
  if (!problem.empty()) return refused(surg::Reason::kWrongFrame, problem);
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kSetRcm;
  decoded.item.p_B = to_eigen(message.pose.position);
  return decoded;
}

Decoded decode_fixture(const surg_msgs::Fixture& message, const std::string& frame) {
  const std::string problem = wrong_frame(message.header.frame_id, frame);
  if (!problem.empty()) return refused(surg::Reason::kWrongFrame, problem);
  Decoded decoded = decode_fixture_name(message.name);
  if (decoded.reason != surg::Reason::kNone) return decoded;
  decoded.item.kind = CommandItem::Kind::kSetFixture;
  surg::Fixture& fixture = decoded.item.fixture;
  const auto shape = word_to<surg::Fixture::Shape>(message.shape, kShapes);
  const auto side = word_to<surg::Fixture::Side>(message.side, kSides);
  const auto of = word_to<surg::Fixture::Of>(message.of, kParts);
  if (!shape || !side || !of) {
    return refused(surg::Reason::kWrongSize,
                   "shape, side and of are " + quoted(message.shape) + ", " + quoted(message.side) +
                       ", " + quoted(message.of) +
                       "; allowed are plane, sphere, capsule; keep_out, stay_in; tip, shaft");
  }
  fixture.shape = *shape;
  fixture.side = *side;
  fixture.of = *of;
  fixture.point = to_eigen(message.point);
  fixture.axis = fixture.shape == surg::Fixture::Shape::kPlane
                     ? to_eigen(message.normal)
                     : surg::Vector3(to_eigen(message.end) - fixture.point);
  fixture.radius = message.radius;
  const std::string wrong = surg::check_fixture(fixture);
  return wrong.empty() ? decoded : refused(surg::Reason::kNotFinite, wrong);
}

Decoded decode_fixture_name(const std::string& name) {
  if (name.empty() || name.size() > surg::Fixture::kLongestName) {
    return refused(surg::Reason::kWrongSize, "name is " + quoted(name) + "; allowed are 1 to " +
                                                 std::to_string(surg::Fixture::kLongestName) +
                                                 " letters, digits and _");
  }
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kRemoveFixture;
  decoded.item.fixture.set_name(name);
  return decoded;
}

Decoded decode_track(const surg_msgs::PointVelocityStamped& message, const std::string& frame) {
  const std::string problem = wrong_frame(message.header.frame_id, frame);
  if (!problem.empty()) return refused(surg::Reason::kWrongFrame, problem);
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kTrack;
  decoded.item.p_B = to_eigen(message.point);
  decoded.item.v_B = to_eigen(message.velocity);
  return decoded;
}

Decoded decode_base_frame(const geometry_msgs::PoseStamped& message, const std::string& rcm,
                          const std::string& user) {
  const std::string& frame = message.header.frame_id;
  if (!FrameName::fits(frame)) return refuse_long_frame(frame);
  Eigen::Quaterniond q_UR;
  const surg::Vector3 p_UR = to_eigen(message.pose.position);
  const std::string problem = decode_rotation(message.pose.orientation, q_UR);
  if (!problem.empty()) return refused(surg::Reason::kNotFinite, problem);
  if (!p_UR.allFinite() || !q_UR.coeffs().allFinite()) {
    return refused(surg::Reason::kNotFinite, "the pose holds NaN or infinity: send finite numbers");
  }
  const bool identity = p_UR.isZero(0) && q_UR.vec().isZero(0);
  if (frame == rcm && !identity) {
    return refused(surg::Reason::kWrongFrame,
                   "frame_id is '" + rcm +
                       "', and the pose is not the identity: it is the pose of '" + rcm +
                       "' in the frame that frame_id names, so give that one another name");
  }
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kSetFrame;
  decoded.item.frame = FrameName(!frame.empty() ? frame : identity ? rcm : user);
  decoded.item.X_UR.linear() = q_UR.toRotationMatrix();
  decoded.item.X_UR.translation() = p_UR;
  return decoded;
}

surg_msgs::Fixture encode_fixture(const surg::Fixture& fixture) {
  surg_msgs::Fixture message;
  message.name = fixture.title();
  message.shape = word_of(fixture.shape, kShapes);
  message.side = word_of(fixture.side, kSides);
  message.of = word_of(fixture.of, kParts);
  const surg::Vector3 &p = fixture.point, &axis = fixture.axis;
  message.point.x = p.x();
  message.point.y = p.y();
  message.point.z = p.z();
  const bool plane = fixture.shape == surg::Fixture::Shape::kPlane;
  const surg::Vector3 normal = plane ? axis : surg::Vector3(surg::Vector3::Zero());
  const surg::Vector3 end = plane ? p : surg::Vector3(p + axis);
  message.normal.x = normal.x();
  message.normal.y = normal.y();
  message.normal.z = normal.z();
  message.end.x = end.x();
  message.end.y = end.y();
  message.end.z = end.z();
  message.radius = fixture.radius;
  message.of_cell = static_cast<std::uint8_t>(fixture.of_cell);
  return message;
}

std::string decode_state_of_robot(const sensor_msgs::JointState& message,
                                  const std::vector<std::string>& names, LinkState& link) {
  const std::size_t n = names.size();
  if (message.name != names || message.position.size() != n || message.velocity.size() != n) {
    return "robot/measured_js needs name [" + listed(names) + "] in this order and " +
           std::to_string(n) + " positions and velocities; it came with " +
           std::to_string(message.name.size()) + " names, " +
           std::to_string(message.position.size()) + " positions, " +
           std::to_string(message.velocity.size()) + " velocities";
  }
  link.stamp_ns = message.header.stamp.toNSec();
  link.q = Eigen::Map<const Eigen::VectorXd>(message.position.data(), static_cast<Eigen::Index>(n));
  link.qd =
      Eigen::Map<const Eigen::VectorXd>(message.velocity.data(), static_cast<Eigen::Index>(n));
  return {};
}

const char* topic_of(surg::Motion motion) {
  const auto number = static_cast<std::size_t>(motion);
  return number < kTopics.size() ? kTopics[number] : "unknown";
}

const char* word_of(surg::StateCommand command) {
  for (const auto& [word, value] : kStateWords) {
    if (value == command) return word;
  }
  return "unknown";
}

}  // namespace surg_control
