// Cells: arms, hardware, network, endoscope, fixtures, clearance.
#include <array>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>

#include "document_reader.hpp"
#include "surg_core/config_keys.hpp"

namespace surg {

using namespace config;

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
/// The arms that a link drives: their number of joints, and the robot's name if it is one model.
struct DrivenArms {
  const char* link;
  std::size_t joints;
  const char* robot;
};
constexpr DrivenArms kDrivenArms[] = {{"ur", 6, ""}, {"fr3", 7, "fr3"}, {"panda", 7, "panda"}};

/// The four numbers of an IPv4 address in its one canonical form, or none.
std::optional<std::array<int, 4>> ipv4(const std::string& text) {
  std::array<int, 4> parts{};
  int used = 0;
  if (std::sscanf(text.c_str(), "%3d.%3d.%3d.%3d%n", &parts[0], &parts[1], &parts[2], &parts[3],
                  &used) != 4 ||
      used != static_cast<int>(text.size())) {
    return std::nullopt;
  }
  std::string again;
  for (int part : parts) {
    if (part < 0 || part > 255) return std::nullopt;
    again += (again.empty() ? "" : ".") + std::to_string(part);
  }
  if (again != text) return std::nullopt;  // leading zeros are octal elsewhere
  return parts;
}

/// Whether an address is one that no router of the internet passes on (RFC 1918, RFC 3927).
bool stays_local(const std::array<int, 4>& a) {
  return a[0] == 10 || (a[0] == 172 && a[1] >= 16 && a[1] <= 31) || (a[0] == 192 && a[1] == 168) ||
         (a[0] == 169 && a[1] == 254);
}

Fixture read_fixture(Reader& reader, const std::string& key, const std::string& name) {
  Fixture f;
  if (name.size() > Fixture::kLongestName) {
    reader.fail(key, "has " + std::to_string(name.size()) + " characters; allowed are " +
                         std::to_string(Fixture::kLongestName));
  }
  f.set_name(name);
  f.of_cell = true;
  reader.choose(key + ".shape", kShapes, f.shape);
  reader.choose(key + ".side", kSides, f.side);
  reader.choose(key + ".of", kParts, f.of);
  f.point = reader.vector(key + ".point", Fixture::kFarthest, "m");
  if (f.shape == Fixture::Shape::kPlane) {
    f.axis = reader.vector(key + ".normal", 1.001, "");
  } else {
    const bool hollow = f.side == Fixture::Side::kStayIn;
    const double least = hollow ? Fixture::kLeastHollow : Fixture::kLeastRadius;
    f.radius = reader.real(key + ".radius", least, Fixture::kGreatestRadius, "m");
    f.axis.setZero();
    if (f.shape == Fixture::Shape::kCapsule) {
      f.axis = reader.vector(key + ".end", Fixture::kFarthest, "m") - f.point;
    }
  }
  const std::string problem = check_fixture(f);
  if (!problem.empty()) reader.fail(key, problem);
  return f;
}

bool is_path(const CellArm& arm) {
  const std::string yaml = ".yaml";
  return arm.link.size() > yaml.size() &&
         arm.link.compare(arm.link.size() - yaml.size(), yaml.size(), yaml) == 0;
}

/// The section 'hardware' of an arm; a cell without one is a simulator's, or has a link that
/// somebody starts by hand.
std::optional<CellHardware> read_hardware(Reader& reader, const CellArm& arm) {
  const std::string section = "arms." + arm.name + ".hardware", prefix = section + ".";
  if (!reader.has(section)) return std::nullopt;
  if (arm.link == kSimulator) {
    reader.fail(section, "belongs to a real or an emulated arm; the link is '" + arm.link +
                             "': remove the section, or name the arm's link");
  }
  CellHardware hardware;
  hardware.address = reader.word(prefix + "address");
  const auto parts = ipv4(hardware.address);
  if (!parts) {
    reader.fail(prefix + "address",
                "'" + hardware.address + "' is not an IPv4 address such as 192.168.56.2");
  }
  if (!stays_local(*parts) && !hardware.emulated()) {
    reader.fail(prefix + "address",
                hardware.address +
                    " is routable; a robot hangs on a cable of its own: allowed are 10.x.x.x, "
                    "172.16.x.x to 172.31.x.x, 192.168.x.x, 169.254.x.x, and 127.x.x.x for an "
                    "emulator");
  }
  hardware.serial = reader.word(prefix + "serial");
  hardware.payload_mass = reader.real(prefix + "payload.mass", 0.0, 20.0, "kg");
  hardware.payload_cog = reader.vector(prefix + "payload.cog", 0.5, "m");
  hardware.tool_link = reader.choice(prefix + "tool_link", {"passive", "drive", "none"});
  // The controller has 79 and 80, the node one less.
  hardware.realtime = static_cast<int>(reader.real(prefix + "realtime", 2, 78, "(SCHED_FIFO)"));
  if (reader.has(prefix + "calibration_days")) {
    hardware.calibration_days =
        static_cast<int>(reader.real(prefix + "calibration_days", 1, 366, "days"));
  }
  if (reader.has(prefix + "link_lag")) {
    const StatedLag lag = read_lag(reader, prefix + "link_lag");
    hardware.link_lag = lag.slowest;
    hardware.joint_lag = lag.joints;
  }
  if (reader.has(prefix + "home_confirmed")) {
    hardware.home_confirmed = reader.flag(prefix + "home_confirmed");
  }
  if (reader.has(prefix + "commissioning")) {
    hardware.commissioning = reader.flag(prefix + "commissioning");
  }
  return hardware;
}

/// Refuses an arm whose robot another arm of the cell has.
void check_shared_robot(const Reader& reader, const std::vector<CellArm>& before,
                        const CellArm& arm) {
  if (!arm.hardware) return;
  for (const CellArm& other : before) {
    if (!other.hardware) continue;
    const std::string prefix = "arms." + arm.name + ".hardware.";
    if (other.hardware->address == arm.hardware->address) {
      reader.fail(prefix + "address", arm.hardware->address + " is that of " + other.name +
                                          " too; each arm has an address of its own");
    }
    if (other.hardware->serial == arm.hardware->serial) {
      reader.fail(prefix + "serial", "'" + arm.hardware->serial + "' is that of " + other.name +
                                         " too; each arm has a serial of its own");
    }
  }
}

constexpr const char* kRoles[] = {"robot", "operator", "endoscope"};

/// The machines of a cell that is spread over several, by role.
std::map<std::string, std::string> read_machines(Reader& reader, const std::string& network) {
  std::map<std::string, std::string> machines;
  if (!reader.has("machines")) return machines;
  if (network != "isolated") {
    reader.fail("machines",
                "needs 'network: isolated': ROS 1 has no passwords, so its ports may be "
                "open only on a network of these machines alone");
  }
  for (const std::string role : kRoles) {
    const std::string key = "machines." + role;
    if (role != "robot" && !reader.has(key)) continue;
    const std::string address = reader.word(key);
    const auto parts = ipv4(address);
    if (!parts) {
      reader.fail(key, "'" + address + "' is not an IPv4 address such as 192.168.77.1");
    }
    if (!stays_local(*parts)) {
      reader.fail(key, address +
                           " is routable or this machine alone; allowed are 10.x.x.x, "
                           "172.16.x.x to 172.31.x.x, 192.168.x.x and 169.254.x.x");
    }
    machines[role] = address;
  }
  return machines;
}

/// The section 'endoscope'; a cell without one has the simulator's.
std::optional<CellEndoscope> read_endoscope(Reader& reader) {
  const std::string prefix = "endoscope.";
  if (!reader.has("endoscope")) return std::nullopt;
  CellEndoscope endoscope;
  endoscope.source = reader.word(prefix + "source");
  const auto colon = endoscope.source.find(':');
  if (colon == 0 || colon == std::string::npos || colon + 1 == endoscope.source.size()) {
    reader.fail(prefix + "source",
                "'" + endoscope.source +
                    "' is not KIND:ADDRESS, such as v4l2:/dev/video0, gst:PIPELINE, "
                    "file:PATH, pipe:PATH or ros:/left,/right");
  }
  endoscope.layout =
      reader.choice(prefix + "layout", {"two", "sbs", "sbs_half", "top_bottom", "rows", "mono"});
  if (reader.has(prefix + "size")) {
    const std::vector<double> size = reader.numbers(prefix + "size");
    const bool good = size.size() == 2 && std::all_of(size.begin(), size.end(), [](double pixels) {
                        return pixels == std::floor(pixels) && pixels >= 16 && pixels <= 7680;
                      });
    if (!good) {
      reader.fail(
          prefix + "size",
          "must be [width, height] of a grabbed picture in whole px; allowed is 16 to 7680");
    }
    endoscope.width = static_cast<int>(size[0]);
    endoscope.height = static_cast<int>(size[1]);
  }
  if (reader.has(prefix + "rate")) {
    endoscope.rate = reader.real(prefix + "rate", 1, 240, "1/s");
  }
  if (reader.has(prefix + "swap")) endoscope.swap = reader.flag(prefix + "swap");
  if (reader.has(prefix + "flip")) {
    endoscope.flip =
        reader.choice(prefix + "flip", {"none", "horizontal", "vertical", "rotate_180"});
  }
  if (reader.has(prefix + "latency")) {
    endoscope.latency = reader.real(prefix + "latency", 0.0, 1.0, "s");
  }
  return endoscope;
}

Obstacle read_obstacle(Reader& reader, const std::string& name) {
  const std::string prefix = "clearance.obstacles." + name + ".";
  Obstacle obstacle;
  obstacle.name = name;
  obstacle.half_space = reader.has(prefix + "normal");
  if (!obstacle.half_space) {
    obstacle.capsule = read_capsule(reader, prefix, 10.0, 2.0);
    return obstacle;
  }
  obstacle.space.point = reader.vector(prefix + "point", 10.0, "m");
  obstacle.space.normal = reader.vector(prefix + "normal", 1.0 + 1e-9, "");
  if (!(std::abs(obstacle.space.normal.norm() - 1.0) < 1e-6)) {
    reader.fail(prefix + "normal", "has length " + number(obstacle.space.normal.norm()) +
                                       "; a unit vector out of the body is needed");
  }
  obstacle.space.normal.normalize();
  return obstacle;
}

CellClearance read_clearance(Reader& reader, const Document& document) {
  CellClearance clearance;
  if (!reader.has("clearance")) return clearance;
  const auto line = document.lines.find("clearance");
  clearance.line = line == document.lines.end() ? 1 : line->second;
  // The guard itself needs the least distance (clearance.cpp).
  if (reader.has("clearance.distance")) {
    clearance.distance = reader.real("clearance.distance", 0.005, 0.2, "m");
  }
  if (reader.has("clearance.shafts")) {
    clearance.shafts = reader.real("clearance.shafts", 0.0, 0.2, "m");
  }
  for (const std::string& name : names_in(document, "clearance.obstacles.")) {
    clearance.obstacles.push_back(read_obstacle(reader, name));
  }
  return clearance;
}

constexpr const char* kCommission = ": set commissioning: true, ";

/// Refuses a calibration that must not move a real arm.
template <typename Calibration>
void check_calibration(const CellHardware& hardware, const std::string& what,
                       const Calibration& found, const std::string& key, const std::string& today) {
  const std::string subject = "the calibration of the " + what;
  const std::string cure = kCommission + std::string("then ./surg calibrate CELL ") + what;
  if (found.source != "measured") {
    throw ConfigError(key + ": " + subject + " is " + found.source +
                      "; a real arm needs a measured one" + cure);
  }
  if (found.serial != hardware.serial) {
    throw ConfigError(key + ".serial: '" + hardware.serial + "', and " + subject +
                      " was measured with " +
                      (found.serial.empty() ? "an unknown arm" : "'" + found.serial + "'") + cure);
  }
  if (hardware.calibration_days == 0) {
    throw ConfigError(key +
                      ".calibration_days: is missing; a real arm needs the age [days] at which "
                      "its calibrations must be repeated, 1 to 366");
  }
  const std::optional<int> day = day_of(found.date), now = day_of(today);
  const bool readable = day && now;
  if (!readable || *now - *day > hardware.calibration_days || *day > *now + 1) {
    throw ConfigError(
        key + ".calibration_days: " + std::to_string(hardware.calibration_days) + ", and " +
        subject + " is of '" + found.date + "'" +
        (readable ? ", " + std::to_string(*now - *day) + " days ago" : ", which is no date") +
        cure);
  }
}

/// Refuses a list of lags, of the cell or of its link, that does not fit the robot.
void check_lags(const CellArm& arm, const RobotConfig& robot, const std::string& cell_file) {
  const auto lags = static_cast<std::size_t>(robot.joint_lag.size());
  const std::size_t n = robot.joint_names.size();
  if (lags == 0 || lags == n) return;
  const bool own = arm.hardware && arm.hardware->joint_lag.size() != 0;
  throw ConfigError(place(arm, own ? "hardware.link_lag" : "link", cell_file) + ": link_lag has " +
                    std::to_string(lags) + " values; " + robot.name + " has " + std::to_string(n) +
                    " joints: state one number, or one per joint");
}

}  // namespace

