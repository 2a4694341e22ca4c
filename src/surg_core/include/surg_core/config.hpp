// Schema of the YAML files: every key with unit, range and reason stands in src/config, for C++ and
// Python alike. files/document.hpp flattens a file into a Document; the functions here
// check it and return frozen values, or throw a ConfigError with file, key, value and allowed
// range.
#pragma once

#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "surg_core/kinematics/ur_kinematics.hpp"
#include "surg_core/kinematics/wrist.hpp"
#include "surg_core/limits/capsule.hpp"
#include "surg_core/limits/fixtures.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A value of a flat document.
using Value =
    std::variant<bool, double, std::string, std::vector<double>, std::vector<std::string>>;

/// A YAML file flattened: nested keys joined by '.', for example "limits.tip_velocity".
struct Document {
  std::string file;  ///< shown in every error
  std::map<std::string, Value> values;
  std::map<std::string, int> lines;  ///< 1-based line of each key where known
};

/// A configuration that must not be used: file, key, value, allowed range.
class ConfigError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// All limits of an arm. The schema contains the upper bound of each; a cell may only tighten them.
struct Limits {
  double tip_velocity;        ///< [m/s] per axis
  double tip_acceleration;    ///< [m/s^2] per axis
  double tip_jerk;            ///< [m/s^3] per axis
  double pivot_velocity;      ///< [rad/s] yaw and pitch, spherical mode
  double pivot_acceleration;  ///< [rad/s^2]
  double pivot_jerk;          ///< [rad/s^3]
  double roll_velocity;       ///< [rad/s]
  double roll_acceleration;   ///< [rad/s^2]
  double roll_jerk;           ///< [rad/s^3]
  double roll_max;            ///< [rad] largest roll from home, either way
  double flange_velocity;     ///< [m/s] speed of the flange origin
  double cone;                ///< [rad] largest angle between shaft and home axis
  double depth_min;           ///< [m] below: only axial motion and roll
  double depth_slow;          ///< [m] lateral motion fades from here to depth_min
  double depth_max;           ///< [m]
  double stop_deceleration;   ///< [m/s^2] of the tip when a stream falls silent
  double step_slack;          ///< [m] servo_cp step <= tip_velocity dt + this
  double step_roll_slack;     ///< [rad] and roll step <= roll_velocity dt + this
  double step_dt_max;         ///< [s] largest dt that counts in the step test
  double rcm_error_warn;      ///< [m]
  double rcm_error_fault;     ///< [m] F23
  double tip_force_soft;      ///< [N] F25: yields above, PAUSED after 0.1 s
  double tip_force_hard;      ///< [N] F25: FAULT, fade
  double trocar_force_warn;   ///< [N] load of the trocar
  double trocar_force_fault;  ///< [N] F25: FAULT, stop
  double joint_margin;        ///< [rad] joints slow down from this distance to their limit
};

/// Gains and times of the controller.
struct Tuning {
  double rcm_gain;           ///< [1/s] k of the lateral feedback
  double tip_gain;           ///< [1/s] tip set-point tracking
  double roll_gain;          ///< [1/s] absolute roll
  double posture_gain;       ///< [1/s] null-space pull to the home posture (redundant arms)
  double profiler_duration;  ///< [s] the paper's d
  double stream_delay;       ///< [s] largest delay with which a stream is followed
  double tremor;             ///< [Hz] centre of a hand's tremor to take out; 0: off
  double servo_timeout;      ///< [s] F03
  double link_timeout;       ///< [s] F10, free-run; of the link, see LinkConfig
  double link_lag;  ///< [s] from a velocity command to the motion it causes, of the slowest
                    ///< joint; 0: unknown
  double dead_man;  ///< [s] of the link, see LinkConfig
  double stop_deceleration;  ///< [rad/s^2] of the link, see LinkConfig
  double braking_least;      ///< of 'acceleration': what a joint brakes with when the robot stops
  double braking_most;       ///< by itself, at least and at most; `joints.braking`
  double track_noise;        ///< [m] rms per axis of a position on rcm/track
  double track_jerk;         ///< [m/s^3] that a breathing trocar reaches
  double track_timeout;      ///< [s] without a usable sample on rcm/track; then PAUSED
};

