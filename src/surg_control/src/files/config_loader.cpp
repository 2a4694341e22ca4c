#include "surg_control/files/config_loader.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>
#include <sstream>
#include <vector>

namespace surg_control {
namespace {

namespace fs = std::filesystem;

// A configuration is a page of text. The bounds keep a wrong path (a video, /dev/zero) and nested
// nonsense from taking the machine down before the schema is asked.
constexpr std::uintmax_t kMaxBytes = 1 << 20;
constexpr int kMaxDepth = 16;
constexpr std::size_t kMaxKeys = 10000;

int line_of(const YAML::Node& node) { return node.Mark().line + 1; }

[[noreturn]] void refuse(const std::string& file, int line, const std::string& what) {
  throw surg::ConfigError(file + (line > 0 ? ":" + std::to_string(line) : "") + ": " + what);
}

/// A plain scalar as a number: decimal, with or without exponent, or YAML's .inf and .nan.
std::optional<double> as_number(std::string_view text) {
  const bool negative = !text.empty() && text.front() == '-';
  if (text == ".nan" || text == ".NaN" || text == ".NAN") {
    return std::numeric_limits<double>::quiet_NaN();
  }
  if (!text.empty() && (text.front() == '+' || negative)) text.remove_prefix(1);
  // from_chars would also take "inf" and "nan", which are words in YAML.
  if (text.empty() || (text.front() != '.' && (text.front() < '0' || text.front() > '9')))
    return {};
  double value = 0;
  if (text == ".inf" || text == ".Inf" || text == ".INF") {
    value = std::numeric_limits<double>::infinity();
  } else {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error == std::errc::invalid_argument || end != text.data() + text.size()) return {};
    // Beyond any double: infinite here, so that the schema refuses it with the key's own range.
    if (error == std::errc::result_out_of_range) value = std::numeric_limits<double>::infinity();
  }
  return negative ? -value : value;
}

/// A scalar by the rules that surg_core's Python reader has too: one file means one thing.
surg::Value as_scalar(const YAML::Node& node) {
  const std::string& text = node.Scalar();
  if (node.Tag() == "!") return text;  // quoted: a string, whatever it looks like
  std::string lower = text;
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (lower == "true" || lower == "false") return lower == "true";
  if (const std::optional<double> number = as_number(text)) return *number;
  return text;
}

surg::Value as_sequence(const YAML::Node& node, const std::string& file, const std::string& key) {
  std::vector<double> numbers;
  std::vector<std::string> strings;
  for (const YAML::Node& item : node) {
    const surg::Value value = item.IsScalar() ? as_scalar(item) : surg::Value(false);
    if (const double* number = std::get_if<double>(&value)) numbers.push_back(*number);
    if (const std::string* text = std::get_if<std::string>(&value)) strings.push_back(*text);
  }
  if (numbers.size() == node.size()) return numbers;
  if (strings.size() == node.size()) return strings;
  refuse(file, line_of(node), key + ": a list may hold numbers or texts, all of one kind");
}

void flatten(const YAML::Node& node, const std::string& prefix, int depth, surg::Document& out) {
  if (depth > kMaxDepth) refuse(out.file, line_of(node), "nested more than 16 levels deep");
  for (const auto& entry : node) {
    if (!entry.first.IsScalar() || entry.first.Scalar().empty()) {
      refuse(out.file, line_of(entry.first), "a key must be a word");
    }
    const std::string& word = entry.first.Scalar();
    const std::string key = prefix.empty() ? word : prefix + "." + word;
    const int line = line_of(entry.first);
    if (word.find('.') != std::string::npos) {
      refuse(out.file, line,
             word + ": a key must be a text without dots; write nested keys instead");
    }
    if (out.lines.count(key) != 0) {
      refuse(out.file, line,
             key + ": is said twice; first in line " + std::to_string(out.lines[key]));
    }
    if (out.lines.size() >= kMaxKeys) refuse(out.file, line, "more than 10000 keys");
    out.lines[key] = line;
    const YAML::Node& value = entry.second;
    if (value.IsMap()) {
      flatten(value, key, depth + 1, out);
    } else if (value.IsSequence()) {
      out.values[key] = as_sequence(value, out.file, key);
    } else if (value.IsScalar()) {
      out.values[key] = as_scalar(value);
    } else {
      refuse(out.file, line, key + ": is empty; a value is needed");
    }
  }
}

std::string read_text(const std::string& path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) refuse(path, 0, "no such file");
  if (!fs::is_regular_file(status)) refuse(path, 0, "is not a file");
  const std::uintmax_t size = fs::file_size(path, error);
  if (error || size > kMaxBytes) refuse(path, 0, "is larger than 1 MiB: not a configuration");
  std::ifstream stream(path, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  if (!stream) refuse(path, 0, "cannot be read");
  return text.str();
}

/// 'path' as seen from the folder of 'file'.
std::string beside(const std::string& file, const std::string& path) {
  return (fs::path(file).parent_path() / path).lexically_normal().string();
}

surg::Pose pose_from_xyz_rpy(const surg::Vector3& xyz, const surg::Vector3& rpy) {
  surg::Pose X = surg::Pose::Identity();
  X.linear() = (Eigen::AngleAxisd(rpy.z(), surg::Vector3::UnitZ()) *
                Eigen::AngleAxisd(rpy.y(), surg::Vector3::UnitY()) *
                Eigen::AngleAxisd(rpy.x(), surg::Vector3::UnitX()))
                   .toRotationMatrix();
  X.translation() = xyz;
  return X;
}

surg::LinkConfig load_link(const surg::CellArm& arm, const std::string& cell_file) {
  if (arm.link == surg::kSimulator) return surg::simulator_link();
  const std::string file = beside(cell_file, surg::link_file(arm));
  std::error_code error;
  if (!fs::is_regular_file(file, error)) {
    throw surg::ConfigError(surg::unknown_link(arm, cell_file, file));
  }
  return surg::with_measured_lag(surg::parse_link(load_document(file)), arm);
}

/// Where the arm's base is: as measured where there is a file, else as the cell states it.
surg::Pose load_base(const surg::CellConfig& cell, const surg::CellArm& arm) {
  const std::string file = beside(cell.file, "calibration/base_" + arm.name + ".yaml");
  std::error_code error;
  if (!fs::exists(file, error)) return pose_from_xyz_rpy(arm.base_xyz, arm.base_rpy);
  const surg::BaseCalibration base = surg::parse_base(load_document(file));
  surg::check_base(base, arm, cell);
  return base.X_WB;
}

/// Such as 2026-11-23, in local time.
std::string today() {
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  localtime_r(&now, &local);
  char text[11];
  std::strftime(text, sizeof text, "%Y-%m-%d", &local);
  return text;
}

surg::CellArm find_arm(const surg::CellConfig& cell, const std::string& name) {
  std::string known;
  for (const surg::CellArm& arm : cell.arms) {
    if (arm.name == name || (name.empty() && cell.arms.size() == 1)) return arm;
    known += (known.empty() ? "" : ", ") + arm.name;
  }
  if (name.empty()) refuse(cell.file, 0, "has several arms (" + known + "): name the one to drive");
  refuse(cell.file, 0, "has no arm '" + name + "'; it has: " + known);
}

}  // namespace

