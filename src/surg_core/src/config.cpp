#include "surg_core/config.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <functional>
#include <initializer_list>
#include <limits>
#include <optional>
#include <set>
#include <utility>

namespace surg {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

/// Which direction makes a limit tighter.
enum class Tighter { kSmaller, kLarger };

/// One limit: its name, where it lives, the compiled-in range and unit. No YAML can exceed the
/// range.
struct LimitKey {
  const char* name;
  double Limits::*member;
  double lowest, highest;
  const char* unit;
  Tighter tighter = Tighter::kSmaller;
};

constexpr LimitKey kLimitKeys[] = {
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

struct TuningKey {
  const char* name;
  double Tuning::*member;
  double lowest, highest;
  const char* unit;
};

constexpr TuningKey kTuningKeys[] = {
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

/// Keys of a link's YAML. A status comes at 50 Hz: a shorter time-out would miss it.
constexpr double kLinkTimeout[] = {0.03, 0.2}, kLinkLag[] = {0.0, 0.05},
                 kLinkAcceleration[] = {0.05, 1.0};
/// A dead-man may not wait longer than a controller's own time-out, and a stop not take longer than
/// 0.8 s from the fastest joint.
constexpr double kDeadMan[] = {0.01, 0.1}, kStopDeceleration[] = {4.0, 40.0};
// What a cell may state of a real arm.
constexpr double kHeaviestPayload = 20.0;  // [kg]
constexpr double kFarthestPayload = 0.5;   // [m]
constexpr int kPriorities[] = {
    2, 78};  // of SCHED_FIFO; the controller has 79 and 80, the node one less
/// The arms that a link drives: their number of joints, and the robot's name if it is one model.
struct DrivenArms {
  const char* link;
  std::size_t joints;
  const char* robot;
};
constexpr DrivenArms kDrivenArms[] = {{"ur", 6, ""}, {"fr3", 7, "fr3"}, {"panda", 7, "panda"}};
constexpr int kUrJoints = 6;
// A measured base; the same bounds as in base_file.py and checked_document.py.
constexpr double kFarthestBase = 10.0;         // [m]
constexpr double kLargestBaseResidual = 0.02;  // [m]
constexpr int kLeastBasePoints = 6;
constexpr double kLargestTurnSd = 0.35, kLargestShiftSd = 0.1;  // [rad], [m]
constexpr double kLeastEigenvalue = 1e-9;                       // of the correlations
constexpr double kUnit = 1e-6;                         // from the length of a unit quaternion
constexpr double kSameBase = 1e-9;                     // [m, rad]
constexpr double kOldestCalibration = 366;             // [d]
constexpr double kSlowTip = 0.02, kSlowFlange = 0.05;  // [m/s] of an arm being commissioned
// Together what clearance.hpp has room for.
constexpr int kMostArmCapsules = 24;
constexpr int kMostToolCapsules = 8;

// Distances that a cell may keep. The guard itself needs the least one (clearance.cpp).
constexpr double kClosest = 0.005;  // [m]
constexpr double kFarthest = 0.2;   // [m]

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

std::string show(const Value& value) {
  if (const auto* b = std::get_if<bool>(&value)) return *b ? "true" : "false";
  if (const auto* d = std::get_if<double>(&value)) return number(*d);
  if (const auto* s = std::get_if<std::string>(&value)) return "'" + *s + "'";
  std::string text = "[";
  if (const auto* list = std::get_if<std::vector<double>>(&value)) {
    for (double item : *list) text += (text.size() > 1 ? ", " : "") + number(item);
  } else {
    for (const auto& item : std::get<std::vector<std::string>>(value)) {
      text += (text.size() > 1 ? ", '" : "'") + item + "'";
    }
  }
  return text + "]";
}

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

/// Where a key is: file, and line where known.
std::string place(const Document& document, const std::string& key) {
  const auto line = document.lines.find(key);
  const bool known = line != document.lines.end();
  return document.file + (known ? ":" + std::to_string(line->second) : "");
}

/// A key that is needed and not there.
class MissingKey : public ConfigError {
 public:
  MissingKey(const std::string& what, std::string key) : ConfigError(what), key_(std::move(key)) {}
  const std::string& key() const { return key_; }

 private:
  std::string key_;
};

/// How many letters must be inserted, deleted, replaced or swapped with their neighbour.
std::size_t edits_between(const std::string& a, const std::string& b) {
  std::vector<std::size_t> before(b.size() + 1), last(b.size() + 1), row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    before = std::exchange(last, row);
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      row[j] = std::min({last[j] + 1, row[j - 1] + 1, last[j - 1] + (a[i - 1] != b[j - 1])});
      const bool swapped = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
      if (swapped) row[j] = std::min(row[j], before[j - 2] + 1);
    }
  }
  return row[b.size()];
}

/// Whether one key may be a misspelling of the other: at most every third letter of a word differs.
bool alike(const std::string& a, const std::string& b) {
  const auto last_word = [](const std::string& key) { return key.size() - (key.rfind('.') + 1); };
  return edits_between(a, b) <= std::max<std::size_t>(std::min(last_word(a), last_word(b)) / 3, 1);
}

/// The key of a document that is a misspelling of one that is missing in it; empty if there is
/// none. It is one if it looks like it, and if nothing misses it or minds its value once it is
/// renamed.
template <typename Parse>
std::string misspelling(const Document& document, const std::string& missing, Parse parse) {
  std::multimap<std::size_t, std::string> nearest_first;
  for (const auto& [key, value] : document.values) {
    if (alike(key, missing)) nearest_first.emplace(edits_between(key, missing), key);
  }
  for (const auto& [edits, key] : nearest_first) {
    Document renamed = document;
    renamed.values[missing] = document.values.at(key);
    renamed.values.erase(key);
    try {
      parse(renamed);
    } catch (const MissingKey& other) {
      if (other.key() == key) continue;
    } catch (const ConfigError& other) {
      if (std::strstr(other.what(), missing.c_str())) continue;
    }
    return key;
  }
  return "";
}

/// Parses a document. Where a key is missing because it is misspelt, the error names both.
template <typename Parse>
auto parse_with_hints(const Document& document, Parse parse) {
  try {
    return parse(document);
  } catch (const MissingKey& missing) {
    const std::string key = misspelling(document, missing.key(), parse);
    if (key.empty()) throw;
    throw ConfigError(place(document, key) + ": " + key + ": is not a known key; did you mean " +
                      missing.key() + "?");
  }
}

/// Reads a document key by key, remembers what was asked for, and refuses what was not.
class Reader {
 public:
  Reader(const Document& document, const char* format) : document_(document) {
    choice("format", {format});
  }