/// The command interface of a robot link.
enum class Command { kJointVelocity, kCartesianVelocity };

/// A capsule that moves with a link, in the frame behind joint 'joint'; -1: it stands with the
/// base. Those of an instrument are in the frame of its mount.
struct LinkCapsule {
  std::string name;
  int joint = -1;
  Capsule shape;
  bool shaft = false;  ///< the instrument's shaft, which enters the patient
};

/// One robot: its YAML.
struct RobotConfig {
  std::string file, name, urdf, base_link, flange_link;
  Command command;
  std::vector<std::string> joint_names;
  JointVector home, position_min, position_max, velocity, acceleration;
  Limits limits;
  Tuning tuning;
  JointVector joint_lag = {};  ///< [s] of each joint; empty: all have tuning.link_lag
  double elbow = std::numeric_limits<double>::quiet_NaN();  ///< [rad] preferred; NaN: none
  /// Each link lies inside its capsules. Empty: no clearance guard for this robot. No part of the
  /// black box, which has them in its clearance setup.
  std::vector<LinkCapsule> capsules = {};
};

/// A robot link's own parameters: its YAML, or those of the simulator.
struct LinkConfig {
  std::string name;
  double link_timeout, link_lag;  ///< [s] as in Tuning
  double acceleration;            ///< share of the robot's joint acceleration that it obeys
  double dead_man = 0.04;         ///< [s] without a command, after which it stops the arm
  double stop_deceleration = 20;  ///< [rad/s^2] of the leading joint in that stop
  std::string driver = {};        ///< folder with driver.py, relative to the YAML; empty: none
  JointVector joint_lag = {};     ///< [s] as in RobotConfig
};

/// The link that a cell names 'simulator'; it has no file.
constexpr const char* kSimulator = "simulator";

/// The cameras in an endoscope's tip: parallel, with the same intrinsics.
struct CameraConfig {
  /// URDF links, optical (x right, y down, z away): left and right, or one. Empty: no endoscope.
  std::vector<std::string> frames;
  double fovy = 0;      ///< [rad] vertical field of view
  double baseline = 0;  ///< [m] from left to right; 0 for one camera
};

/// The wrist of an instrument, and the drive that turns it.
struct WristConfig {
  WristGeometry geometry;
  /// Unit pitch axis in the flange frame, of the drawing (load_tool); only its turn about the shaft
  /// counts.
  Vector3 pitch_axis_F = Vector3::UnitY();
  DriveJoints min = DriveJoints::Zero(), max = DriveJoints::Zero();  ///< [rad]
  double velocity = 0;                                               ///< [rad/s] of each joint
  double acceleration = 0;                                           ///< [rad/s^2]
  double drive_lag = 0;  ///< [s] from a command to the motion that it causes
  /// Whether the drive has a motor for the roll; the arm keeps its own roll then.
  bool rolls() const { return min[2] < max[2]; }
  /// [rad/s^3] full acceleration in 20 ms: of a servo's current loop, assumed
  double jerk() const { return acceleration / 0.02; }
};

/// One instrument: its YAML. Jaw angles [rad]; 'closed' is jaw_min.
struct InstrumentConfig {
  std::string file, name, urdf, mount_link, tip_link;
  double jaw_min, jaw_max, jaw_velocity;  ///< all 0 without a jaw: it stays 0 whatever is commanded
  CameraConfig camera = {};               ///< no part of the black box: it moves nothing
  bool passive = false;  ///< no drive and no tool link; the jaw, if there is one, is fixed
  std::vector<LinkCapsule> capsules = {};  ///< in the mount's frame; 'shaft' enters the patient
  std::optional<WristConfig> wrist = {};   ///< none: the tip stands on the shaft's axis
};

/// The limits where the instrument's drive may turn the shaft: the arm's roll limits give way to
/// the drive's.
Limits with_roll_of(const InstrumentConfig& instrument, Limits limits);

