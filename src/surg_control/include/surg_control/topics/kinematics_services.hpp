// CRTK's kinematics queries on the virtual joints: four, or six with a wrist.
#pragma once

#include <crtk_msgs/QueryForwardKinematics.h>
#include <crtk_msgs/QueryInverseKinematics.h>
#include <ros/ros.h>

#include <string>

#include "surg_control/loop/thread_channels.hpp"
#include "surg_control/topics/base_frame.hpp"
#include "surg_core/config.hpp"

namespace surg_control {

/// Answers a query. Requests of a wrong form and poses outside the workspace get result false and a
/// message with value and allowed range.
crtk_msgs::QueryForwardKinematics::Response answer_forward(
    const crtk_msgs::QueryForwardKinematics::Request& request, const surg::Pose& X_UR,
    const std::optional<surg::WristConfig>& wrist = {});
crtk_msgs::QueryInverseKinematics::Response answer_inverse(
    const crtk_msgs::QueryInverseKinematics::Request& request, const surg::Pose& X_UR,
    const surg::Limits& limits, const std::optional<surg::WristConfig>& wrist = {});

/// forward_kinematics, inverse_kinematics (in the user's frame), local/forward_kinematics (in R).
class KinematicsServices {
 public:
  KinematicsServices(ros::NodeHandle& node, const std::string& arm, const surg::Limits& limits,
                     const std::optional<surg::WristConfig>& wrist);

  /// Sets the frame of later answers, and how a wrist is mounted; call it from one thread only.
  void set_frame(const BaseFrame& frame, double turn);

 private:
  struct Frame {
    surg::Pose X_UR = surg::Pose::Identity();
    double turn = 0;  ///< see WristGeometry
  };
  Frame frame();
  std::optional<surg::WristConfig> mounted_wrist();

  surg::Limits limits_;
  std::optional<surg::WristConfig> wrist_;
  LatestSlot<Frame> newest_;
  Frame last_;
  double turn_ = 0;
  std::uint32_t version_ = 0;
  ros::ServiceServer forward_, local_forward_, inverse_;
};

}  // namespace surg_control
