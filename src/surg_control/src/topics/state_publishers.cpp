#include "surg_control/topics/state_publishers.hpp"

#include <crtk_msgs/OperatingState.h>
#include <crtk_msgs/StringStamped.h>
#include <surg_msgs/Fixtures.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <cmath>

#include "surg_control/topics/decode.hpp"
#include "surg_control/topics/messages.hpp"
#include "surg_core/kinematics/elbow.hpp"
#include "surg_core/law/rcm.hpp"

namespace surg_control {
namespace {

// Ticks between two messages.
constexpr std::uint64_t kFeedbackLockstep = 5;  // 100 Hz of simulated time
constexpr double kFeedbackPeriod = 0.005;       // [s] free-run
constexpr std::uint64_t kTfTicks = 10;          // 50 Hz

/// Four joints, and two more behind them where there is a wrist.
void fill_joints(std::vector<double>& values, const surg::Vector4& shaft,
                 const surg::WristJoints* wrist) {
  values.assign(shaft.data(), shaft.data() + 4);
  if (wrist != nullptr) values.insert(values.end(), wrist->data(), wrist->data() + 2);
}

void fill_jaw(sensor_msgs::JointState& message, double jaw) {
  if (message.name.empty()) message.name = {"jaw"};
  message.position.assign(1, jaw);
}

}  // namespace

StatePublishers::StatePublishers(ros::NodeHandle& node, const surg::ArmSetup& setup,
                                 const ControllerInfo& info, const Health& health,
                                 const SourceTable& sources, StatusReporter& reporter)
    : arm_(setup.arm.name),
      base_(arm_ + "_base"),
      flange_(arm_ + "_flange"),
      tool_(arm_ + "_tool"),
      rcm_(arm_ + "_rcm"),
      at_start_(setup.mounted),
      chain_(setup.model.chain),
      lockstep_(info.lockstep),
      sources_(sources),
      reporter_(reporter),
      diagnostics_(node, arm_, info, health, sources),
      // Unbounded in lock-step, where nothing may be lost; latched there, so that a participant
      // whose connection comes up late still gets the cycle it has to answer.
      cycle_(node.advertise<surg_msgs::Cycle>("/" + arm_ + "/cycle", info.lockstep ? 0 : 500,
                                              info.lockstep)),
      operating_state_(
          node.advertise<crtk_msgs::OperatingState>("/" + arm_ + "/operating_state", 100, true)),
      tf_(node.advertise<tf2_msgs::TFMessage>("/tf", 100)),
      tf_static_(node.advertise<tf2_msgs::TFMessage>("/tf_static", 1, true)),
      rcm_limit_(node.advertise<surg_msgs::ScalarStamped>("/" + arm_ + "/rcm/limit", 1, true)),
      fixtures_(node.advertise<surg_msgs::Fixtures>("/" + arm_ + "/fixtures", 1, true)),
      mounted_tool_(
          node.advertise<crtk_msgs::StringStamped>("/" + arm_ + "/tool/mounted", 1, true)),
      measured_js_(node, "/" + arm_ + "/measured_js"),
      setpoint_js_(node, "/" + arm_ + "/setpoint_js"),
      jaw_measured_js_(node, "/" + arm_ + "/jaw/measured_js"),
      jaw_setpoint_js_(node, "/" + arm_ + "/jaw/setpoint_js"),
      elbow_measured_js_(node, "/" + arm_ + "/elbow/measured_js"),
      elbow_goal_js_(node, "/" + arm_ + "/elbow/goal_js"),
      measured_cp_(node, "/" + arm_ + "/measured_cp"),
      local_measured_cp_(node, "/" + arm_ + "/local/measured_cp"),
      setpoint_cp_(node, "/" + arm_ + "/setpoint_cp"),
      goal_cp_(node, "/" + arm_ + "/goal_cp"),
      rcm_measured_cp_(node, "/" + arm_ + "/rcm/measured_cp"),
      measured_cv_(node, "/" + arm_ + "/measured_cv"),
      rcm_error_(node, "/" + arm_ + "/rcm/error"),
      clearance_(node, "/" + arm_ + "/clearance") {
  surg_msgs::ScalarStamped limit;
  limit.header.stamp = wall_time();
  limit.header.frame_id = base_;
  limit.value = setup.limits.rcm_error_fault;
  rcm_limit_.publish(limit);
  publish_tool(at_start_);
  publish_static_tf(setup);
  publish_state(CycleRecord());
}

void StatePublishers::publish_static_tf(const surg::ArmSetup& setup) {
  const CycleRecord still;
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform(still, base_, setup.X_WB, "world"));
  // A robot_state_publisher's links hang on the URDF's root. With two arms of one kind they would
  // have the same names, and no tree can hold both.
  if (!setup.model.root_link.empty() && setup.arms_in_cell.size() == 1) {
    message.transforms.push_back(
        transform(still, setup.model.root_link, setup.model.X_BRoot, base_));
  }
  tf_static_.publish(message);
}

