// All outgoing topics of an arm except the robot command: CRTK feedback, state, cycle, tf,
// diagnostics and texts, made from CycleRecords. Used by one thread.
#pragma once

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TransformStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>
#include <surg_msgs/Cycle.h>
#include <surg_msgs/ScalarStamped.h>

#include <string>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/monitor/diagnostics.hpp"
#include "surg_control/topics/source_table.hpp"
#include "surg_control/topics/state_edges.hpp"
#include "surg_control/topics/status_reporter.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace surg_control {

/// A feedback topic that follows CRTK's rule for invalid data: stamp 0 once, then silence.
template <typename Message>
class Feedback {
 public:
  Feedback(ros::NodeHandle& node, const std::string& topic)
      : publisher_(node.advertise<Message>(topic, 100)) {}

  /// 'fill(message)' sets everything but the stamp and runs only when somebody listens.
  template <typename Fill>
  void publish(bool valid, const ros::Time& stamp, Fill fill) {
    if (!valid && said_invalid_) return;
    said_invalid_ = !valid;
    if (publisher_.getNumSubscribers() == 0) return;
    fill(message_);
    message_.header.stamp = valid ? stamp : ros::Time();
    publisher_.publish(message_);
  }

 private:
  ros::Publisher publisher_;
  Message message_;
  bool said_invalid_ = false;
};

/// The arm's publishers.
class StatePublishers {
 public:
  StatePublishers(ros::NodeHandle& node, const surg::ArmSetup& setup, const ControllerInfo& info,
                  const Health& health, const SourceTable& sources, StatusReporter& reporter);

  /// The cycle message, every tick; first, because participants wait for it.
  void publish_cycle(const CycleRecord& record);
  /// All other topics, each at its own rate, and the status texts. 'now' [s] as for StatusReporter.
  void publish_rest(const CycleRecord& record, double now);

 private:
  void publish_feedback(const CycleRecord& record);
  void publish_tip(const CycleRecord& record, bool valid);
  void publish_tool(const surg::MountedTool& tool);
  void publish_elbow(const CycleRecord& record, bool valid);
  void publish_rcm(const CycleRecord& record);
  bool feedback_due(const CycleRecord& record);
  void publish_state(const CycleRecord& record);
  void publish_fixtures(const CycleRecord& record);
  void publish_static_tf(const surg::ArmSetup& setup);
  void publish_tf(const CycleRecord& record);
  geometry_msgs::TransformStamped transform(const CycleRecord& record, const std::string& child,
                                            const surg::Pose& X, const std::string& parent) const;

  std::string arm_, base_, flange_, tool_, rcm_;
  surg::MountedTool at_start_;
  const surg::MountedTool* mounted_ = nullptr;  // published last
  surg::Chain chain_;
  bool lockstep_;
  const SourceTable& sources_;
  StatusReporter& reporter_;
  StateEdges edges_;
  double since_feedback_ = 0;  // [s]
  Diagnostics diagnostics_;

  ros::Publisher cycle_, operating_state_, tf_, tf_static_, rcm_limit_, fixtures_, mounted_tool_;
  std::int64_t fixtures_version_ = -1;  // published last
  Feedback<sensor_msgs::JointState> measured_js_, setpoint_js_, jaw_measured_js_, jaw_setpoint_js_,
      elbow_measured_js_, elbow_goal_js_;
  Feedback<geometry_msgs::PoseStamped> measured_cp_, local_measured_cp_, setpoint_cp_, goal_cp_,
      rcm_measured_cp_;
  Feedback<geometry_msgs::TwistStamped> measured_cv_;
  Feedback<surg_msgs::ScalarStamped> rcm_error_;
  Feedback<surg_msgs::ScalarStamped> clearance_;

  surg_msgs::Cycle cycle_message_;
};

}  // namespace surg_control
