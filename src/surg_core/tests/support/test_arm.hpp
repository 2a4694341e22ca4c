// One arm for the core's tests: UR5e kinematics (public DH parameters) with a 300 mm shaft, 60 mm
// aside.
#pragma once

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "surg_core/config.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/law/exact.hpp"

namespace surg::test {

/// A robot's YAML as it should be.
inline Document good_robot() {
  Document d{"robot.yaml", {}, {}};
  auto& v = d.values;
  const std::vector<double> home = {0.3, -1.5, 1.9, -1.97, -1.57, 0.2};
  v["format"] = std::string("surg_robot/1");
  v["name"] = std::string("ur5e");
  v["urdf"] = std::string("six.urdf");
  v["base_link"] = std::string("base_link");
  v["flange_link"] = std::string("flange");
  v["command"] = std::string("joint_velocity");
  v["joints.names"] = std::vector<std::string>{"a", "b", "c", "d", "e", "f"};
  v["joints.home"] = home;
  v["joints.position_min"] = std::vector<double>(6, -6.28);
  v["joints.position_max"] = std::vector<double>(6, 6.28);
  v["joints.velocity"] = std::vector<double>(6, 3.0);
  v["joints.acceleration"] = std::vector<double>(6, 15.0);
  const std::map<std::string, double> limits = {
      {"tip_velocity", 0.25},     {"tip_acceleration", 2},    {"tip_jerk", 40},
      {"pivot_velocity", 1.5},    {"pivot_acceleration", 16}, {"pivot_jerk", 330},
      {"roll_velocity", 3},       {"roll_acceleration", 40},  {"roll_jerk", 800},
      {"roll_max", 6.2832},       {"flange_velocity", 0.25},  {"cone", 1.0472},
      {"depth_min", 0.02},        {"depth_slow", 0.03},       {"depth_max", 0.22},
      {"stop_deceleration", 4},   {"step_slack", 0.002},      {"step_roll_slack", 0.0349},
      {"step_dt_max", 0.1},       {"rcm_error_warn", 0.001},  {"rcm_error_fault", 0.002},
      {"tip_force_soft", 5},      {"tip_force_hard", 8},      {"trocar_force_warn", 10},
      {"trocar_force_fault", 15}, {"joint_margin", 0.1}};
  for (const auto& [key, value] : limits) v["limits." + key] = value;
  const std::map<std::string, double> tuning = {
      {"rcm_gain", 20},     {"tip_gain", 10},           {"roll_gain", 10},
      {"posture_gain", 1},  {"profiler_duration", 0.5}, {"stream_delay", 0.0},
      {"tremor", 0.0},      {"servo_timeout", 0.1},     {"track_noise", 3e-4},
      {"track_jerk", 0.02}, {"track_timeout", 0.25}};
  for (const auto& [key, value] : tuning) v["tuning." + key] = value;
  d.lines["limits.cone"] = 42;
  return d;
}

/// A robot behind a link of this lag [s]; 0: unknown.
inline RobotConfig robot_behind(const Document& document, double link_lag = 0) {
  LinkConfig link = simulator_link();
  link.link_lag = link_lag;
  return with_link(parse_robot(document), link);
}

/// Standard DH: joint i + 1 sits behind the DH transform i; d1 .1625, a2 -.425, a3 -.3922, d4
/// .1333, d5 .0997, d6 .0996 m.
inline Chain ur5e_chain() {
  struct Dh {
    double d, a, alpha;
  };
  const Dh dh[6] = {{0.1625, 0, M_PI_2}, {0, -0.425, 0},       {0, -0.3922, 0},
                    {0.1333, 0, M_PI_2}, {0.0997, 0, -M_PI_2}, {0.0996, 0, 0}};
  std::vector<Joint> joints(6);
  Pose X_PJ = Pose::Identity();
  for (int i = 0; i < 6; ++i) {
    joints[i].name = "joint" + std::to_string(i + 1);
    joints[i].X_PJ = X_PJ;
    X_PJ = Eigen::Translation3d(dh[i].a, 0, dh[i].d) *
           Eigen::AngleAxisd(dh[i].alpha, Vector3::UnitX());
  }
  return Chain(joints, X_PJ);
}

/// Modified DH of the published kinematics of the Franka Emika Panda, in the frames of its URDF.
inline Chain panda_chain() {
  struct Place {
    double x, y, z, roll;
  };
  const Place places[7] = {
      {0, 0, 0.333, 0},       {0, 0, 0, -M_PI_2},           {0, -0.316, 0, M_PI_2},
      {0.0825, 0, 0, M_PI_2}, {-0.0825, 0.384, 0, -M_PI_2}, {0, 0, 0, M_PI_2},
      {0.088, 0, 0, M_PI_2}};
  std::vector<Joint> joints(7);
  for (int i = 0; i < 7; ++i) {
    const Place& at = places[i];
    joints[i].name = "joint" + std::to_string(i + 1);
    joints[i].X_PJ =
        Eigen::Translation3d(at.x, at.y, at.z) * Eigen::AngleAxisd(at.roll, Vector3::UnitX());
  }
  return Chain(joints, Pose(Eigen::Translation3d(0, 0, 0.107)));
}

/// Home postures of the two arms as they are shipped.
inline JointVector ur5e_home() {
  return (JointVector(6) << -0.294, -1.234, 1.511, -1.29, -1.63, -2.134).finished();
}
inline JointVector panda_home() {
  return (JointVector(7) << -0.147, -0.437, -0.073, -2.227, 0.367, 1.791, 0.044).finished();
}
/// Franka's published limits [rad/s, rad/s^2].
inline JointVector panda_velocity() {
  return (JointVector(7) << 2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61).finished();
}
inline JointVector panda_acceleration() {
  return (JointVector(7) << 15, 7.5, 10, 12.5, 15, 20, 20).finished();
}

/// The goal (yaw, pitch, insertion, roll) in the trocar frame (docs/reference/conventions.md).
inline ShaftGoal spherical_goal(const Pose& X_BR, const Vector4& joints) {
  return {X_BR.translation(), X_BR.linear() * shaft_direction(joints[0], joints[1]), joints[2],
          joints[3]};
}

inline InstrumentConfig instrument() { return {"", "grasper", "", "", "", 0.0, 1.0, 3.0}; }

inline ToolCalibration offset_tool() {
  return {{0, 1, 1, "2026-01-01"}, Vector3::UnitZ(), Vector3(0.06, 0, 0.3)};
}

}  // namespace surg::test