/// Slows a drive that rolls, and narrows its roll, to limits that a cell has tightened.
void keep_roll_within(const Limits& limits, InstrumentConfig& instrument);

/// How good a calibration is, and where it is from.
struct Evidence {
  double residual, condition;
  int n;
  std::string date;
  std::string source = {};  ///< "measured", "simulated" or "computed"
  std::string serial = {};  ///< of the arm that it was measured with; empty: not stated
};

/// Calibrated tool: shaft axis and tip in the flange frame F.
struct ToolCalibration : Evidence {
  Vector3 s_F, p_FTip;
};

/// Taught trocar point in the robot base frame B.
struct TrocarCalibration : Evidence {
  Vector3 p_BRcm;
};

/// Where an arm's base was measured in the world; of no serial.
struct BaseCalibration : Evidence {
  Pose X_WB = Pose::Identity();
  /// Rotation first [rad^2, rad m, m^2]: of (theta, d) with R_true = exp([theta]) R and
  /// p_true = p + d, in the world's axes.
  Eigen::Matrix<double, 6, 6> covariance;
  std::string method;                    ///< "touch", "tip" or "points"
  std::string reference;                 ///< the cell's first arm, whose base is the stated one
  Vector3 reference_xyz, reference_rpy;  ///< that base, as the cell stated it then
  std::string camera_sha256;             ///< of the camera's file that it was seen through
  std::string file = {};
};

/// What a cell states of a real arm, or of an emulated one: nothing in it has a default.
struct CellHardware {
  std::string address;      ///< IPv4, private; on loopback: an emulator
  std::string serial;       ///< of the robot; another arm is refused
  double payload_mass = 0;  ///< [kg] that the robot must have set
  Vector3 payload_cog;      ///< [m] in the robot's flange frame
  std::string tool_link;    ///< "passive", "drive": drive_<arm>.yaml; "none": another node
  int realtime = 0;         ///< priority of the driver
  // Needed at a real address, unless it is being commissioned.
  int calibration_days = 0;  ///< [d] an older calibration is refused; 0: not stated
  /// [s] measured on this arm, of its slowest joint; NaN: not stated
  double link_lag = std::numeric_limits<double>::quiet_NaN();
  JointVector joint_lag = {};   ///< [s] of each joint; empty: all alike
  bool home_confirmed = false;  ///< somebody has seen the arm at its home posture
  /// The arm may move before all that is known, and slowly only (tighten).
  bool commissioning = false;
  bool emulated() const;  ///< whether the address is on loopback
};

/// One arm of a cell, as cell.yaml states it.
struct CellArm {
  std::string name;        ///< CRTK name, e.g. "PSM1"
  std::string robot;       ///< path of the robot YAML, relative to the cell file
  std::string instrument;  ///< path of the instrument YAML, relative to the cell file
  std::string link;        ///< "simulator", or a link's YAML: a name, or a path that ends in .yaml
  Vector3 base_xyz, base_rpy;            ///< X_WB as stated; the simulator builds it there
  std::vector<double> home;              ///< [rad] instead of the robot's; empty: the robot's
  std::map<std::string, double> limits;  ///< tightened limits by name
  /// [rad] preferred swivel angle of a seven-joint arm's elbow; NaN: none
  double elbow = std::numeric_limits<double>::quiet_NaN();
  std::vector<Fixture> fixtures = {};         ///< virtual fixtures, in the robot's base frame
  std::optional<CellHardware> hardware = {};  ///< of an arm that is not simulated
  /// "file:line" of the values above, for errors: "home", "limits.cone".
  std::map<std::string, std::string> where = {};
};

/// A fixed body that all arms keep clear of, in the world: a capsule or a half-space.
struct Obstacle {
  std::string name;
  bool half_space = false;
  Capsule capsule;
  HalfSpace space;
};