surg::Document load_document(const std::string& path) {
  surg::Document document;
  document.file = path;
  std::vector<YAML::Node> roots;
  try {
    roots = YAML::LoadAll(read_text(path));
    if (roots.empty() || roots.front().IsNull()) refuse(path, 0, "is empty");
    if (roots.size() > 1) refuse(path, 0, "holds several YAML documents: keep one");
    if (!roots.front().IsMap()) refuse(path, 1, "is not a mapping; 'key: value' lines are needed");
    flatten(roots.front(), "", 0, document);
  } catch (const YAML::Exception& error) {
    refuse(path, error.mark.is_null() ? 0 : error.mark.line + 1, "YAML syntax: " + error.msg);
  }
  return document;
}

ArmSetup load_arm(const std::string& cell, const std::string& arm_name) {
  if (cell.empty()) throw surg::ConfigError("no cell given: name a cell folder or its cell.yaml");
  std::error_code error;
  const fs::path path = fs::absolute(cell).lexically_normal();
  const std::string cell_file =
      fs::is_directory(path, error) ? (path / "cell.yaml").string() : path.string();
  const surg::CellConfig config = surg::parse_cell(load_document(cell_file));

  ArmSetup setup;
  setup.cell_name = config.name;
  setup.cell_file = cell_file;
  for (const surg::CellArm& arm : config.arms) setup.arms_in_cell.push_back(arm.name);
  setup.clearance = config.clearance;
  setup.arm = find_arm(config, arm_name);
  const std::string& name = setup.arm.name;
  setup.X_WB = load_base(config, setup.arm);
  const std::string robot_file = beside(cell_file, setup.arm.robot);
  setup.robot = surg::with_home(surg::parse_robot(load_document(robot_file)), setup.arm, cell_file);
  setup.robot = surg::with_link(setup.robot, load_link(setup.arm, cell_file));
  setup.limits = surg::tighten(setup.robot.limits, setup.arm, cell_file);
  setup.mounted = load_tool(setup, "");
  setup.trocar =
      surg::parse_trocar(load_document(beside(cell_file, "calibration/trocar_" + name + ".yaml")));
  setup.robot_urdf = beside(robot_file, setup.robot.urdf);
  surg::check_hardware(setup.arm, setup.robot, setup.mounted.instrument, setup.mounted.tool,
                       setup.trocar, cell_file, today());
  const std::string kinematics = beside(cell_file, "calibration/kinematics_" + name + ".yaml");
  if (fs::exists(kinematics, error)) {
    setup.kinematics = surg::parse_kinematics(load_document(kinematics));
    surg::check_kinematics(*setup.kinematics, setup.arm, setup.robot);
  }
  return setup;
}

