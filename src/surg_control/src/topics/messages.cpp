#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

template <typename Source, typename Target>
void copy3(const Source& source, Target& target) {
  for (int i = 0; i < 3; ++i) target[i] = source[i];
}

void assign(const surg::WristJoints& joints, std::vector<double>& to) {
  to.assign(joints.data(), joints.data() + joints.size());
}

void assign(const Eigen::Quaterniond& q, std::vector<double>& to) {
  to.assign({q.x(), q.y(), q.z(), q.w()});
}

/// Empty where there is no wrist: the tool may have been changed.
void encode_wrist(const CycleRecord& record, surg_msgs::Cycle& message) {
  const surg::WristOutputs& wrist = record.out.wrist;
  if (!wrist.exists) {
    for (auto* field : {&message.wrist_geometry, &message.wrist, &message.wrist_set,
                        &message.wrist_goal, &message.q_tip, &message.q_set, &message.q_goal}) {
      field->clear();
    }
    return;
  }
  const surg::WristGeometry& geometry = wrist.geometry;
  message.wrist_geometry.assign({geometry.pitch_to_yaw, geometry.yaw_to_tip, geometry.turn});
  assign(wrist.q, message.wrist);
  assign(wrist.set, message.wrist_set);
  assign(wrist.goal, message.wrist_goal);
  assign(record.q_RTool, message.q_tip);
  assign(record.q_RSet, message.q_set);
  assign(record.q_RGoal, message.q_goal);
}

}  // namespace

ros::Time to_time(std::uint64_t ns) {
  return {static_cast<std::uint32_t>(ns / 1'000'000'000),
          static_cast<std::uint32_t>(ns % 1'000'000'000)};
}

ros::Time wall_time() { return to_time(static_cast<std::uint64_t>(ros::WallTime::now().toNSec())); }

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
  message.reason_code = static_cast<std::uint8_t>(out.reason);
  message.reason = out.reason == surg::Reason::kNone ? "" : surg::name(out.reason);
  message.q.assign(record.q.data(), record.q.data() + record.q.size());
  message.qd.assign(record.qd.data(), record.qd.data() + record.qd.size());
  message.command = static_cast<std::uint8_t>(out.motion);
  message.source = sources.name(out.source);
  copy3(out.p_goal, message.p_goal);
  message.roll_goal = out.roll_goal;
  message.accepted = out.accepted;
  message.refused = out.refused + record.refused_by_node + record.refused_by_cycle;
  copy3(out.p_BTip, message.p_tip);
  copy3(out.s_B, message.s);
  copy3(out.p_BRcm, message.p_rcm);
  const Eigen::Quaterniond q_BR(record.X_BR.linear());
  message.q_br = {q_BR.x(), q_BR.y(), q_BR.z(), q_BR.w()};
  message.roll = out.roll;
  message.depth = out.depth;
  message.rcm_error = out.rcm_error;
  message.stop_bound_tip = out.stop_bound.tip;
  message.stop_bound_pivot = out.stop_bound.pivot;
  copy3(out.p_set, message.p_set);
  copy3(out.v_set, message.v_set);
  message.roll_set = out.roll_set;
  encode_wrist(record, message);
  message.jaw_set = out.jaw_set;
  message.jaw = out.jaw;
  message.scale = out.scale;
  message.limited_by = out.limited_by;
  message.tier = out.tier;
  message.qd_command.assign(out.qd_command.data(), out.qd_command.data() + out.qd_command.size());
  for (int i = 0; i < 6; ++i) message.twist_command[i] = out.twist_command[i];
  message.compute_us = record.compute_us;
  message.period_us = record.period_us;
  message.overruns = record.overruns;
}

}  // namespace surg_control