  [[noreturn]] void fail(const std::string& key, const std::string& problem) const {
    throw ConfigError(place(document_, key) + ": " + key + ": " + problem);
  }

  double real(const std::string& key, double lowest, double highest, const char* unit) {
    const double value = get<double>(key, "a number");
    // Written so that NaN fails too.
    if (!(value >= lowest && value <= highest)) {
      fail(key, number(value) + " " + unit + " is out of range; allowed is " + number(lowest) +
                    " to " + number(highest) + " " + unit);
    }
    return value;
  }

  std::string word(const std::string& key) {
    const std::string value = get<std::string>(key, "a non-empty text");
    if (value.empty()) fail(key, "is empty; a non-empty text is needed");
    return value;
  }

  bool flag(const std::string& key) { return get<bool>(key, "true or false"); }

  std::string choice(const std::string& key, std::initializer_list<const char*> allowed) {
    const std::string value = get<std::string>(key, "a text");
    std::string list;
    for (const char* item : allowed) {
      if (value == item) return value;
      list += (list.empty() ? "'" : ", '") + std::string(item) + "'";
    }
    fail(key, "'" + value + "' is not known; allowed: " + list);
  }

  JointVector joints(const std::string& key, std::size_t n, double lowest, double highest,
                     const char* unit) {
    const auto list = get<std::vector<double>>(key, "a list of numbers, one per joint");
    if (list.size() != n) {
      fail(key,
           "has " + std::to_string(list.size()) + " values; joints.names has " + std::to_string(n));
    }
    JointVector values(static_cast<int>(n));
    for (std::size_t i = 0; i < n; ++i) {
      if (!(list[i] >= lowest && list[i] <= highest)) {
        fail(key, "value " + std::to_string(i + 1) + ", " + number(list[i]) + " " + unit +
                      ", is out of range; allowed is " + number(lowest) + " to " + number(highest) +
                      " " + unit);
      }
      values[static_cast<int>(i)] = list[i];
    }
    return values;
  }

  Vector3 vector(const std::string& key, double largest, const char* unit) {
    const auto list = get<std::vector<double>>(key, "a list of three numbers");
    if (list.size() != 3) {
      fail(key, "has " + std::to_string(list.size()) + " values; three are needed");
    }
    for (double item : list) {
      if (!(std::abs(item) <= largest)) {
        fail(key, number(item) + " " + unit + " is out of range; allowed is -" + number(largest) +
                      " to " + number(largest) + " " + unit);
      }
    }
    return {list[0], list[1], list[2]};
  }

