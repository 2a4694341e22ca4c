#include "surg_control/topics/kinematics_services.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "surg_control/topics/decode.hpp"
#include "surg_control/topics/messages.hpp"
#include "surg_control/topics/virtual_kinematics.hpp"
#include "surg_core/limits/workspace.hpp"

namespace surg_control {
namespace {

using Forward = crtk_msgs::QueryForwardKinematics;
using Inverse = crtk_msgs::QueryInverseKinematics;

bool finite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

std::string workspace_text(const surg::Limits& limits, double depth, double tilt) {
  char text[200];
  std::snprintf(text, sizeof text,
                "cp is %.1f mm from the trocar and %.1f degrees off the home axis; allowed are "
                "%.1f to %.1f mm and %.1f degrees",
                depth * 1e3, tilt * 180 / M_PI, limits.depth_min * 1e3, limits.depth_max * 1e3,
                limits.cone * 180 / M_PI);
  return text;
}

constexpr const char* kFreeRoll =
    "cp turns the wrist's yaw axis towards the trocar, where the roll is free: turn it away";

/// Empty, or which joint of the wrist would have to go beyond its range.
std::string beyond_wrist(const surg::WristConfig& wrist, const surg::WristJoints& joints) {
  const std::vector<std::string>& names = joint_names(true);
  for (int i = 0; i < 2; ++i) {
    if (joints[i] >= wrist.min[i] && joints[i] <= wrist.max[i]) continue;
    char text[120];
    std::snprintf(text, sizeof text, "cp needs %s at %.3f rad; allowed are %.3f to %.3f rad",
                  names[4 + i].c_str(), joints[i], wrist.min[i], wrist.max[i]);
    return text;
  }
  return {};
}

}  // namespace

Forward::Response answer_forward(const Forward::Request& request, const surg::Pose& X_UR,
                                 const std::optional<surg::WristConfig>& wrist) {
  const std::vector<std::string>& names = joint_names(wrist.has_value());
  Forward::Response response;
  response.cp.orientation.w = 1;
  if (request.jp.size() != names.size() || !finite(request.jp)) {
    response.message = "jp has " + std::to_string(request.jp.size()) + " values; needed are " +
                       std::to_string(names.size()) + " finite ones: " + listed(names);
    return response;
  }
  ToolPose X_RTool =
      forward_kinematics({request.jp[0], request.jp[1], request.jp[2], request.jp[3]});
  if (wrist) {
    const surg::TipFrame tip = surg::tip_of_wrist(
        wrist->geometry,
        {{X_RTool.p, X_RTool.q.toRotationMatrix()}, {request.jp[4], request.jp[5]}});
    X_RTool = {tip.p, Eigen::Quaterniond(tip.R)};
  }
  const ToolPose pose = pose_from_rcm(X_UR, X_RTool);
  response.cp = to_pose(pose.p, pose.q);
  response.result = true;
  return response;
}

Inverse::Response answer_inverse(const Inverse::Request& request, const surg::Pose& X_UR,
                                 const surg::Limits& limits,
                                 const std::optional<surg::WristConfig>& wrist) {
  const std::vector<std::string>& names = joint_names(wrist.has_value());
  Inverse::Response response;
  const geometry_msgs::Point& p = request.cp.position;
  ToolPose X_UTool;
  X_UTool.p = {p.x, p.y, p.z};
  response.message = decode_rotation(request.cp.orientation, X_UTool.q);
  if (!response.message.empty()) return response;
  if (!X_UTool.p.allFinite() || !X_UTool.q.coeffs().allFinite()) {
    response.message = "cp holds NaN or infinity: send finite numbers";
    return response;
  }
  if (!(request.jp.empty() || request.jp.size() == names.size()) || !finite(request.jp)) {
    response.message =
        "jp has " + std::to_string(request.jp.size()) + " values; allowed are none, or " +
        std::to_string(names.size()) +
        " finite ones from whose roll the answer is the nearest turn: " + listed(names);
    return response;
  }
  ToolPose X_RTool = pose_to_rcm(X_UR, X_UTool);
  surg::WristJoints turned = surg::WristJoints::Zero();
  if (wrist) {
    const auto found =
        surg::wrists_of_tip(wrist->geometry, {X_RTool.p, X_RTool.q.toRotationMatrix()});
    response.message = found ? beyond_wrist(*wrist, (*found)[0].joints) : kFreeRoll;
    if (!response.message.empty()) return response;
    const surg::WristPose& first = (*found)[0];
    X_RTool = {first.centre.p, Eigen::Quaterniond(first.centre.R)};
    turned = first.joints;
  }
  const double depth = X_RTool.p.norm();
  if (!surg::inside_workspace(limits, X_RTool.p)) {
    const double across = std::hypot(X_RTool.p.x(), X_RTool.p.y());
    response.message = workspace_text(limits, depth, std::atan2(across, X_RTool.p.z()));
    return response;
  }
  const surg::Vector4 joints =
      inverse_kinematics(X_RTool, request.jp.empty() ? 0.0 : request.jp[3]);
  response.jp.assign(joints.data(), joints.data() + joints.size());
  if (wrist) response.jp.insert(response.jp.end(), turned.data(), turned.data() + turned.size());
  response.result = true;
  return response;
}

KinematicsServices::KinematicsServices(ros::NodeHandle& node, const std::string& arm,
                                       const surg::Limits& limits,
                                       const std::optional<surg::WristConfig>& wrist)
    : limits_(limits), wrist_(wrist) {
  const auto forward = [this](bool local) {
    return [this, local](Forward::Request& request, Forward::Response& response) {
      response =
          answer_forward(request, local ? surg::Pose::Identity() : frame().X_UR, mounted_wrist());
      return true;
    };
  };
  const auto serve = [&node, &arm](const std::string& name, auto answer) {
    return node.advertiseService<Forward::Request, Forward::Response>("/" + arm + "/" + name,
                                                                      answer);
  };
  forward_ = serve("forward_kinematics", forward(false));
  local_forward_ = serve("local/forward_kinematics", forward(true));
  inverse_ = node.advertiseService<Inverse::Request, Inverse::Response>(
      "/" + arm + "/inverse_kinematics",
      [this](Inverse::Request& request, Inverse::Response& response) {
        response = answer_inverse(request, frame().X_UR, limits_, mounted_wrist());
        return true;
      });
}

void KinematicsServices::set_frame(const BaseFrame& frame, double turn) {
  if (frame.version == version_ && turn == turn_) return;
  version_ = frame.version;
  turn_ = turn;
  newest_.put({frame.X_UR, turn});
}

KinematicsServices::Frame KinematicsServices::frame() {
  newest_.take(last_);
  return last_;
}

std::optional<surg::WristConfig> KinematicsServices::mounted_wrist() {
  std::optional<surg::WristConfig> mounted = wrist_;
  if (mounted) mounted->geometry.turn = frame().turn;
  return mounted;
}

}  // namespace surg_control
