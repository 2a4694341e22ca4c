// Robots, links and instruments: their YAML files, limits and hash.
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "document_reader.hpp"
#include "surg_core/config_keys.hpp"

namespace surg {

using namespace config;

const std::vector<Key<Limits>>& config::limit_keys() {
  static constexpr Key<Limits> kKeys[]{
      {"tip_velocity", &Limits::tip_velocity, 1e-3, 0.5, "m/s"},
      {"tip_acceleration", &Limits::tip_acceleration, 1e-2, 10.0, "m/s^2"},
      {"tip_jerk", &Limits::tip_jerk, 0.1, 400.0, "m/s^3"},
      {"pivot_velocity", &Limits::pivot_velocity, 1e-2, 3.0, "rad/s"},
      {"pivot_acceleration", &Limits::pivot_acceleration, 0.1, 80.0, "rad/s^2"},
      {"pivot_jerk", &Limits::pivot_jerk, 1.0, 3000.0, "rad/s^3"},
      {"roll_velocity", &Limits::roll_velocity, 1e-2, 6.0, "rad/s"},
      {"roll_acceleration", &Limits::roll_acceleration, 0.1, 100.0, "rad/s^2"},
      {"roll_jerk", &Limits::roll_jerk, 1.0, 5000.0, "rad/s^3"},
      {"roll_max", &Limits::roll_max, 0.5, 6.3, "rad"},
      {"flange_velocity", &Limits::flange_velocity, 1e-3, 0.5, "m/s"},
      {"cone", &Limits::cone, 0.05, 1.3, "rad"},
      {"depth_min", &Limits::depth_min, 0.01, 0.1, "m", Tighter::kLarger},
      {"depth_slow", &Limits::depth_slow, 0.015, 0.15, "m", Tighter::kLarger},
      {"depth_max", &Limits::depth_max, 0.05, 0.4, "m"},
      {"stop_deceleration", &Limits::stop_deceleration, 0.5, 20.0, "m/s^2", Tighter::kLarger},
      {"step_slack", &Limits::step_slack, 1e-4, 0.005, "m"},
      {"step_roll_slack", &Limits::step_roll_slack, 1e-3, 0.1, "rad"},
      {"step_dt_max", &Limits::step_dt_max, 0.002, 0.2, "s"},
      {"rcm_error_warn", &Limits::rcm_error_warn, 1e-5, 0.002, "m"},
      {"rcm_error_fault", &Limits::rcm_error_fault, 1e-4, 0.005, "m"},
      {"tip_force_soft", &Limits::tip_force_soft, 0.1, 10.0, "N"},
      {"tip_force_hard", &Limits::tip_force_hard, 0.2, 15.0, "N"},
      {"trocar_force_warn", &Limits::trocar_force_warn, 0.1, 20.0, "N"},
      {"trocar_force_fault", &Limits::trocar_force_fault, 0.2, 30.0, "N"},
      {"joint_margin", &Limits::joint_margin, 0.01, 0.5, "rad", Tighter::kLarger},
  };
  static_assert(sizeof kKeys / sizeof *kKeys * sizeof(double) == sizeof(Limits), "all of them");
  static const std::vector<Key<Limits>> kAll(std::begin(kKeys), std::end(kKeys));
  return kAll;
}

const std::vector<Key<Tuning>>& config::tuning_keys() {
  static const std::vector<Key<Tuning>> kKeys{
      // 150 /s diverged against 10 ms of delay; the ceiling leaves a factor of two.
      {"rcm_gain", &Tuning::rcm_gain, 1.0, 75.0, "1/s"},
      {"tip_gain", &Tuning::tip_gain, 0.0, 50.0, "1/s"},
      {"roll_gain", &Tuning::roll_gain, 0.0, 50.0, "1/s"},
      {"posture_gain", &Tuning::posture_gain, 0.0, 10.0, "1/s"},
      {"profiler_duration", &Tuning::profiler_duration, 0.05, 5.0, "s"},
      {"stream_delay", &Tuning::stream_delay, 0.0, 0.1, "s"},
      {"tremor", &Tuning::tremor, 0.0, 20.0, "Hz"},
      {"servo_timeout", &Tuning::servo_timeout, 0.02, 0.5, "s"},
      {"track_noise", &Tuning::track_noise, 1e-5, 0.001, "m"},
      {"track_jerk", &Tuning::track_jerk, 0.001, 1.0, "m/s^3"},
      {"track_timeout", &Tuning::track_timeout, 0.05, 0.5, "s"},
  };
  return kKeys;
}

namespace {

constexpr double kMostTurned = 8 * M_PI;  // [rad] four turns of a joint

/// Limits that must increase, whoever set them.
struct IncreasingLimits {
  const char *lower, *upper;
};
constexpr IncreasingLimits kIncreasingLimits[] = {
    {"depth_min", "depth_slow"},
    {"depth_slow", "depth_max"},
    {"rcm_error_warn", "rcm_error_fault"},
    {"tip_force_soft", "tip_force_hard"},
    {"trocar_force_warn", "trocar_force_fault"},
};

/// where: file, line and key of a limit, by its name; empty if it is stated elsewhere.
void check_limits(const Limits& limits,
                  const std::function<std::string(const std::string&)>& where) {
  for (const auto& [lower, upper] : kIncreasingLimits) {
    const Key<Limits>&low = *find_limit(lower), &high = *find_limit(upper);
    const double least = limits.*low.member, most = limits.*high.member;
    if (least < most) continue;
    const std::string below = where(lower), above = where(upper);
    const std::string at = !below.empty() ? below : above;
    const std::string other = !below.empty() && !above.empty() ? " (" + above + ")" : "";
    throw ConfigError(at + ": " + lower + " " + number(least) + " " + low.unit + " must be below " +
                      upper + " " + number(most) + " " + high.unit + other);
  }
}

CameraConfig read_camera(Reader& reader) {
  CameraConfig camera;
  camera.frames = reader.words("camera.frames");
  const std::size_t n = camera.frames.size();
  if (n != 1 && n != 2) {
    reader.fail("camera.frames",
                std::to_string(n) + " links; allowed are one, or two: the left and the right one");
  }
  if (n == 2 && camera.frames[0] == camera.frames[1]) {
    reader.fail("camera.frames", "names '" + camera.frames[0] + "' twice");
  }
  camera.fovy = reader.real("camera.fovy", 0.2, 2.0, "rad");
  if (n == 2) camera.baseline = reader.real("camera.baseline", 0.0005, 0.05, "m");
  return camera;
}

/// The capsules of a robot (joints: their names) or of an instrument (none).
std::vector<LinkCapsule> read_capsules(Reader& reader, const Document& document,
                                       const std::vector<std::string>& joints) {
  std::vector<LinkCapsule> capsules;
  for (const std::string& name : names_in(document, "capsules.")) {
    const std::string prefix = "capsules." + name + ".";
    LinkCapsule capsule{name, -1, read_capsule(reader, prefix, 2.0, 0.5), false};
    if (joints.empty()) {
      capsule.shaft = name == "shaft";
    } else if (reader.has(prefix + "joint")) {
      const std::string joint = reader.word(prefix + "joint");
      const auto found = std::find(joints.begin(), joints.end(), joint);
      if (found == joints.end()) {
        reader.fail(prefix + "joint", "'" + joint +
                                          "' is not one of joints.names; leave it out "
                                          "for a capsule that stands with the base");
      }
      capsule.joint = static_cast<int>(found - joints.begin());
    }
    capsules.push_back(capsule);
  }
  const int most = joints.empty() ? 8 : 24;  // together what clearance.hpp has room for
  if (static_cast<int>(capsules.size()) > most) {
    reader.fail("capsules",
                "has " + std::to_string(capsules.size()) + "; allowed are " + std::to_string(most));
  }
  return capsules;
}

}  // namespace

const Key<Limits>* config::find_limit(const std::string& name) {
  for (const auto& key : limit_keys()) {
    if (name == key.name) return &key;
  }
  return nullptr;
}

std::string config::not_a_limit() {
  std::string list;
  for (const auto& key : limit_keys()) {
    list += (list.empty() ? "" : ", ") + std::string(key.name);
  }
  return "is not a limit; known are " + list;
}

namespace {

void read_tuning(Reader& reader, Tuning& tuning) {
  for (const auto& key : tuning_keys()) {
    tuning.*key.member =
        reader.real(std::string("tuning.") + key.name, key.lowest, key.highest, key.unit);
  }
  std::vector<double> range{0.25, 2.0};
  if (reader.has("joints.braking")) range = reader.numbers("joints.braking");
  const bool good = range.size() == 2 && range[0] >= 0.05 && range[0] <= range[1] && range[1] <= 20;
  if (!good) {
    reader.fail("joints.braking",
                "is not a range; needed are the least and the greatest share of "
                "'acceleration' with which a joint brakes, within 0.05 to 20");
  }
  tuning.braking_least = range[0];
  tuning.braking_most = range[1];
}

}  // namespace

RobotConfig parse_robot(const Document& document) {
  Reader reader(document, "surg_robot/1");
  RobotConfig robot;
  robot.file = document.file;
  robot.name = reader.word("name");
  robot.urdf = reader.word("urdf");
  robot.base_link = reader.word("base_link");
  robot.flange_link = reader.word("flange_link");
  robot.command =
      reader.choice("command", {"joint_velocity", "cartesian_velocity"}) == "joint_velocity"
          ? Command::kJointVelocity
          : Command::kCartesianVelocity;
  robot.joint_names = reader.words("joints.names");
  const std::size_t n = robot.joint_names.size();
  if (n < 6 || n > kMaxJoints) {
    reader.fail("joints.names",
                std::to_string(n) + " joints; allowed is 6 to " + std::to_string(kMaxJoints));
  }
  if (std::set<std::string>(robot.joint_names.begin(), robot.joint_names.end()).size() != n) {
    reader.fail("joints.names", "names a joint twice");
  }
  robot.position_min = reader.joints("joints.position_min", n, -kMostTurned, kMostTurned, "rad");
  robot.position_max = reader.joints("joints.position_max", n, -kMostTurned, kMostTurned, "rad");
  robot.velocity = reader.joints("joints.velocity", n, 0.01, 6.5, "rad/s");
  robot.acceleration = reader.joints("joints.acceleration", n, 0.1, 50.0, "rad/s^2");
  robot.home = reader.joints("joints.home", n, -kMostTurned, kMostTurned, "rad");
  for (int i = 0; i < static_cast<int>(n); ++i) {
    const std::string& joint = robot.joint_names[i];
    if (!(robot.position_min[i] < robot.position_max[i])) {
      reader.fail("joints.position_min", joint + ": " + number(robot.position_min[i]) +
                                             " rad is not below position_max " +
                                             number(robot.position_max[i]) + " rad");
    }
    if (!(robot.home[i] > robot.position_min[i] && robot.home[i] < robot.position_max[i])) {
      reader.fail("joints.home", joint + ": " + number(robot.home[i]) +
                                     " rad is outside its limits " + number(robot.position_min[i]) +
                                     " to " + number(robot.position_max[i]) + " rad");
    }
  }
  for (const auto& key : limit_keys()) {
    robot.limits.*key.member =
        reader.real(std::string("limits.") + key.name, key.lowest, key.highest, key.unit);
  }
  read_tuning(reader, robot.tuning);
  if (reader.has("tuning.link_lag") || reader.has("tuning.link_timeout")) {
    reader.fail(reader.has("tuning.link_lag") ? "tuning.link_lag" : "tuning.link_timeout",
                "belongs to the robot's link, not to the robot: delete it here; the simulator has "
                "its own, another link states it in its YAML");
  }
  robot.capsules = read_capsules(reader, document, robot.joint_names);
  reader.finish();
  robot = with_link(robot, simulator_link());
  check_limits(robot.limits, [&document](const std::string& limit) {
    return place(document, "limits." + limit) + ": limits." + limit;
  });
  return robot;
}

LinkConfig parse_link(const Document& document) {
  Reader reader(document, "surg_link/1");
  LinkConfig link;
  link.name = reader.word("name");
  // A status comes at 50 Hz: a shorter time-out would miss it.
  link.link_timeout = reader.real("link_timeout", 0.03, 0.2, "s");
  const StatedLag lag = read_lag(reader, "link_lag");
  link.link_lag = lag.slowest;
  link.joint_lag = lag.joints;
  link.acceleration = reader.real("acceleration", 0.05, 1.0, "of the robot's");
  // A dead-man may not wait longer than a controller's own time-out, and a stop not take longer
  // than 0.8 s from the fastest joint.
  if (reader.has("dead_man")) link.dead_man = reader.real("dead_man", 0.01, 0.1, "s");
  if (reader.has("stop_deceleration")) {
    link.stop_deceleration = reader.real("stop_deceleration", 4.0, 40.0, "rad/s^2");
  }
  if (reader.has("driver")) link.driver = reader.word("driver");
  reader.leave("settings");  // of the robot's maker; the driver checks them
  reader.finish();
  return link;
}

/// Its time-out is that of one process among many on a desktop, and its dead-man waits as long
/// (F10). Its lag is 4 ms of delay and 8 ms of the joints' servos (sim_arm.py).
LinkConfig simulator_link() { return {kSimulator, 0.1, 0.012, 1.0}; }

RobotConfig with_link(const RobotConfig& robot, const LinkConfig& link) {
  RobotConfig result = robot;
  result.tuning.link_timeout = link.link_timeout;
  result.tuning.link_lag = link.link_lag;
  result.tuning.dead_man = link.dead_man;
  result.tuning.stop_deceleration = link.stop_deceleration;
  result.joint_lag = link.joint_lag;
  result.acceleration *= link.acceleration;
  return result;
}

namespace {

/// [rad] range of one joint of a wrist's drive, with zero in it and no end beyond 'bound'.
void read_wrist_range(Reader& reader, const std::string& joint, double bound, double& least,
                      double& most) {
  least = reader.real("wrist." + joint + ".min", -bound, 0.0, "rad");
  most = reader.real("wrist." + joint + ".max", 0.0, bound, "rad");
  if (!(least < most)) {
    reader.fail("wrist." + joint + ".min", number(least) + " rad is not below wrist." + joint +
                                               ".max " + number(most) + " rad");
  }
}

WristConfig read_wrist(Reader& reader) {
  WristConfig wrist;
  wrist.geometry.pitch_to_yaw = reader.real("wrist.pitch_to_yaw", 0.0, 0.03, "m");
  wrist.geometry.yaw_to_tip = reader.real("wrist.yaw_to_tip", 0.002, 0.05, "m");
  // At a quarter turn of pitch the roll is free; cables run along the shaft and bound the roll.
  read_wrist_range(reader, "pitch", 1.5, wrist.min[0], wrist.max[0]);
  read_wrist_range(reader, "yaw", 1.5, wrist.min[1], wrist.max[1]);
  if (reader.has("wrist.roll")) {
    read_wrist_range(reader, "roll", 2 * M_PI, wrist.min[2], wrist.max[2]);
  }
  wrist.velocity = reader.real("wrist.velocity", 0.2, 20.0, "rad/s");
  wrist.acceleration = reader.real("wrist.acceleration", 2.0, 400.0, "rad/s^2");
  wrist.drive_lag = reader.real("wrist.drive_lag", 0.0, 0.1, "s");
  return wrist;
}

}  // namespace

Limits with_roll_of(const InstrumentConfig& instrument, Limits limits) {
  if (!instrument.wrist || !instrument.wrist->rolls()) return limits;
  const WristConfig& drive = *instrument.wrist;
  limits.roll_velocity = drive.velocity;
  limits.roll_acceleration = drive.acceleration;
  limits.roll_jerk = drive.jerk();
  limits.roll_max = std::min(-drive.min[2], drive.max[2]);
  return limits;
}

void keep_roll_within(const Limits& limits, InstrumentConfig& instrument) {
  if (!instrument.wrist || !instrument.wrist->rolls()) return;
  WristConfig& drive = *instrument.wrist;
  drive.velocity = std::min(drive.velocity, limits.roll_velocity);
  drive.acceleration = std::min(drive.acceleration, limits.roll_acceleration);
  if (limits.roll_max >= std::min(-drive.min[2], drive.max[2])) return;
  drive.min[2] = -limits.roll_max;
  drive.max[2] = limits.roll_max;
}

InstrumentConfig parse_instrument(const Document& document) {
  Reader reader(document, "surg_instrument/1");
  InstrumentConfig instrument;
  instrument.file = document.file;
  instrument.name = reader.word("name");
  instrument.urdf = reader.word("urdf");
  instrument.mount_link = reader.word("mount_link");
  instrument.tip_link = reader.word("tip_link");
  instrument.jaw_min = instrument.jaw_max = instrument.jaw_velocity = 0;
  if (reader.has("jaw")) {
    instrument.jaw_min = reader.real("jaw.min", -0.5, 3.2, "rad");
    instrument.jaw_max = reader.real("jaw.max", -0.5, 3.2, "rad");
    instrument.jaw_velocity = reader.real("jaw.velocity", 0.05, 20.0, "rad/s");
    if (!(instrument.jaw_min < instrument.jaw_max)) {
      reader.fail("jaw.min", number(instrument.jaw_min) + " rad is not below jaw.max " +
                                 number(instrument.jaw_max) + " rad");
    }
  }
  if (reader.has("wrist")) instrument.wrist = read_wrist(reader);
  if (reader.has("camera")) instrument.camera = read_camera(reader);
  if (reader.has("passive")) instrument.passive = reader.flag("passive");
  if (instrument.passive && reader.has("jaw")) {
    reader.fail("passive", "true, and there is a 'jaw': nobody drives it; leave 'jaw' out");
  }
  if (instrument.passive && instrument.wrist) {
    reader.fail("passive", "true, and there is a 'wrist': nobody drives it; leave 'wrist' out");
  }
  instrument.capsules = read_capsules(reader, document, {});
  reader.finish();
  return instrument;
}

Limits tighten(const Limits& limits, const CellArm& arm, const std::string& cell_file) {
  Limits result = limits;
  for (const auto& [limit, value] : arm.limits) {
    const std::string where = place(arm, "limits." + limit, cell_file) + ": ";
    const Key<Limits>* key = find_limit(limit);
    if (!key) throw ConfigError(where + not_a_limit());
    const double present = limits.*key->member;
    const bool smaller = key->tighter == Tighter::kSmaller;
    const double lowest = smaller ? key->lowest : present;
    const double highest = smaller ? present : key->highest;
    if (!(value >= lowest && value <= highest)) {
      throw ConfigError(where + number(value) + " " + key->unit +
                        " would loosen the robot's limit or leave its range; a cell may only "
                        "tighten: allowed is " +
                        number(lowest) + " to " + number(highest) + " " + key->unit);
    }
    result.*key->member = value;
  }
  if (arm.hardware && arm.hardware->commissioning) {
    result.tip_velocity = std::min(result.tip_velocity, 0.02);        // [m/s]
    result.flange_velocity = std::min(result.flange_velocity, 0.05);  // [m/s]
  }
  check_limits(result, [&](const std::string& limit) {
    return arm.limits.count(limit) ? place(arm, "limits." + limit, cell_file) : std::string();
  });
  return result;
}

RobotConfig with_home(const RobotConfig& robot, const CellArm& arm, const std::string& cell_file) {
  RobotConfig result = robot;
  result.elbow = arm.elbow;
  if (std::isfinite(arm.elbow) && robot.joint_names.size() != 7) {
    throw ConfigError(
        place(arm, "elbow", cell_file) + ": " + robot.name + " has " +
        std::to_string(robot.joint_names.size()) +
        " joints; only an arm of seven joints has an elbow to choose: remove the key");
  }
  if (arm.home.empty()) return result;
  const std::string where = place(arm, "home", cell_file) + ": ";
  if (arm.home.size() != robot.joint_names.size()) {
    throw ConfigError(where + "has " + std::to_string(arm.home.size()) + " values; " + robot.name +
                      " has " + std::to_string(robot.joint_names.size()) + " joints");
  }
  for (int i = 0; i < static_cast<int>(arm.home.size()); ++i) {
    if (!(arm.home[i] > robot.position_min[i] && arm.home[i] < robot.position_max[i])) {
      throw ConfigError(where + robot.joint_names[i] + ": " + number(arm.home[i]) +
                        " rad is outside its limits " + number(robot.position_min[i]) + " to " +
                        number(robot.position_max[i]) + " rad");
    }
    result.home[i] = arm.home[i];
  }
  return result;
}

std::string limits_hash(const RobotConfig& robot, const Limits& limits) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a, 64 bit
  const auto mix = [&hash](double value) {
    unsigned char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    for (unsigned char byte : bytes) hash = (hash ^ byte) * 1099511628211ULL;
  };
  for (const auto& key : limit_keys()) mix(limits.*key.member);
  for (const auto& key : tuning_keys()) mix(robot.tuning.*key.member);
  mix(robot.tuning.link_timeout);
  mix(robot.tuning.link_lag);
  mix(robot.tuning.braking_least);
  mix(robot.tuning.braking_most);
  for (const JointVector* values : {&robot.home, &robot.position_min, &robot.position_max,
                                    &robot.velocity, &robot.acceleration, &robot.joint_lag}) {
    for (int i = 0; i < values->size(); ++i) mix((*values)[i]);
  }
  if (std::isfinite(robot.elbow)) mix(robot.elbow);
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

}  // namespace surg