bool CellHardware::emulated() const { return address.rfind("127.", 0) == 0; }

LinkConfig with_measured_lag(const LinkConfig& link, const CellArm& arm) {
  LinkConfig result = link;
  if (arm.hardware && std::isfinite(arm.hardware->link_lag)) {
    result.link_lag = arm.hardware->link_lag;
    result.joint_lag = arm.hardware->joint_lag;
  }
  return result;
}

std::string link_file(const CellArm& arm) {
  return is_path(arm)
             ? arm.link
             : arm.robot.substr(0, arm.robot.rfind('/') + 1) + "../links/" + arm.link + ".yaml";
}

std::string unknown_link(const CellArm& arm, const std::string& cell_file,
                         const std::string& tried) {
  return place(arm, "link", cell_file) + ": '" + arm.link + "': there is no " + tried +
         "; allowed: 'simulator', the name of a link that is installed, or the path of a link's "
         "YAML relative to the cell";
}

CellConfig parse_cell(const Document& document) {
  Reader reader(document, "surg_cell/1");
  CellConfig cell;
  cell.file = document.file;
  cell.name = reader.word("name");
  cell.network = reader.choice("network", {"loopback", "isolated"});
  cell.machines = read_machines(reader, cell.network);
  cell.clearance = read_clearance(reader, document);
  cell.endoscope = read_endoscope(reader);
  const std::vector<std::string> names = names_in(document, "arms.");
  if (names.empty()) reader.fail("arms", "is missing; a cell needs at least one arm");
  for (const auto& name : names) {
    const std::string prefix = "arms." + name + ".";
    const bool plain = std::all_of(name.begin(), name.end(),
                                   [](unsigned char c) { return std::isalnum(c) || c == '_'; });
    if (!plain || !std::isalpha(static_cast<unsigned char>(name[0]))) {
      reader.fail("arms." + name,
                  "an arm's name becomes a ROS namespace: letters, digits and _ "
                  "only, a letter first");
    }
    CellArm arm;
    arm.name = name;
    arm.robot = reader.word(prefix + "robot");
    arm.instrument = reader.word(prefix + "instrument");
    arm.link = reader.word(prefix + "link");
    arm.where["link"] = place(document, prefix + "link");
    arm.base_xyz = reader.vector(prefix + "base.xyz", 10.0, "m");
    arm.base_rpy = reader.vector(prefix + "base.rpy", 6.3, "rad");
    if (reader.has(prefix + "home")) arm.home = reader.numbers(prefix + "home");
    arm.where["home"] = place(document, prefix + "home");
    if (reader.has(prefix + "elbow")) arm.elbow = reader.real(prefix + "elbow", -M_PI, M_PI, "rad");
    arm.where["elbow"] = place(document, prefix + "elbow");
    for (const auto& [key, value] : document.values) {
      if (key.rfind(prefix + "limits.", 0) != 0) continue;
      const std::string limit = key.substr(prefix.size() + std::strlen("limits."));
      if (!find_limit(limit)) reader.fail(key, not_a_limit());
      arm.limits[limit] = reader.real(key, -kInf, kInf, "");
      arm.where["limits." + limit] = place(document, key);
    }
    for (const auto& fixture : names_in(document, prefix + "fixtures.")) {
      const std::string key = prefix + "fixtures." + fixture;
      if (arm.fixtures.size() == Fixtures::kMost) {
        reader.fail(key, "is one too many; allowed are " + std::to_string(Fixtures::kMost) +
                             " fixtures for an arm");
      }
      arm.fixtures.push_back(read_fixture(reader, key, fixture));
    }
    arm.hardware = read_hardware(reader, arm);
    arm.where["hardware"] = place(document, prefix + "hardware");
    check_shared_robot(reader, cell.arms, arm);
    cell.arms.push_back(arm);
  }
  reader.finish();
  return cell;
}

