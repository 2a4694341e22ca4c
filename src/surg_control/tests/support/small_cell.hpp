// A complete little cell in a temporary folder, for tests that change one thing in it.
#pragma once

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>

namespace surg_control_test {

namespace fs = std::filesystem;

/// A six-axis arm that exists nowhere else, with skewed axes and offsets in all directions.
inline std::string small_urdf() {
  std::ostringstream out;
  out << "<robot name=\"small\"><link name=\"base_link\"/>";
  const char* origin[6] = {"0.01 0 0.2", "0.3 0.02 0", "-0.1 0.2 0.05",
                           "0 0 0.3",    "0.1 0 0",    "0 -0.1 0.02"};
  const char* rpy[6] = {"0 0 0.3", "1.57 0 0", "0 0.4 0", "0.1 -1.2 0.3", "1.5708 0 0", "0 0 1"};
  const char* axis[6] = {"0 0 1", "0 0 1", "0 1 0", "0.6 0 0.8", "0 0 1", "1 0 0"};
  std::string parent = "base_link";
  for (int i = 0; i < 6; ++i) {
    const std::string child = "link" + std::to_string(i + 1);
    out << "<link name=\"" << child << "\"/><joint name=\"j" << i + 1 << "\" type=\""
        << (i == 5 ? "continuous" : "revolute") << "\"><parent link=\"" << parent
        << "\"/><child link=\"" << child << "\"/><origin xyz=\"" << origin[i] << "\" rpy=\""
        << rpy[i] << "\"/><axis xyz=\"" << axis[i]
        << "\"/><limit lower=\"-3\" upper=\"3\" velocity=\"2\" effort=\"10\"/></joint>";
    parent = child;
    if (i == 2) {  // a fixed joint in the middle of the chain
      out << "<link name=\"elbow\"/><joint name=\"fixed\" type=\"fixed\"><parent link=\"" << parent
          << "\"/><child link=\"elbow\"/><origin xyz=\"0 0 0.1\" rpy=\"0 0 0.5\"/></joint>";
      parent = "elbow";
    }
  }
  out << "<link name=\"flange\"/><joint name=\"flange_fixed\" type=\"fixed\"><parent link=\""
      << parent << "\"/><child link=\"flange\"/><origin xyz=\"0 0.02 0.1\" rpy=\"0 1 0\"/></joint>"
      << "</robot>";
  return out.str();
}

/// The cell's folder; removed with the object.
class SmallCell {
 public:
  SmallCell() {
    char name[] = "/tmp/surg_control_XXXXXX";
    if (mkdtemp(name) == nullptr) throw std::runtime_error("no temporary folder");
    root_ = name;
    fs::create_directories(root_ / "cell/calibration");
    write("robot.urdf", small_urdf());
    write("tool.urdf",
          "<robot name=\"tool\"><link name=\"mount\"/><link name=\"tip\"/><joint name=\"shaft\" "
          "type=\"fixed\"><parent link=\"mount\"/><child link=\"tip\"/></joint></robot>");
    write("robot.yaml",
          "format: surg_robot/1\nname: small\nurdf: robot.urdf\nbase_link: base_link\n"
          "flange_link: flange\ncommand: joint_velocity\n"
          "joints:\n  names: [j1, j2, j3, j4, j5, j6]\n  home: [0, 0, 0.5, 0, 0, 0]\n"
          "  position_min: [-2, -2, -2, -2, -2, -2]\n  position_max: [2, 2, 2, 2, 2, 2]\n"
          "  velocity: [1, 1, 1, 1, 1, 1]\n  acceleration: [5, 5, 5, 5, 5, 5]\n"
          "limits:\n  tip_velocity: 0.25\n  tip_acceleration: 2.0\n  tip_jerk: 40.0\n"
          "  pivot_velocity: 1.5\n  pivot_acceleration: 20\n  pivot_jerk: 400\n"
          "  roll_velocity: 3.0\n  roll_acceleration: 40\n  roll_jerk: 800\n"
          "  roll_max: 6.2832\n  flange_velocity: 0.25\n  cone: 1.0471975512\n  depth_min: 0.02\n"
          "  depth_slow: 0.03\n  depth_max: 0.22\n  stop_deceleration: 4.0\n"
          "  step_slack: 0.002\n  step_roll_slack: 0.0349\n  step_dt_max: 0.1\n"
          "  rcm_error_warn: 1e-3\n  rcm_error_fault: 0.002\n  tip_force_soft: 5.0\n  "
          "tip_force_hard: 8.0\n  trocar_force_warn: 10.0\n"
          "  trocar_force_fault: 15.0\n  joint_margin: 0.1\n"
          "tuning:\n  rcm_gain: 20\n  tip_gain: 5\n  roll_gain: 5\n  posture_gain: 1\n"
          "  profiler_duration: 0.5\n  stream_delay: 0\n  tremor: 0\n  servo_timeout: 0.1\n  "
          "track_noise: 3e-4\n  track_jerk: 0.02\n  track_timeout: 0.25\n");
    write("instrument.yaml",
          "format: surg_instrument/1\nname: tool\nurdf: tool.urdf\nmount_link: mount\n"
          "tip_link: tip\njaw: {min: 0.0, max: 1.0, velocity: 3.0}\n");
    write("cell/cell.yaml",
          "format: surg_cell/1\nname: small_cell\nnetwork: loopback\narms:\n  PSM1:\n"
          "    robot: ../robot.yaml\n    instrument: ../instrument.yaml\n    link: simulator\n"
          "    base: {xyz: [0.1, 0.2, 0.3], rpy: [0, 0, 1.5707963267948966]}\n"
          "    limits: {tip_velocity: 0.2}\n");
    write("cell/calibration/tool_PSM1.yaml",
          "format: surg_tool/1\nshaft_axis: [0, 0, 1]\ntip: [0.06, 0, 0.3]\nresidual: 0.0\n"
          "n: 1\ncondition: 1.0\ndate: \"2026-11-21\"\n");
    write("cell/calibration/trocar_PSM1.yaml",
          "format: surg_trocar/1\npoint: [0.5, 0.1, 0.2]\nresidual: 0.0\nn: 1\n"
          "condition: 1.0\ndate: \"2026-11-21\"\n");
  }
  ~SmallCell() { fs::remove_all(root_); }
  SmallCell(const SmallCell&) = delete;
  SmallCell& operator=(const SmallCell&) = delete;

  std::string path(const std::string& name) const { return (root_ / name).string(); }
  std::string cell() const { return path("cell"); }

  void write(const std::string& name, const std::string& text) const {
    std::ofstream(root_ / name, std::ios::binary) << text;
  }
  std::string read(const std::string& name) const {
    std::ifstream stream(root_ / name);
    std::ostringstream text;
    text << stream.rdbuf();
    return text.str();
  }
  /// Replaces the first 'old_text' of a file.
  void replace(const std::string& name, const std::string& old_text,
               const std::string& new_text) const {
    std::string text = read(name);
    const std::size_t at = text.find(old_text);
    if (at == std::string::npos) throw std::logic_error(name + " does not hold " + old_text);
    write(name, text.replace(at, old_text.size(), new_text));
  }

 private:
  fs::path root_;
};

}  // namespace surg_control_test