/// The distances that the arms of a cell keep.
struct CellClearance {
  double distance = 0.02;  ///< [m] of an arm to other arms and obstacles
  double shafts = 0;       ///< [m] between two shafts; 0: they may touch
  std::vector<Obstacle> obstacles;
  int line = 0;  ///< of the section in the file; 0: the values above are the defaults
};

/// The source of a real endoscope's pictures.
struct CellEndoscope {
  std::string source;         ///< URI such as "v4l2:/dev/video0"
  std::string layout;         ///< of the eyes in a grabbed picture: "two", "sbs", ...
  int width = 0, height = 0;  ///< [px] of a grabbed picture; 0: as the device has it
  double rate = 0;            ///< [1/s]; 0: as the device has it
  bool swap = false;          ///< the left eye comes where the layout has the right one
  std::string flip = "none";  ///< of each eye: "none", "horizontal", "vertical", "rotate_180"
  double latency = 0;         ///< [s] from glass to stamp; subtracted from every stamp
};

/// A complete system: arms, machines, network.
struct CellConfig {
  std::string file, name;
  std::string network;  ///< "loopback": no port leaves this machine; "isolated": see machines
  /// IPv4 address on the isolated network by role: "robot", "operator", "endoscope". Empty: one
  /// machine.
  std::map<std::string, std::string> machines;
  std::vector<CellArm> arms;  ///< in the file's order
  CellClearance clearance = {};
  std::optional<CellEndoscope> endoscope = {};  ///< none: the simulator's
};

/// With the simulator's link; see with_link.
RobotConfig parse_robot(const Document& document);
LinkConfig parse_link(const Document& document);
LinkConfig simulator_link();
InstrumentConfig parse_instrument(const Document& document);
ToolCalibration parse_tool(const Document& document);
TrocarCalibration parse_trocar(const Document& document);
CellConfig parse_cell(const Document& document);

UrKinematics parse_kinematics(const Document& document);
BaseCalibration parse_base(const Document& document);

/// Returns the limits with a cell's values applied. Throws if a value would loosen a limit. An arm
/// that is being commissioned moves slowly.
Limits tighten(const Limits& limits, const CellArm& arm, const std::string& cell_file);

/// Returns the robot with the cell's home posture and elbow. Throws if they do not fit the joints.
RobotConfig with_home(const RobotConfig& robot, const CellArm& arm, const std::string& cell_file);

/// Returns the link with the lag that the cell states of this arm.
LinkConfig with_measured_lag(const LinkConfig& link, const CellArm& arm);

/// Returns the robot as this link drives it.
RobotConfig with_link(const RobotConfig& robot, const LinkConfig& link);

/// Returns the file of a link other than the simulator, relative to the cell's folder if it is a
/// path and to the folder 'links' beside the robot's folder if it is a name.
std::string link_file(const CellArm& arm);
/// The error where that file, looked for as 'tried', does not exist.
std::string unknown_link(const CellArm& arm, const std::string& cell_file,
                         const std::string& tried);

/// Throws if what the cell states of a real arm does not fit the arm: its joints, its instrument,
/// and calibrations that nobody has measured, that are too old or of another arm.
/// today: such as "2026-11-23".
void check_hardware(const CellArm& arm, const RobotConfig& robot,
                    const InstrumentConfig& instrument, const ToolCalibration& tool,
                    const TrocarCalibration& trocar, const std::string& cell_file,
                    const std::string& today);

/// Throws if an arm's own kinematics are of another arm or model.
void check_kinematics(const UrKinematics& own, const CellArm& arm, const RobotConfig& robot);

/// Throws if the base was not measured against the cell's first arm as it is stated now, or if the
/// arm is that first arm, or if a real arm has a base that nobody measured.
void check_base(const BaseCalibration& base, const CellArm& arm, const CellConfig& cell);

/// Throws if an instrument's tip could go deeper than its shaft is long.
void check_tool(const ToolCalibration& tool, const Limits& limits, const std::string& tool_file);

/// Fingerprint of all values above that affect motion: FNV-1a over the values, as 16 hex digits.
std::string limits_hash(const RobotConfig& robot, const Limits& limits);

}  // namespace surg