void StatePublishers::publish_tool(const surg::MountedTool& tool) {
  crtk_msgs::StringStamped message;
  message.header.stamp = wall_time();
  message.string = tool.instrument_file + " " + tool.calibration_file;
  mounted_tool_.publish(message);
}

void StatePublishers::publish_cycle(const CycleRecord& record) {
  if (record.stamp_ns == 0) return;
  encode_cycle(record, base_, sources_, cycle_message_);
  cycle_.publish(cycle_message_);
}

void StatePublishers::publish_rest(const CycleRecord& record, double now) {
  reporter_.report(record, now);
  publish_state(record);
  publish_fixtures(record);
  if (record.tool != mounted_) publish_tool(*record.tool);
  mounted_ = record.tool;
  if (feedback_due(record)) {
    publish_feedback(record);
    publish_rcm(record);
  }
  if (record.tick % kTfTicks == 0) publish_tf(record);
  diagnostics_.add(record, now);
}

/// Free-run: 200 Hz by the cycles' own time, two of five of them. Where cycles are lost, as many as
/// are left: clients give up on feedback that is older than 20 ms.
bool StatePublishers::feedback_due(const CycleRecord& record) {
  if (lockstep_) return record.tick % kFeedbackLockstep == 0;
  since_feedback_ += 1e-6 * record.period_us;
  if (since_feedback_ < kFeedbackPeriod - 1e-4) return false;
  since_feedback_ = std::min(since_feedback_ - kFeedbackPeriod, kTick);
  return true;
}

void StatePublishers::publish_feedback(const CycleRecord& record) {
  const surg::Outputs& out = record.out;
  const ros::Time stamp = to_time(record.stamp_ns);
  // The rcm frame, and with it every virtual joint, exists from 'home' on.
  const bool known = record.stamp_ns != 0 && out.reason != surg::Reason::kLinkLost &&
                     out.reason != surg::Reason::kStateNotFinite;
  const bool valid = known && out.homed;
  const surg::WristOutputs* wrist = out.wrist.exists ? &out.wrist : nullptr;
  const std::vector<std::string>& names = joint_names(wrist != nullptr);
  measured_js_.publish(valid, stamp, [&](auto& message) {
    if (message.name.empty()) message.name = names;
    fill_joints(message.position, out.virtual_q, wrist ? &wrist->q : nullptr);
    fill_joints(message.velocity, out.virtual_qd, wrist ? &wrist->qd : nullptr);
  });
  setpoint_js_.publish(valid, stamp, [&](auto& message) {
    if (message.name.empty()) message.name = names;
    fill_joints(message.position, out.virtual_set, wrist ? &wrist->set : nullptr);
  });
  publish_tip(record, valid);
  jaw_measured_js_.publish(known, stamp, [&](auto& message) { fill_jaw(message, out.jaw); });
  jaw_setpoint_js_.publish(known, stamp, [&](auto& message) { fill_jaw(message, out.jaw_set); });
  publish_elbow(record, known);
}

void StatePublishers::publish_elbow(const CycleRecord& record, bool valid) {
  const double angle = valid ? surg::swivel_angle(chain_, record.q) : NAN;
  const double goal = record.out.elbow_goal;
  const ros::Time stamp = to_time(record.stamp_ns);
  const auto fill = [](sensor_msgs::JointState& message, double value) {
    if (message.name.empty()) message.name = {"elbow"};
    message.position.assign(1, value);
  };
  elbow_measured_js_.publish(std::isfinite(angle), stamp,
                             [&](auto& message) { fill(message, angle); });
  elbow_goal_js_.publish(valid && std::isfinite(goal), stamp,
                         [&](auto& message) { fill(message, goal); });
}

