#include "surg_control/messages.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace surg_control {
namespace {

constexpr double kUnitTolerance = 1e-3;  // of a quaternion's norm
constexpr double kTiltTolerance =
    0.0175;  // [rad], 1 degree: below, nothing worth a word is ignored

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

std::string wrong_frame(const std::string& is, const std::string& expected) {
  return "frame_id is '" + is + "'; allowed is '" + expected + "' or an empty one";
}

surg::Vector3 to_eigen(const geometry_msgs::Point& p) { return {p.x, p.y, p.z}; }
surg::Vector3 to_eigen(const geometry_msgs::Vector3& v) { return {v.x, v.y, v.z}; }

template <typename Source, typename Target>
void copy3(const Source& source, Target& target) {
  for (int i = 0; i < 3; ++i) target[i] = source[i];
}

}  // namespace

Decoded decode_pose(const geometry_msgs::PoseStamped& message, surg::Motion motion,
                    const std::string& frame) {
  if (!message.header.frame_id.empty() && message.header.frame_id != frame) {
    return refused(surg::Reason::kWrongFrame, wrong_frame(message.header.frame_id, frame));
  }
  Decoded decoded;
  surg::MotionCommand& command = decoded.item.motion;
  command.motion = motion;
  command.p = to_eigen(message.pose.position);
  const geometry_msgs::Quaternion& q = message.pose.orientation;
  command.rotation.coeffs() << q.x, q.y, q.z, q.w;
  if (!command.rotation.coeffs().allFinite()) {
    // Not finite is the controller's FAULT. The position carries it there, so that no law of
    // rotations can lose it on the way.
    command.p.setConstant(std::numeric_limits<double>::quiet_NaN());
    return decoded;
  }
  const double norm = command.rotation.norm();
  if (!(std::abs(norm - 1.0) <= kUnitTolerance)) {
    return refused(surg::Reason::kNotFinite,
                   "orientation (x, y, z, w) has norm " + std::to_string(norm) +
                       "; a unit quaternion is needed, (0, 0, 0, 1) for no rotation");
  }
  command.rotation.normalize();
  // At the target the shaft points from the trocar (the frame's origin) to p.
  const double depth = command.p.norm();
  if (depth > 1e-6 && std::isfinite(depth)) {
    const surg::Vector3 z = command.rotation * surg::Vector3::UnitZ();
    const double tilt = std::atan2(z.cross(command.p).norm(), z.dot(command.p));
    if (tilt > kTiltTolerance) {
      decoded.ignored =
          "of an orientation only the roll about the shaft is followed: the trocar and the "
          "position "
          "fix the rest";
    }
  }
  return decoded;
}

Decoded decode_joints(const sensor_msgs::JointState& message, surg::Motion motion) {
  const bool velocity = motion == surg::Motion::kServoJv;
  const std::vector<double>& values = velocity ? message.velocity : message.position;
  if (values.size() != 4) {
    return refused(surg::Reason::kWrongSize,
                   std::string(velocity ? "velocity" : "position") + " has " +
                       std::to_string(values.size()) +
                       " values; needed are 4: yaw, pitch, insertion, roll");
  }
  static const std::vector<std::string> kNames{"yaw", "pitch", "insertion", "roll"};
  if (!message.name.empty() && message.name != kNames) {
    return refused(surg::Reason::kWrongSize,
                   "name must be empty or [yaw, pitch, insertion, roll] in this order");
  }
  Decoded decoded;
  decoded.item.motion.motion = motion;
  decoded.item.motion.joints = surg::Vector4(values[0], values[1], values[2], values[3]);
  return decoded;
}

Decoded decode_twist(const geometry_msgs::TwistStamped& message, const std::string& frame) {
  if (!message.header.frame_id.empty() && message.header.frame_id != frame) {
    return refused(surg::Reason::kWrongFrame, wrong_frame(message.header.frame_id, frame));
  }
  Decoded decoded;
  decoded.item.motion.motion = surg::Motion::kServoCv;
  decoded.item.motion.p = to_eigen(message.twist.linear);
  decoded.item.angular = to_eigen(message.twist.angular);
  return decoded;
}

Decoded decode_jaw(const sensor_msgs::JointState& message) {
  if (message.position.size() != 1) {
    return refused(surg::Reason::kWrongSize, "position has " +
                                                 std::to_string(message.position.size()) +
                                                 " values; needed is 1: the jaw's opening angle");
  }
  Decoded decoded;
  decoded.item.motion.motion = surg::Motion::kJawServoJp;
  decoded.item.motion.jaw = message.position[0];
  return decoded;
}

Decoded decode_hold() {
  Decoded decoded;
  decoded.item.motion.motion = surg::Motion::kHold;
  return decoded;
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
      "'" + message.string.substr(0, 40) +
          "' is no state command; allowed are enable, disable, pause, resume, home, unhome");
}