  /// Whether the document says the key, or any key of a section of this name.
  bool has(const std::string& name) const {
    const auto next = document_.values.lower_bound(name + ".");
    return document_.values.count(name) != 0 ||
           (next != document_.values.end() && next->first.rfind(name + ".", 0) == 0);
  }

  std::vector<double> numbers(const std::string& key) {
    return get<std::vector<double>>(key, "a list of numbers");
  }

  std::vector<std::string> words(const std::string& key) {
    return get<std::vector<std::string>>(key, "a list of texts");
  }

  /// Leaves a section to somebody else, who checks its keys.
  void leave(const std::string& section) {
    for (const auto& [key, value] : document_.values) {
      if (key.rfind(section + ".", 0) == 0) known_.insert(key);
    }
  }

  /// Refuses keys that nobody asked for: a misspelt limit must not pass for a set one.
  void finish() const {
    for (const auto& [key, value] : document_.values) {
      if (known_.count(key)) continue;
      std::string near, meant;
      for (const auto& candidate : known_) {
        const auto dot = key.rfind('.');
        const std::string section = dot == std::string::npos ? "" : key.substr(0, dot + 1);
        const auto known_dot = candidate.rfind('.');
        const std::string known_section =
            known_dot == std::string::npos ? "" : candidate.substr(0, known_dot + 1);
        if (section == known_section) near += (near.empty() ? "" : ", ") + candidate;
        if (meant.empty() && document_.values.count(candidate) == 0 && alike(key, candidate)) {
          meant = candidate;
        }
      }
      if (!meant.empty()) fail(key, "is not a known key; did you mean " + meant + "?");
      fail(key, "is not a known key" + (near.empty() ? "" : "; known here: " + near));
    }
  }

 private:
  template <typename T>
  T get(const std::string& key, const char* wanted) {
    known_.insert(key);
    const auto found = document_.values.find(key);
    if (found == document_.values.end()) {
      const bool nested =
          std::any_of(document_.values.begin(), document_.values.end(),
                      [&](const auto& item) { return item.first.rfind(key + ".", 0) == 0; });
      if (nested) fail(key, "is a section; " + std::string(wanted) + " is needed");
      throw MissingKey(document_.file + ": " + key + ": is missing; " + wanted + " is needed", key);
    }
    if (const T* value = std::get_if<T>(&found->second)) return *value;
    fail(key, show(found->second) + " is not " + wanted);
  }

  const Document& document_;
  std::set<std::string> known_;
};

const LimitKey* find_limit(const std::string& name) {
  for (const auto& key : kLimitKeys) {
    if (name == key.name) return &key;
  }
  return nullptr;
}

std::string not_a_limit(const std::string& name) {
  std::string list;
  for (const auto& key : kLimitKeys) {
    if (alike(name, key.name)) return std::string("is not a limit; did you mean ") + key.name + "?";
    list += (list.empty() ? "" : ", ") + std::string(key.name);
  }
  return "is not a limit; known are " + list;
}

/// File, line where known, and key of an arm's value in its cell.
std::string place(const CellArm& arm, const std::string& key, const std::string& cell_file) {
  const auto found = arm.where.find(key);
  const std::string file = found == arm.where.end() ? cell_file : found->second;
  return file + ": arms." + arm.name + "." + key;
}

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
    const LimitKey &low = *find_limit(lower), &high = *find_limit(upper);
    const double least = limits.*low.member, most = limits.*high.member;
    if (least < most) continue;
    const std::string below = where(lower), above = where(upper);
    const std::string at = !below.empty() ? below : above;
    const std::string other = !below.empty() && !above.empty() ? " (" + above + ")" : "";
    throw ConfigError(at + ": " + lower + " " + number(least) + " " + low.unit + " must be below " +
                      upper + " " + number(most) + " " + high.unit + other);
  }
}

struct Evidence {
  double residual, condition;
  int n;
  std::string date, source, serial;
};

