#include "surg_core/files/arm_setup.hpp"

#include <cmath>
#include <ctime>
#include <filesystem>
#include <iterator>
#include <sstream>
#include <stdexcept>

#include "files/text_file.hpp"
#include "surg_core/files/document.hpp"

namespace surg {
namespace {

namespace fs = std::filesystem;
using files::beside;
using files::refuse;

constexpr double kLengthOff = 1e-4;  // [m] of a wrist's link between YAML and URDF
constexpr double kAxisOff = 1e-3;    // of a wrist's unit axis in its URDF
constexpr double kTipOff =
    0.02;  // [m] of a calibrated tip from its drawing; a clamp holds to some mm

/// Rz(yaw) Ry(pitch) Rx(roll), to the last bit as surg_core.transforms.
Pose pose_from_xyz_rpy(const Vector3& xyz, const Vector3& rpy) {
  const double cr = std::cos(rpy.x()), sr = std::sin(rpy.x());
  const double cp = std::cos(rpy.y()), sp = std::sin(rpy.y());
  const double cy = std::cos(rpy.z()), sy = std::sin(rpy.z());
  Pose X = Pose::Identity();
  X.linear() << cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,  //
      sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,            //
      -sp, cp * sr, cp * cr;
  X.translation() = xyz;
  return X;
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

CellArm find_arm(const CellConfig& cell, const std::string& name) {
  std::string known;
  for (const CellArm& arm : cell.arms) {
    if (arm.name == name || (name.empty() && cell.arms.size() == 1)) return arm;
    known += (known.empty() ? "" : ", ") + arm.name;
  }
  if (name.empty()) refuse(cell.file, 0, "has several arms (" + known + "): name the one to drive");
  refuse(cell.file, 0, "has no arm '" + name + "'; it has: " + known);
}

std::string calibration_file(const ArmSetup& setup, const std::string& what) {
  return beside(setup.cell_file, "calibration/" + what + "_" + setup.arm.name + ".yaml");
}

bool exists(const std::string& file) {
  std::error_code error;
  return fs::exists(file, error);
}

/// A file that the cell names. A cell that was copied to another folder takes its relative paths
/// along.
std::string named_file(const ArmSetup& setup, const Document& cell, const std::string& key,
                       const std::string& name) {
  const std::string file = beside(setup.cell_file, name);
  if (exists(file)) return file;
  const std::string dotted = "arms." + setup.arm.name + "." + key;
  refuse(cell.file, cell.lines.at(dotted),
         dotted + ": '" + name + "': there is no " + file +
             "; a relative path starts at the cell's folder. In a cell that was copied, write the "
             "file's absolute path");
}

/// The link's parameters, and what its driver gets.
void read_link(ArmSetup& setup) {
  setup.link = simulator_link();
  if (setup.arm.link == kSimulator) return;
  const std::string file = beside(setup.cell_file, link_file(setup.arm));
  std::error_code error;
  if (!fs::is_regular_file(file, error)) {
    throw ConfigError(unknown_link(setup.arm, setup.cell_file, file));
  }
  const Document document = load_document(file);
  setup.link = with_measured_lag(parse_link(document), setup.arm);
  if (!setup.link.driver.empty()) setup.driver = beside(file, setup.link.driver);
  const std::string settings = "settings.";
  for (const auto& [key, value] : document.values) {
    if (key.rfind(settings, 0) == 0) setup.link_settings[key.substr(settings.size())] = value;
  }
}

/// Where the arm's base is: as measured where there is a file, else as the cell states it.
void read_base(const CellConfig& cell, ArmSetup& setup) {
  setup.X_WB = setup.X_WB_stated = pose_from_xyz_rpy(setup.arm.base_xyz, setup.arm.base_rpy);
  const std::string file = calibration_file(setup, "base");
  if (!exists(file)) return;
  const BaseCalibration base = parse_base(load_document(file));
  check_base(base, setup.arm, cell);
  setup.X_WB = base.X_WB;
}

/// Puts the arm's own kinematics into the chain, where the cell has their file.
void read_kinematics(ArmSetup& setup) {
  const std::string file = calibration_file(setup, "kinematics");
  if (!exists(file)) return;
  setup.kinematics = parse_kinematics(load_document(file));
  check_kinematics(*setup.kinematics, setup.arm, setup.robot);
  try {
    setup.model.chain = with_kinematics(setup.model.chain, *setup.kinematics);
  } catch (const std::invalid_argument& error) {
    refuse(file, 0, error.what());
  }
}

/// The tip of an instrument by its drawing, in the flange frame [m].
Vector3 drawn_tip(const InstrumentConfig& instrument, const std::string& urdf) {
  try {
    return fixed_transform(load_urdf(urdf), instrument.mount_link, instrument.tip_link)
        .translation();
  } catch (const ConfigError& error) {
    throw ConfigError(instrument.file + ": urdf: " + error.what());
  }
}

/// Whether a roll joint turns about z of its frame, on which the pitch axis stands.
bool along_shaft(const Pose& X_MRoll, const Vector3& axis, const Pose& X_MPitch) {
  const Pose X_RollPitch = X_MRoll.inverse() * X_MPitch;
  return axis.isApprox(Vector3::UnitZ(), kAxisOff) &&
         X_RollPitch.translation().head<2>().norm() <= kLengthOff &&
         X_RollPitch.linear().col(2).isApprox(Vector3::UnitZ(), kAxisOff);
}

/// Refuses a wrist that the drawing shows otherwise: the simulator and the pictures have that one.
/// Takes its pitch axis from the drawing.
void check_wrist(InstrumentConfig& instrument, const std::string& urdf) {
  const Urdf drawing = load_urdf(urdf);
  const std::vector<UrdfJoint> way =
      joints_between(drawing, instrument.mount_link, instrument.tip_link);
  std::vector<std::string> turning;
  std::vector<Pose> X_MountJoint;
  std::vector<Vector3> axes;
  Pose X = Pose::Identity();
  for (const UrdfJoint& joint : way) {
    X = X * joint.X_PJ;
    if (!joint.turning()) continue;
    turning.push_back(joint.name);
    X_MountJoint.push_back(X);
    axes.push_back(joint.axis);
  }
  if (!instrument.wrist) {
    if (turning.empty()) return;
    refuse(instrument.file, 0,
           "wrist: none is stated, but " + urdf + " has joint '" + turning.front() +
               "' on the way to the tip: state the wrist, or make the joint fixed");
  }
  const std::size_t pitch = instrument.wrist->rolls() ? 1 : 0;
  const std::vector<std::string> needed(kWristJoints.end() - 2 - pitch, kWristJoints.end());
  const bool shaped = turning == needed && axes[pitch].isApprox(Vector3::UnitY(), kAxisOff) &&
                      axes[pitch + 1].isApprox(Vector3::UnitX(), kAxisOff) &&
                      (pitch == 0 || along_shaft(X_MountJoint[0], axes[0], X_MountJoint[1]));
  if (!shaped) {
    refuse(instrument.file, 0,
           "wrist: " + urdf + " needs the joints " +
               (pitch == 0 ? "" : "wrist_roll (axis 0 0 1, along the shaft), ") +
               "wrist_pitch (axis 0 1 0) and wrist_yaw (axis 1 0 0), in this order, on the way "
               "from '" +
               instrument.mount_link + "' to '" + instrument.tip_link + "'" +
               (turning.empty() || turning[0] != kWristJoints[0] || pitch == 1
                    ? ""
                    : "; it draws wrist_roll: state wrist.roll"));
  }
  const WristGeometry& stated = instrument.wrist->geometry;
  const Vector3 link = X_MountJoint[pitch].inverse() * X_MountJoint[pitch + 1].translation();
  const Vector3 tip = X_MountJoint[pitch + 1].inverse() * X.translation();
  const auto compare = [&](const char* key, double says, const Vector3& drawn) {
    if ((drawn - says * Vector3::UnitZ()).norm() <= kLengthOff) return;
    refuse(instrument.file, 0,
           std::string("wrist.") + key + ": says " + std::to_string(says) + " m; " + urdf +
               " draws " + std::to_string(drawn.z()) + " m along z and " +
               std::to_string(drawn.head<2>().norm()) + " m beside it: make both equal");
  };
  compare("pitch_to_yaw", stated.pitch_to_yaw, link);
  compare("yaw_to_tip", stated.yaw_to_tip, tip);
  instrument.wrist->pitch_axis_F = X_MountJoint[pitch].linear() * axes[pitch];
}

/// Refuses a real arm whose tool was calibrated with another instrument.
void check_instrument(const CellArm& arm, const MountedTool& mounted, const Vector3& p_FTip,
                      const std::string& tool_file) {
  const std::optional<CellHardware>& hardware = arm.hardware;
  if (!hardware || hardware->emulated() || hardware->commissioning) return;
  const double away = (mounted.tool.p_FTip - p_FTip).norm();
  if (away <= kTipOff) return;
  const auto millimetres = [](double metres) { return std::to_string(std::lround(1e3 * metres)); };
  throw ConfigError("arms." + arm.name + ".hardware: " + tool_file + ": the tip is " +
                    millimetres(away) + " mm from that of " + mounted.instrument.file +
                    "; allowed are " + millimetres(kTipOff) +
                    " mm. Another instrument was calibrated: name it in the cell, or calibrate "
                    "this one: ./surg calibrate CELL tool");
}

/// Refuses an instrument that this arm cannot change to while it runs.
void check_change(const ArmSetup& setup, const InstrumentConfig& next) {
  const MountedTool& first = setup.mounted;
  if (first.instrument_file.empty()) return;
  if (next.passive != first.instrument.passive) {
    refuse(next.file, 0,
           "passive: the arm started with an instrument that " +
               std::string(first.instrument.passive ? "nobody drives" : "a tool link drives") +
               ", and keeps to that: start it again");
  }
  if (next.wrist.has_value() != first.instrument.wrist.has_value()) {
    refuse(next.file, 0,
           "wrist: the arm started with an instrument " +
               std::string(first.instrument.wrist ? "that has one" : "without one") +
               ", and its commands have as many joints: start it again");
  }
  if (next.wrist && next.wrist->rolls() != first.instrument.wrist->rolls()) {
    refuse(next.file, 0,
           "wrist.roll: the arm started with an instrument whose drive has " +
               std::string(next.wrist->rolls() ? "none" : "one") +
               ", and its limits are made for it: start it again");
  }
  const bool guarded = setup.arms_in_cell.size() > 1 || !setup.clearance.obstacles.empty();
  if (guarded && next.file != first.instrument.file) {
    refuse(next.file, 0,
           "another instrument than " + first.instrument_file +
               ": the clearance guard of this cell knows that one only. Start the system with the "
               "new one; another calibration of the same instrument may be mounted");
  }
}

}  // namespace

std::string cell_file_of(const std::string& cell) {
  if (cell.empty()) throw ConfigError("no cell given: name a cell folder or its cell.yaml");
  std::error_code error;
  const fs::path path = fs::absolute(cell).lexically_normal();
  return fs::is_directory(path, error) ? (path / "cell.yaml").string() : path.string();
}

ArmSetup load_arm(const std::string& cell, const std::string& arm_name) {
  ArmSetup setup;
  setup.cell_file = cell_file_of(cell);
  const Document document = load_document(setup.cell_file);
  const CellConfig config = parse_cell(document);
  setup.cell_name = config.name;
  for (const CellArm& arm : config.arms) setup.arms_in_cell.push_back(arm.name);
  setup.clearance = config.clearance;
  setup.arm = find_arm(config, arm_name);
  const CellArm& arm = setup.arm;
  const std::string robot_file = named_file(setup, document, "robot", arm.robot);
  named_file(setup, document, "instrument", arm.instrument);
  setup.robot = with_home(parse_robot(load_document(robot_file)), arm, setup.cell_file);
  read_link(setup);
  setup.robot = with_link(setup.robot, setup.link);
  setup.robot_urdf = urdf_of(setup.robot);
  setup.model = load_model(setup.robot);
  const std::string instrument_file = beside(setup.cell_file, arm.instrument);
  const InstrumentConfig instrument = parse_instrument(load_document(instrument_file));
  setup.limits = tighten(with_roll_of(instrument, setup.robot.limits), arm, setup.cell_file);
  setup.mounted = load_tool(setup, "");
  setup.trocar = parse_trocar(load_document(calibration_file(setup, "trocar")));
  check_hardware(arm, setup.robot, setup.mounted.instrument, setup.mounted.tool, setup.trocar,
                 setup.cell_file, today());
  read_kinematics(setup);
  read_base(config, setup);
  return setup;
}

MountedTool load_tool(const ArmSetup& setup, const std::string& words) {
  std::istringstream stream(words);
  std::vector<std::string> files{std::istream_iterator<std::string>(stream), {}};
  const std::string of_cell = "calibration/tool_" + setup.arm.name + ".yaml";
  if (files.size() > 2) {
    throw ConfigError("'" + words +
                      "' has more than two words; allowed are an instrument's YAML and its "
                      "calibration file, relative to the cell's folder");
  }
  const std::string& cell_file = setup.cell_file;
  MountedTool tool;
  tool.instrument_file = files.empty() ? setup.arm.instrument : files[0];
  const std::string instrument_file = beside(cell_file, tool.instrument_file);
  if (files.size() == 1 && instrument_file != beside(cell_file, setup.arm.instrument)) {
    throw ConfigError("'" + words + "' is not the cell's instrument, to which " + of_cell +
                      " belongs: name its calibration file as a second word");
  }
  tool.calibration_file = files.size() == 2 ? files[1] : of_cell;
  tool.instrument = parse_instrument(load_document(instrument_file));
  check_change(setup, tool.instrument);
  keep_roll_within(setup.limits, tool.instrument);
  const std::string tool_file = beside(cell_file, tool.calibration_file);
  tool.tool = parse_tool(load_document(tool_file));
  check_tool(tool.tool, setup.limits, tool_file);
  tool.instrument_urdf = beside(instrument_file, tool.instrument.urdf);
  const Vector3 p_FTip = drawn_tip(tool.instrument, tool.instrument_urdf);
  check_wrist(tool.instrument, tool.instrument_urdf);
  check_instrument(setup.arm, tool, p_FTip, tool_file);
  return tool;
}

}  // namespace surg