Decoded decode_rcm(const geometry_msgs::PoseStamped& message, const std::string& frame) {
  if (!message.header.frame_id.empty() && message.header.frame_id != frame) {
    return refused(surg::Reason::kWrongFrame, wrong_frame(message.header.frame_id, frame));
  }
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kSetRcm;
  decoded.item.p_BRcm = to_eigen(message.pose.position);
  return decoded;
}

std::string decode_state_of_robot(const sensor_msgs::JointState& message,
                                  const std::vector<std::string>& names, LinkState& link) {
  const std::size_t n = names.size();
  if (message.name != names || message.position.size() != n || message.velocity.size() != n) {
    std::string expected;
    for (const std::string& name : names) expected += (expected.empty() ? "" : ", ") + name;
    return "robot/measured_js needs name [" + expected + "] in this order and " +
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

ros::Time to_time(std::uint64_t ns) {
  return {static_cast<std::uint32_t>(ns / 1'000'000'000),
          static_cast<std::uint32_t>(ns % 1'000'000'000)};
}

geometry_msgs::Point to_point(const surg::Vector3& p) {
  geometry_msgs::Point message;
  message.x = p.x(), message.y = p.y(), message.z = p.z();
  return message;
}

geometry_msgs::Vector3 to_vector(const surg::Vector3& v) {
  geometry_msgs::Vector3 message;
  message.x = v.x(), message.y = v.y(), message.z = v.z();
  return message;
}

geometry_msgs::Quaternion to_quaternion(const Eigen::Quaterniond& q) {
  geometry_msgs::Quaternion message;
  message.x = q.x(), message.y = q.y(), message.z = q.z(), message.w = q.w();
  return message;
}

geometry_msgs::Pose to_pose(const surg::Vector3& p, const Eigen::Quaterniond& q) {
  geometry_msgs::Pose message;
  message.position = to_point(p);
  message.orientation = to_quaternion(q);
  return message;
}

void encode_cycle(const CycleRecord& record, const std::string& frame, const SourceTable& sources,
                  surg_msgs::Cycle& message) {
  const surg::Outputs& out = record.out;
  message.header.stamp = to_time(record.stamp_ns);
  message.header.frame_id = frame;
  message.tick = record.tick;
  message.state = static_cast<std::uint8_t>(out.state);
  message.homed = out.homed;
  message.busy = out.busy;
  message.reason = out.reason == surg::Reason::kNone ? "" : surg::name(out.reason);
  message.q.assign(record.q.data(), record.q.data() + record.q.size());
  message.qd.assign(record.qd.data(), record.qd.data() + record.qd.size());
  message.command = static_cast<std::uint8_t>(out.motion);
  message.source = sources.name(out.source);
  copy3(out.p_goal, message.p_goal);
  message.roll_goal = out.roll_goal;
  message.accepted = out.accepted;
  message.refused = out.refused + record.refused_by_node;
  copy3(out.p_BTip, message.p_tip);
  copy3(out.s_B, message.s);
  copy3(out.p_BRcm, message.p_rcm);
  const Eigen::Quaterniond q_BR(record.X_BR.linear());
  message.q_br = {q_BR.x(), q_BR.y(), q_BR.z(), q_BR.w()};
  message.roll = out.roll;
  message.depth = out.depth;
  message.rcm_error = out.rcm_error;
  copy3(out.p_set, message.p_set);
  copy3(out.v_set, message.v_set);
  message.roll_set = out.roll_set;
  message.jaw_set = out.jaw_set;
  message.jaw = out.jaw;
  message.scale = out.scale;
  message.limited_by = out.limited_by;
  message.qd_command.assign(out.qd_command.data(), out.qd_command.data() + out.qd_command.size());
  for (int i = 0; i < 6; ++i) message.twist_command[i] = out.twist_command[i];
  message.compute_us = record.compute_us;
  message.period_us = record.period_us;
  message.overruns = record.overruns;
}

const char* topic_of(surg::Motion motion) {
  switch (motion) {
    case surg::Motion::kNone:
      return "nothing";
    case surg::Motion::kServoCp:
      return "servo_cp";
    case surg::Motion::kServoJp:
      return "servo_jp";
    case surg::Motion::kServoCv:
      return "servo_cv";
    case surg::Motion::kServoJv:
      return "servo_jv";
    case surg::Motion::kInterpolateCp:
      return "interpolate_cp";
    case surg::Motion::kMoveCp:
      return "move_cp";
    case surg::Motion::kHold:
      return "hold";
    case surg::Motion::kJawServoJp:
      return "jaw/servo_jp";
  }
  return "unknown";
}

const char* word_of(surg::StateCommand command) {
  for (const auto& [word, value] : kStateWords) {
    if (value == command) return word;
  }
  return "unknown";
}

}  // namespace surg_control