/// What every calibration file carries beside its value. A bad calibration is refused here.
Evidence read_evidence(Reader& reader) {
  Evidence evidence;
  evidence.residual = reader.real("residual", 0.0, 0.002, "m");
  evidence.condition = reader.real("condition", 1.0, 1e4, "");
  evidence.n = static_cast<int>(reader.real("n", 1, 1e6, "samples"));
  evidence.date = reader.word("date");
  // A file of before has no source: what has no residual at all was computed.
  evidence.source = reader.has("source")
                        ? reader.choice("source", {"measured", "simulated", "computed"})
                    : evidence.residual > 0 ? "measured"
                                            : "computed";
  if (reader.has("serial")) evidence.serial = reader.word("serial");
  return evidence;
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

/// The text between a prefix such as "arms." and the next dot of every key, in the file's order.
std::vector<std::string> names_in(const Document& document, const std::string& prefix) {
  std::vector<std::string> names;
  for (const auto& [key, value] : document.values) {
    if (key.rfind(prefix, 0) != 0) continue;
    const auto dot = key.find('.', prefix.size());
    const auto length = dot == std::string::npos ? dot : dot - prefix.size();
    const std::string name = key.substr(prefix.size(), length);
    if (names.empty() || names.back() != name) names.push_back(name);  // keys are sorted
  }
  const auto line = [&](const std::string& name) {
    const auto found = document.lines.find(prefix + name);
    return found == document.lines.end() ? 0 : found->second;
  };
  std::stable_sort(names.begin(), names.end(), [&line](const std::string& a, const std::string& b) {
    return line(a) < line(b);
  });
  return names;
}

/// 'prefix': "capsules.NAME." or an obstacle's.
Capsule read_capsule(Reader& reader, const std::string& prefix, double farthest, double widest) {
  Capsule capsule;
  capsule.a = reader.vector(prefix + "from", farthest, "m");
  capsule.b = reader.vector(prefix + "to", farthest, "m");
  capsule.radius = reader.real(prefix + "radius", 0.001, widest, "m");
  return capsule;
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
  const int most = joints.empty() ? kMostToolCapsules : kMostArmCapsules;
  if (static_cast<int>(capsules.size()) > most) {
    reader.fail("capsules",
                "has " + std::to_string(capsules.size()) + "; allowed are " + std::to_string(most));
  }
  return capsules;
}

RobotConfig read_robot(const Document& document) {
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
  robot.position_min = reader.joints("joints.position_min", n, -7.0, 7.0, "rad");
  robot.position_max = reader.joints("joints.position_max", n, -7.0, 7.0, "rad");
  robot.velocity = reader.joints("joints.velocity", n, 0.01, 6.5, "rad/s");
  robot.acceleration = reader.joints("joints.acceleration", n, 0.1, 50.0, "rad/s^2");
  robot.home = reader.joints("joints.home", n, -7.0, 7.0, "rad");
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
  for (const auto& key : kLimitKeys) {
    robot.limits.*key.member =
        reader.real(std::string("limits.") + key.name, key.lowest, key.highest, key.unit);
  }
  for (const auto& key : kTuningKeys) {
    robot.tuning.*key.member =
        reader.real(std::string("tuning.") + key.name, key.lowest, key.highest, key.unit);
  }
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

LinkConfig read_link(const Document& document) {
  Reader reader(document, "surg_link/1");
  LinkConfig link;
  link.name = reader.word("name");
  link.link_timeout = reader.real("link_timeout", kLinkTimeout[0], kLinkTimeout[1], "s");
  link.link_lag = reader.real("link_lag", kLinkLag[0], kLinkLag[1], "s");
  link.acceleration =
      reader.real("acceleration", kLinkAcceleration[0], kLinkAcceleration[1], "of the robot's");
  if (reader.has("dead_man")) {
    link.dead_man = reader.real("dead_man", kDeadMan[0], kDeadMan[1], "s");
  }
  if (reader.has("stop_deceleration")) {
    link.stop_deceleration =
        reader.real("stop_deceleration", kStopDeceleration[0], kStopDeceleration[1], "rad/s^2");
  }
  if (reader.has("driver")) link.driver = reader.word("driver");
  reader.leave("settings");  // of the robot's maker; the driver checks them
  reader.finish();
  return link;
}

InstrumentConfig read_instrument(const Document& document) {
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
  if (reader.has("camera")) instrument.camera = read_camera(reader);
  if (reader.has("passive")) instrument.passive = reader.flag("passive");
  if (instrument.passive && reader.has("jaw")) {
    reader.fail("passive", "true, and there is a 'jaw': nobody drives it; leave 'jaw' out");
  }
  instrument.capsules = read_capsules(reader, document, {});
  reader.finish();
  return instrument;
}

ToolCalibration read_tool(const Document& document) {
  Reader reader(document, "surg_tool/1");
  ToolCalibration tool;
  tool.s_F = reader.vector("shaft_axis", 1.0 + 1e-9, "");
  if (!(std::abs(tool.s_F.norm() - 1.0) < 1e-6)) {
    reader.fail("shaft_axis",
                "has length " + number(tool.s_F.norm()) + "; a unit vector is needed");
  }
  tool.s_F.normalize();
  tool.p_FTip = reader.vector("tip", 1.0, "m");
  const double along = tool.s_F.dot(tool.p_FTip);
  if (!(along > 0)) {
    reader.fail("shaft_axis", "points away from the tip, which is " + number(along) +
                                  " m along it; it must point from the flange to the tip");
  }
  const Evidence evidence = read_evidence(reader);
  tool.residual = evidence.residual;
  tool.condition = evidence.condition;
  tool.n = evidence.n;
  tool.date = evidence.date;
  tool.source = evidence.source;
  tool.serial = evidence.serial;
  reader.finish();
  return tool;
}

TrocarCalibration read_trocar(const Document& document) {
  Reader reader(document, "surg_trocar/1");
  TrocarCalibration trocar;
  trocar.p_BRcm = reader.vector("point", 2.0, "m");
  const Evidence evidence = read_evidence(reader);
  trocar.residual = evidence.residual;
  trocar.condition = evidence.condition;
  trocar.n = evidence.n;
  trocar.date = evidence.date;
  trocar.source = evidence.source;
  trocar.serial = evidence.serial;
  reader.finish();
  return trocar;
}

UrKinematics read_kinematics(const Document& document) {
  Reader reader(document, "surg_kinematics/1");
  UrKinematics own;
  own.file = document.file;
  own.model = reader.word("model");
  own.serial = reader.word("serial");
  own.date = reader.word("date");
  own.theta = reader.joints("theta", kUrJoints, -7.0, 7.0, "rad");
  own.d = reader.joints("d", kUrJoints, -1e4, 1e4, "m");
  own.a = reader.joints("a", kUrJoints, -10.0, 10.0, "m");
  own.alpha = reader.joints("alpha", kUrJoints, -4.0, 4.0, "rad");
  reader.finish();
  return own;
}

/// The day of a date such as "2026-11-23", counted from 1970; nothing where it is none.
std::optional<int> day_of(const std::string& date) {
  std::tm when{};
  int used = 0;
  if (std::sscanf(date.c_str(), "%4d-%2d-%2d%n", &when.tm_year, &when.tm_mon, &when.tm_mday,
                  &used) != 3 ||
      used != static_cast<int>(date.size())) {
    return std::nullopt;
  }
  when.tm_year -= 1900;
  when.tm_mon -= 1;
  const std::tm asked = when;
  const std::time_t seconds = timegm(&when);
  if (when.tm_mon != asked.tm_mon || when.tm_mday != asked.tm_mday) return std::nullopt;
  return static_cast<int>(seconds / 86400);
}

/// A list of a known number of values, each within +-largest.
template <int n>
Eigen::Matrix<double, n, 1> read_numbers(Reader& reader, const std::string& key, double largest) {
  const std::vector<double> list = reader.numbers(key);
  if (list.size() != n) {
    reader.fail(key, "has " + std::to_string(list.size()) +
                         " values; allowed: " + std::to_string(n) + " numbers");
  }
  for (double item : list) {
    // Written so that NaN fails too.
    if (!(std::abs(item) <= largest)) {
      reader.fail(key, "holds " + number(item) + "; allowed: -" + number(largest) + " to " +
                           number(largest));
    }
  }
  return Eigen::Map<const Eigen::Matrix<double, n, 1>>(list.data());
}

Eigen::Quaterniond read_quaternion(Reader& reader, const std::string& key) {
  const Eigen::Vector4d q = read_numbers<4>(reader, key, 1.0 + kUnit);  // x, y, z, w
  if (!(std::abs(q.norm() - 1.0) <= kUnit)) {
    reader.fail(key, "has length " + number(q.norm()) + "; allowed: x, y, z, w of length 1");
  }
  return Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized();
}

/// The rules of surg_core.checked_document: symmetric, positive definite, of a believable size.
Eigen::Matrix<double, 6, 6> read_covariance(Reader& reader, const std::string& key) {
  const Eigen::Matrix<double, 36, 1> list = read_numbers<36>(reader, key, 1.0);
  const Eigen::Matrix<double, 6, 6> C =
      Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(list.data());
  if (!((C - C.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * C.cwiseAbs().maxCoeff())) {
    reader.fail(key, "is not symmetric; allowed: a symmetric 6 x 6 matrix");
  }
  if (!(C.diagonal().minCoeff() > 0)) {
    reader.fail(key, "holds the variance " + number(C.diagonal().minCoeff()) +
                         "; allowed: positive variances");
  }
  const Eigen::Matrix<double, 6, 1> sd = C.diagonal().cwiseSqrt();
  const Eigen::Matrix<double, 6, 6> scaled =
      sd.cwiseInverse().asDiagonal() * C * sd.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> solver(scaled,
                                                                          Eigen::EigenvaluesOnly);
  if (!(solver.eigenvalues()[0] > kLeastEigenvalue)) {
    reader.fail(key, "has the eigenvalue " + number(solver.eigenvalues()[0]) +
                         " (scaled); allowed: a positive definite matrix");
  }
  for (const int at : {0, 3}) {
    const double most = at == 0 ? kLargestTurnSd : kLargestShiftSd;
    const double found = sd.segment<3>(at).maxCoeff();
    const char* unit = at == 0 ? " rad" : " m";
    if (!(found <= most)) {
      reader.fail(key, "holds the standard deviation " + number(found) + unit +
                           "; allowed: at most " + number(most) + unit + ". Measure again");
    }
  }
  return C;
}

BaseCalibration read_base(const Document& document) {
  Reader reader(document, "surg_base/1");
  BaseCalibration base;
  base.file = document.file;
  base.X_WB.translation() = reader.vector("position", kFarthestBase, "m");
  base.X_WB.linear() = read_quaternion(reader, "quaternion").toRotationMatrix();
  base.covariance = read_covariance(reader, "covariance");
  base.method = reader.choice("method", {"touch", "tip", "points"});
  base.residual = reader.real("residual", 0.0, kLargestBaseResidual, "m");
  base.condition = reader.real("condition", 1.0, 1e6, "");
  const double n = reader.real("n", kLeastBasePoints, 1e6, "points");
  if (std::floor(n) != n) reader.fail("n", number(n) + "; allowed: a whole number");
  base.n = static_cast<int>(n);
  base.date = reader.word("date");
  if (!day_of(base.date)) reader.fail("date", "'" + base.date + "'; allowed: \"2026-11-23\"");
  base.source = reader.choice("source", {"measured", "simulated"});
  base.reference = reader.word("reference");
  base.reference_xyz = reader.vector("reference_xyz", kFarthestBase, "m");
  base.reference_rpy = reader.vector("reference_rpy", 6.3, "rad");
  base.camera_sha256 = reader.word("camera_sha256");
  const bool hex = base.camera_sha256.size() == 64 &&
                   base.camera_sha256.find_first_not_of("0123456789abcdef") == std::string::npos;
  if (!hex && base.camera_sha256 != "none") {
    reader.fail("camera_sha256",
                "'" + base.camera_sha256 + "'; allowed: 64 hexadecimal digits, or none");
  }
  reader.finish();
  return base;
}

Fixture read_fixture(Reader& reader, const std::string& key, const std::string& name) {
  Fixture f;
  if (name.size() > Fixture::kLongestName) {
    reader.fail(key, "has " + std::to_string(name.size()) + " characters; allowed are " +
                         std::to_string(Fixture::kLongestName));
  }
  f.set_name(name);
  f.of_cell = true;
  const std::string shape = reader.choice(key + ".shape", {"plane", "sphere", "capsule"});
  const bool stay_in = reader.choice(key + ".side", {"keep_out", "stay_in"}) == "stay_in";
  f.side = stay_in ? Fixture::Side::kStayIn : Fixture::Side::kKeepOut;
  const bool shaft = reader.choice(key + ".of", {"tip", "shaft"}) == "shaft";
  f.of = shaft ? Fixture::Of::kShaft : Fixture::Of::kTip;
  f.point = reader.vector(key + ".point", Fixture::kFarthest, "m");
  if (shape == "plane") {
    f.shape = Fixture::Shape::kPlane;
    f.axis = reader.vector(key + ".normal", 1.001, "");
  } else {
    f.shape = shape == "sphere" ? Fixture::Shape::kSphere : Fixture::Shape::kCapsule;
    const double least = stay_in ? Fixture::kLeastHollow : Fixture::kLeastRadius;
    f.radius = reader.real(key + ".radius", least, Fixture::kGreatestRadius, "m");
    f.axis.setZero();
    if (shape == "capsule") {
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
  hardware.payload_mass = reader.real(prefix + "payload.mass", 0.0, kHeaviestPayload, "kg");
  hardware.payload_cog = reader.vector(prefix + "payload.cog", kFarthestPayload, "m");
  hardware.tool_link = reader.choice(prefix + "tool_link", {"passive", "none"});
  hardware.realtime = static_cast<int>(
      reader.real(prefix + "realtime", kPriorities[0], kPriorities[1], "(SCHED_FIFO)"));
  if (reader.has(prefix + "calibration_days")) {
    hardware.calibration_days =
        static_cast<int>(reader.real(prefix + "calibration_days", 1, kOldestCalibration, "days"));
  }
  if (reader.has(prefix + "link_lag")) {
    hardware.link_lag = reader.real(prefix + "link_lag", kLinkLag[0], kLinkLag[1], "s");
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

constexpr double kPictureSize[] = {16, 7680};  // [px]
constexpr double kPictureRate[] = {1, 240};    // [1/s]
constexpr double kMostLatency = 1.0;           // [s]

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
                    "' is not KIND:ADDRESS, such as v4l2:/dev/video0, decklink:0, gst:PIPELINE, "
                    "file:PATH, pipe:PATH or ros:/left,/right");
  }
  endoscope.layout =
      reader.choice(prefix + "layout", {"two", "sbs", "sbs_half", "top_bottom", "rows", "mono"});
  if (reader.has(prefix + "size")) {
    const std::vector<double> size = reader.numbers(prefix + "size");
    const bool good = size.size() == 2 && std::all_of(size.begin(), size.end(), [](double pixels) {
                        return pixels == std::floor(pixels) && pixels >= kPictureSize[0] &&
                               pixels <= kPictureSize[1];
                      });
    if (!good) {
      reader.fail(prefix + "size",
                  "must be [width, height] of a grabbed picture in whole px; allowed is " +
                      number(kPictureSize[0]) + " to " + number(kPictureSize[1]));
    }
    endoscope.width = static_cast<int>(size[0]);
    endoscope.height = static_cast<int>(size[1]);
  }
  if (reader.has(prefix + "rate")) {
    endoscope.rate = reader.real(prefix + "rate", kPictureRate[0], kPictureRate[1], "1/s");
  }
  if (reader.has(prefix + "swap")) endoscope.swap = reader.flag(prefix + "swap");
  if (reader.has(prefix + "flip")) {
    endoscope.flip =
        reader.choice(prefix + "flip", {"none", "horizontal", "vertical", "rotate_180"});
  }
  if (reader.has(prefix + "latency")) {
    endoscope.latency = reader.real(prefix + "latency", 0.0, kMostLatency, "s");
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
  if (reader.has("clearance.distance")) {
    clearance.distance = reader.real("clearance.distance", kClosest, kFarthest, "m");
  }
  if (reader.has("clearance.shafts")) {
    clearance.shafts = reader.real("clearance.shafts", 0.0, kFarthest, "m");
  }
  for (const std::string& name : names_in(document, "clearance.obstacles.")) {
    clearance.obstacles.push_back(read_obstacle(reader, name));
  }
  return clearance;
}

CellConfig read_cell(const Document& document) {
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
      if (!find_limit(limit)) reader.fail(key, not_a_limit(limit));
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

}  // namespace

RobotConfig parse_robot(const Document& document) { return parse_with_hints(document, read_robot); }

LinkConfig parse_link(const Document& document) { return parse_with_hints(document, read_link); }

/// Its time-out is that of one process among many on a desktop, and its dead-man waits as long
/// (F10). Its lag is 4 ms of delay and 8 ms of the joints' servos (sim_arm.py).
LinkConfig simulator_link() { return {kSimulator, 0.1, 0.012, 1.0}; }

bool CellHardware::emulated() const { return address.rfind("127.", 0) == 0; }

LinkConfig with_measured_lag(const LinkConfig& link, const CellArm& arm) {
  LinkConfig result = link;
  if (arm.hardware && std::isfinite(arm.hardware->link_lag)) {
    result.link_lag = arm.hardware->link_lag;
  }
  return result;
}

RobotConfig with_link(const RobotConfig& robot, const LinkConfig& link) {
  RobotConfig result = robot;
  result.tuning.link_timeout = link.link_timeout;
  result.tuning.link_lag = link.link_lag;
  result.acceleration *= link.acceleration;
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

InstrumentConfig parse_instrument(const Document& document) {
  return parse_with_hints(document, read_instrument);
}

ToolCalibration parse_tool(const Document& document) {
  return parse_with_hints(document, read_tool);
}

TrocarCalibration parse_trocar(const Document& document) {
  return parse_with_hints(document, read_trocar);
}

UrKinematics parse_kinematics(const Document& document) {
  return parse_with_hints(document, read_kinematics);
}

BaseCalibration parse_base(const Document& document) {
  return parse_with_hints(document, read_base);
}

CellConfig parse_cell(const Document& document) { return parse_with_hints(document, read_cell); }

Limits tighten(const Limits& limits, const CellArm& arm, const std::string& cell_file) {
  Limits result = limits;
  for (const auto& [limit, value] : arm.limits) {
    const std::string where = place(arm, "limits." + limit, cell_file) + ": ";
    const LimitKey* key = find_limit(limit);
    if (!key) throw ConfigError(where + not_a_limit(limit));
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
    result.tip_velocity = std::min(result.tip_velocity, kSlowTip);
    result.flange_velocity = std::min(result.flange_velocity, kSlowFlange);
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

void check_tool(const ToolCalibration& tool, const Limits& limits, const std::string& tool_file) {
  const double length = tool.s_F.dot(tool.p_FTip);
  if (limits.depth_max < length) return;
  throw ConfigError(tool_file + ": tip: is " + number(length) +
                    " m along the shaft from the flange, and limits.depth_max " +
                    number(limits.depth_max) +
                    " m would push the flange into the trocar: tighten depth_max in the cell to "
                    "less than that, or calibrate the tool again");
}

void check_hardware(const CellArm& arm, const RobotConfig& robot,
                    const InstrumentConfig& instrument, const ToolCalibration& tool,
                    const TrocarCalibration& trocar, const std::string& cell_file,
                    const std::string& today) {
  if (!arm.hardware) {
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
  const std::string key = place(arm, "hardware", cell_file);
  if ((arm.hardware->tool_link == "passive") != instrument.passive) {
    throw ConfigError(key + ".tool_link: '" + arm.hardware->tool_link + "', and " +
                      instrument.file +
                      " states passive: " + (instrument.passive ? "true" : "false") +
                      "; allowed is 'passive' with a passive instrument, 'none' with another");
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

void check_kinematics(const UrKinematics& own, const CellArm& arm, const RobotConfig& robot) {
  const char* cure = ": delete the file, then read the arm's own: ./surg robot CELL kinematics";
  if (own.model != robot.name) {
    throw ConfigError(own.file + ": model: '" + own.model + "', and the cell's robot is '" +
                      robot.name + "'" + cure);
  }
  if (arm.hardware && arm.hardware->serial != own.serial) {
    throw ConfigError(own.file + ": serial: '" + own.serial + "', and the cell's arm is '" +
                      arm.hardware->serial + "'" + cure);
  }
}

void check_base(const BaseCalibration& base, const CellArm& arm, const CellConfig& cell) {
  const CellArm& first = cell.arms.front();
  const std::string cure = ": delete the file, or repeat ./surg calibrate CELL bases";
  if (arm.name == first.name) {
    throw ConfigError(base.file + ": position: " + arm.name + " is the cell's first arm; allowed " +
                      "is the base that " + cell.file + " states, to which the others are " +
                      "measured: delete the file");
  }
  if (base.reference != first.name) {
    throw ConfigError(base.file + ": reference: '" + base.reference + "'; allowed is the cell's " +
                      "first arm, '" + first.name + "'" + cure);
  }
  const double moved = std::max((base.reference_xyz - first.base_xyz).cwiseAbs().maxCoeff(),
                                (base.reference_rpy - first.base_rpy).cwiseAbs().maxCoeff());
  if (!(moved <= kSameBase)) {
    throw ConfigError(base.file + ": reference_xyz, reference_rpy: differ from arms." + first.name +
                      ".base in " + cell.file + " by up to " + number(moved) +
                      "; allowed is the same: the first arm was moved after this measurement" +
                      cure);
  }
  const bool real = arm.hardware && !arm.hardware->emulated() && !arm.hardware->commissioning;
  if (real && base.source != "measured") {
    throw ConfigError(base.file + ": source: '" + base.source +
                      "'; allowed for a real arm is 'measured'" + cure);
  }
}

std::string limits_hash(const RobotConfig& robot, const Limits& limits) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a, 64 bit
  const auto mix = [&hash](double value) {
    unsigned char bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    for (unsigned char byte : bytes) hash = (hash ^ byte) * 1099511628211ULL;
  };
  for (const auto& key : kLimitKeys) mix(limits.*key.member);
  for (const auto& key : kTuningKeys) mix(robot.tuning.*key.member);
  mix(robot.tuning.link_timeout);
  mix(robot.tuning.link_lag);
  for (const JointVector* values : {&robot.home, &robot.position_min, &robot.position_max,
                                    &robot.velocity, &robot.acceleration}) {
    for (int i = 0; i < values->size(); ++i) mix((*values)[i]);
  }
  if (std::isfinite(robot.elbow)) mix(robot.elbow);
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

}  // namespace surg