void StatePublishers::publish_tip(const CycleRecord& record, bool valid) {
  const surg::Outputs& out = record.out;
  const ros::Time stamp = to_time(record.stamp_ns);
  const surg::Pose X_RB = record.X_BR.inverse();
  const auto in_user_frame = [&](const surg::Vector3& p_B, const Eigen::Quaterniond& q_R) {
    return [&](geometry_msgs::PoseStamped& message) {
      const ToolPose pose = pose_from_rcm(record.frame.X_UR, {X_RB * p_B, q_R});
      message.header.frame_id = record.frame.name.c_str();
      message.pose = to_pose(pose.p, pose.q);
    };
  };
  measured_cp_.publish(valid, stamp, in_user_frame(out.p_BTip, record.q_RTool));
  setpoint_cp_.publish(valid, stamp, in_user_frame(out.p_set, record.q_RSet));
  goal_cp_.publish(valid, stamp, in_user_frame(out.p_goal, record.q_RGoal));
  local_measured_cp_.publish(valid, stamp, [&](geometry_msgs::PoseStamped& message) {
    message.header.frame_id = rcm_;
    message.pose = to_pose(X_RB * out.p_BTip, record.q_RTool);
  });
  measured_cv_.publish(valid, stamp, [&](geometry_msgs::TwistStamped& message) {
    const surg::Vector3 s_R = X_RB.linear() * out.s_B;
    const surg::Vector3 s_dot = surg::shaft_direction_rate(out.virtual_q[0], out.virtual_q[1],
                                                           out.virtual_qd[0], out.virtual_qd[1]);
    const surg::Vector3 omega_R = out.wrist.exists
                                      ? surg::Vector3(X_RB.linear() * out.wrist.omega_B)
                                      : surg::Vector3(s_R.cross(s_dot) + out.virtual_qd[3] * s_R);
    const ToolTwist twist =
        twist_from_rcm(record.frame.X_UR, {X_RB.linear() * out.v_BTip, omega_R});
    message.header.frame_id = record.frame.name.c_str();
    message.twist.linear = to_vector(twist.v);
    message.twist.angular = to_vector(twist.omega);
  });
}

void StatePublishers::publish_rcm(const CycleRecord& record) {
  const bool valid = record.stamp_ns != 0;
  const ros::Time stamp = to_time(record.stamp_ns);
  rcm_error_.publish(valid, stamp, [&](surg_msgs::ScalarStamped& message) {
    message.header.frame_id = base_;
    message.value = record.out.rcm_error;
  });
  const bool guarded = valid && std::isfinite(record.out.clearance);
  clearance_.publish(guarded, stamp, [&](surg_msgs::ScalarStamped& message) {
    message.header.frame_id = base_;
    message.value = record.out.clearance;
  });
  rcm_measured_cp_.publish(valid, stamp, [&](geometry_msgs::PoseStamped& message) {
    message.header.frame_id = base_;
    message.pose = to_pose(record.out.p_BRcm, Eigen::Quaterniond(record.X_BR.linear()));
  });
}

void StatePublishers::publish_state(const CycleRecord& record) {
  const StateEdges::Report report = edges_.next(record);
  if (!report.due) return;
  crtk_msgs::OperatingState message;
  // Clients wait for an is_busy that is stamped later than the moment they sent their command. The
  // joint state that the cycle was computed from may be older than that.
  message.header.stamp = lockstep_ ? to_time(record.stamp_ns) : wall_time();
  message.state = surg::name(record.out.state);
  message.is_homed = record.out.homed;
  message.is_busy = report.busy;
  operating_state_.publish(message);
}

void StatePublishers::publish_fixtures(const CycleRecord& record) {
  if (record.fixtures_version == fixtures_version_) return;
  fixtures_version_ = record.fixtures_version;
  surg_msgs::Fixtures message;
  message.header.stamp = lockstep_ ? to_time(record.stamp_ns) : wall_time();
  message.header.frame_id = base_;
  for (const surg::Fixture& fixture : record.fixtures) {
    message.fixtures.push_back(encode_fixture(fixture));
    message.fixtures.back().header = message.header;
  }
  fixtures_.publish(message);
}

geometry_msgs::TransformStamped StatePublishers::transform(const CycleRecord& record,
                                                           const std::string& child,
                                                           const surg::Pose& X,
                                                           const std::string& parent) const {
  geometry_msgs::TransformStamped message;
  message.header.stamp = to_time(record.stamp_ns);
  message.header.frame_id = parent;
  message.child_frame_id = child;
  message.transform.translation = to_vector(X.translation());
  message.transform.rotation = to_quaternion(Eigen::Quaterniond(X.linear()));
  return message;
}

void StatePublishers::publish_tf(const CycleRecord& record) {
  if (record.stamp_ns == 0 || tf_.getNumSubscribers() == 0) return;
  // The tool frame as measured_cp states it, so that both say the same.
  surg::Pose X_FTool = surg::Pose::Identity();
  X_FTool.linear() = record.out.X_BF.linear().transpose() * record.X_BR.linear() *
                     record.q_RTool.toRotationMatrix();
  X_FTool.translation() = record.out.wrist.exists
                              ? surg::Vector3(record.out.X_BF.inverse() * record.out.p_BTip)
                              : (record.tool ? record.tool : &at_start_)->tool.p_FTip;
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform(record, flange_, record.out.X_BF, base_));
  message.transforms.push_back(transform(record, tool_, X_FTool, flange_));
  message.transforms.push_back(transform(record, rcm_, record.X_BR, base_));
  tf_.publish(message);
}

}  // namespace surg_control