MountedTool load_tool(const ArmSetup& setup, const std::string& words) {
  std::istringstream stream(words);
  std::vector<std::string> files{std::istream_iterator<std::string>(stream), {}};
  const std::string of_cell = "calibration/tool_" + setup.arm.name + ".yaml";
  if (files.size() > 2) {
    throw surg::ConfigError("'" + words +
                            "' has more than two words; allowed are an instrument's YAML and its "
                            "calibration file, relative to the cell's folder");
  }
  const std::string& cell_file = setup.cell_file;
  MountedTool tool;
  tool.instrument_file = files.empty() ? setup.arm.instrument : files[0];
  const std::string instrument_file = beside(cell_file, tool.instrument_file);
  if (files.size() == 1 && instrument_file != beside(cell_file, setup.arm.instrument)) {
    throw surg::ConfigError("'" + words + "' is not the cell's instrument, to which " + of_cell +
                            " belongs: name its calibration file as a second word");
  }
  tool.calibration_file = files.size() == 2 ? files[1] : of_cell;
  tool.instrument = surg::parse_instrument(load_document(instrument_file));
  const MountedTool& first = setup.mounted;
  if (!first.instrument_file.empty() && tool.instrument.passive != first.instrument.passive) {
    refuse(instrument_file, 0,
           "passive: the arm started with an instrument that " +
               std::string(first.instrument.passive ? "nobody drives" : "a tool link drives") +
               ", and keeps to that: start it again");
  }
  const bool guarded = setup.arms_in_cell.size() > 1 || !setup.clearance.obstacles.empty();
  if (guarded && !first.instrument_file.empty() && tool.instrument.file != first.instrument.file) {
    refuse(instrument_file, 0,
           "another instrument than " + first.instrument_file +
               ": the clearance guard of this cell knows that one only. Start the system with the "
               "new one; another calibration of the same instrument may be mounted");
  }
  const std::string tool_file = beside(cell_file, tool.calibration_file);
  tool.tool = surg::parse_tool(load_document(tool_file));
  surg::check_tool(tool.tool, setup.limits, tool_file);
  tool.instrument_urdf = beside(instrument_file, tool.instrument.urdf);
  std::error_code error;
  if (!fs::is_regular_file(tool.instrument_urdf, error)) {
    refuse(instrument_file, 0, "urdf: " + tool.instrument_urdf + " is not a file");
  }
  return tool;
}

}  // namespace surg_control