void check_hardware(const CellArm& arm, const RobotConfig& robot,
                    const InstrumentConfig& instrument, const ToolCalibration& tool,
                    const TrocarCalibration& trocar, const std::string& cell_file,
                    const std::string& today) {
  if (!arm.hardware) {
    check_lags(arm, robot, cell_file);
    if (arm.link == kSimulator || is_path(arm)) return;
    throw ConfigError(place(arm, "hardware", cell_file) + ": is missing; the link '" + arm.link +
                      "' needs address, serial, payload, tool_link and realtime");
  }
  for (const auto& [link, joints, name] : kDrivenArms) {
    if (arm.link != link) continue;
    const std::string where = place(arm, "link", cell_file) + ": '" + arm.link + "' drives ";
    if (*name && robot.name != name) {
      throw ConfigError(where + "the robot '" + name + "'; the cell's robot is '" + robot.name +
                        "': name that robot's link");
    }
    if (robot.joint_names.size() != joints) {
      throw ConfigError(where + "arms of " + std::to_string(joints) + " joints; " + robot.name +
                        " has " + std::to_string(robot.joint_names.size()));
    }
  }
  check_lags(arm, robot, cell_file);
  const std::string key = place(arm, "hardware", cell_file);
  if ((arm.hardware->tool_link == "passive") != instrument.passive) {
    throw ConfigError(key + ".tool_link: '" + arm.hardware->tool_link + "', and " +
                      instrument.file +
                      " states passive: " + (instrument.passive ? "true" : "false") +
                      "; allowed is 'passive' with a passive instrument, 'drive' or 'none' with "
                      "another");
  }
  if (arm.hardware->emulated() || arm.hardware->commissioning) return;
  check_calibration(*arm.hardware, "tool", tool, key, today);
  check_calibration(*arm.hardware, "trocar", trocar, key, today);
  if (!std::isfinite(arm.hardware->link_lag)) {
    throw ConfigError(key + ".link_lag: is missing; a real arm needs its own, not the emulator's" +
                      kCommission + "then measure it: ./surg robot CELL lag");
  }
  if (!arm.hardware->home_confirmed) {
    throw ConfigError(key + ".home_confirmed: is not true; nobody has seen this arm at its home" +
                      kCommission + "then home the arm with nobody near and look");
  }
}

}  // namespace surg
