// A Force Dimension device (Lambda.7, Omega.7, Sigma.7) as a CRTK leader:
//   rosrun surg_lambda7 lambda7_node _name:=MTMR
// Publishes /<name>/measured_cp in the view frame, gripper/measured_js, buttons, operating_state
// and error. Parameters: ~name (lambda7), ~device (-1: the first free one; or its number from 0),
// ~master_to_view (a rotation, nine numbers row by row), ~auto_init (true), ~max_force [N] (5),
// ~publish_rate [Hz] (500), ~haptics (false: zero force; true: /<name>/servo_cf is felt),
// ~haptic_scale (1: force on the hand over force at the tip), ~clutch_button (-1: none; or the bit
// that is /footpedals/clutch). Exit code 0: ended by the user; 1: no library, no device, or it was
// lost; 2: invalid parameter.
#include <crtk_msgs/OperatingState.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/WrenchStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>
#include <std_msgs/String.h>

#include <Eigen/Geometry>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "felt_force.hpp"
#include "handle.hpp"
#include "sdk.hpp"
#include "view.hpp"

namespace surg_teleop {
namespace {

constexpr int kLoopRate = 1000;  // [Hz] as the vendor requires, so that a free handle feels free
constexpr int kButtons = 8;
constexpr int kStateRate = 20;         // [Hz] of state and buttons, so that their end is noticed
constexpr double kMaxForceLimit = 20;  // [N] of a Lambda.7

constexpr double kMinScale = 0.01;  // of the tip's force, and least ~max_force with it [N]
constexpr double kMaxScale = 10.0;

std::atomic<bool> stop_requested{false};

void request_stop(int) { stop_requested = true; }

struct Options {
  std::string name = "lambda7";
  int device = -1;
  Eigen::Matrix3d R_VM;
  bool auto_init = true;
  double max_force = 5.0;
  int publish_rate = 500;
  int clutch_button = -1;
  bool haptics = false;
  double haptic_scale = 1.0;
};

/// Reads a parameter; false, with the reason on stderr, if its type is wrong.
template <typename T>
bool parameter(const std::string& name, T* value) {
  const std::string key = ros::this_node::getName() + "/" + name;
  if (!ros::param::has(key) || ros::param::get(key, *value)) return true;
  std::fprintf(stderr, "lambda7: ~%s: wrong type\n", name.c_str());
  return false;
}

bool in_range(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return true;
  std::fprintf(stderr, "lambda7: ~%s: %g; allowed: %g to %g\n", name, value, low, high);
  return false;
}

std::optional<Options> read_options() {
  Options options;
  std::vector<double> rows = kSeated;
  if (!parameter("name", &options.name) || !parameter("device", &options.device) ||
      !parameter("master_to_view", &rows) || !parameter("auto_init", &options.auto_init) ||
      !parameter("max_force", &options.max_force) ||
      !parameter("publish_rate", &options.publish_rate) ||
      !parameter("clutch_button", &options.clutch_button) ||
      !parameter("haptics", &options.haptics) ||
      !parameter("haptic_scale", &options.haptic_scale)) {
    return std::nullopt;
  }
  std::string why;
  const std::optional<Eigen::Matrix3d> R_VM = master_to_view(rows, &why);
  if (!R_VM) {
    std::fprintf(stderr, "lambda7: ~master_to_view: %s\n", why.c_str());
    return std::nullopt;
  }
  if (!ros::names::validate(options.name, why) || options.name.empty() || options.name[0] == '/') {
    std::fprintf(stderr, "lambda7: ~name: '%s'; allowed: a ROS name without a leading slash\n",
                 options.name.c_str());
    return std::nullopt;
  }
  if (!in_range("device", options.device, -1, 15) ||
      !in_range("max_force", options.max_force, 0, kMaxForceLimit) ||
      !in_range("publish_rate", options.publish_rate, 50, kLoopRate) ||
      !in_range("clutch_button", options.clutch_button, -1, kButtons - 1) ||
      !in_range("haptic_scale", options.haptic_scale, kMinScale, kMaxScale) ||
      (options.haptics && !in_range("max_force", options.max_force, kMinScale, kMaxForceLimit))) {
    return std::nullopt;
  }
  options.R_VM = *R_VM;
  return options;
}

/// The topics of the leader.
class Topics {
 public:
  Topics(ros::NodeHandle* node, const Options& options) : options_(options) {
    const std::string prefix = "/" + options.name + "/";
    pose_ = node->advertise<geometry_msgs::PoseStamped>(prefix + "measured_cp", 1);
    gripper_ = node->advertise<sensor_msgs::JointState>(prefix + "gripper/measured_js", 1);
    buttons_ = node->advertise<sensor_msgs::Joy>(prefix + "buttons", 10, true);
    state_ = node->advertise<crtk_msgs::OperatingState>(prefix + "operating_state", 10, true);
    error_ = node->advertise<std_msgs::String>(prefix + "error", 10, true);
    if (options.clutch_button >= 0) {
      clutch_ = node->advertise<sensor_msgs::Joy>("/footpedals/clutch", 10, true);
    }
  }

  void publish_reading(const Reading& reading, bool has_gripper) {
    const HandlePose handle = in_view(reading, options_.R_VM);
    const Eigen::Quaterniond q(handle.R_VH);
    geometry_msgs::PoseStamped pose;
    pose.header.stamp = ros::Time::now();
    pose.pose.position.x = handle.p_VH.x();
    pose.pose.position.y = handle.p_VH.y();
    pose.pose.position.z = handle.p_VH.z();
    pose.pose.orientation.x = q.x();
    pose.pose.orientation.y = q.y();
    pose.pose.orientation.z = q.z();
    pose.pose.orientation.w = q.w();
    pose_.publish(pose);
    if (!has_gripper) return;
    sensor_msgs::JointState gripper;
    gripper.header.stamp = pose.header.stamp;
    gripper.name = {"gripper"};
    gripper.position = {reading.gripper};
    gripper_.publish(gripper);
  }

  void publish_buttons(unsigned int mask) {
    std::vector<int> buttons;
    for (int i = 0; i < kButtons; ++i) buttons.push_back(static_cast<int>(mask >> i & 1u));
    publish_joy(buttons_, buttons);
    if (clutch_) publish_joy(clutch_, {buttons[static_cast<std::size_t>(options_.clutch_button)]});
  }

  void publish_state(const char* name, bool homed) {
    crtk_msgs::OperatingState state;
    state.header.stamp = ros::Time::now();
    state.state = name;
    state.is_homed = homed;
    state_.publish(state);
  }

  /// The end of the readings: whoever follows this clutch must hold.
  void publish_end(const char* state, bool homed) {
    publish_state(state, homed);
    if (clutch_) publish_joy(clutch_, {1});
  }

  void publish_error(const std::string& text) {
    std::fprintf(stderr, "lambda7: %s\n", text.c_str());
    std_msgs::String message;
    message.data = text;
    error_.publish(message);
  }

 private:
  static void publish_joy(const ros::Publisher& publisher, const std::vector<int>& buttons) {
    sensor_msgs::Joy joy;
    joy.header.stamp = ros::Time::now();
    joy.buttons = buttons;
    publisher.publish(joy);
  }

  const Options options_;
  ros::Publisher pose_, gripper_, buttons_, state_, error_, clutch_;
};

using Clock = std::chrono::steady_clock;

/// The topic of what the hand feels. Without ~haptics nothing is subscribed, and the force is zero.
class Feeling {
 public:
  Feeling(ros::NodeHandle* node, const Options& options)
      : haptics_(options.haptics), felt_(limits(options), options.R_VM) {
    if (!haptics_) return;
    force_ = node->subscribe("/" + options.name + "/servo_cf", 1, &Feeling::take, this,
                             ros::TransportHints().tcpNoDelay());
  }

  /// The force of this cycle in the device's axes [N].
  Eigen::Vector3d step(const Reading& reading, bool known) {
    if (haptics_ && known) return felt_.step(reading.p_MH, seconds());
    felt_.skip(seconds());
    return Eigen::Vector3d::Zero();
  }

 private:
  static double seconds() {
    return std::chrono::duration<double>(Clock::now().time_since_epoch()).count();
  }

  static HapticLimits limits(const Options& options) {
    HapticLimits limits;
    limits.scale = options.haptic_scale;
    limits.max_force = options.max_force;
    return limits;
  }

  void take(const geometry_msgs::WrenchStamped& message) {
    const auto& f = message.wrench.force;
    felt_.take(Eigen::Vector3d(f.x, f.y, f.z), !message.header.stamp.isZero(), seconds());
  }

  const bool haptics_;
  FeltForce felt_;
  ros::Subscriber force_;
};

/// Reads and commands a force until the device is lost or the user ends it.
int run(Handle* handle, const Options& options, Topics* topics, Feeling* feeling) {
  const int publish_every = kLoopRate / options.publish_rate;
  const auto period = std::chrono::microseconds(1000000 / kLoopRate);
  auto next = Clock::now();
  Reading reading;
  bool fresh = false;
  bool known = false;  // whether there is a reading
  std::optional<unsigned int> buttons;
  for (long tick = 0; !stop_requested && ros::ok(); ++tick) {
    ReadResult result = handle->read(&reading);
    known = known || result == ReadResult::kNew;
    if (result != ReadResult::kLost) {
      result = handle->command(feeling->step(reading, known), result);
    }
    if (result == ReadResult::kLost) {
      topics->publish_end("FAULT", false);
      topics->publish_error(handle->error());
      return 1;
    }
    fresh = fresh || result == ReadResult::kNew;
    if (fresh && tick % publish_every == 0) {
      topics->publish_reading(reading, handle->has_gripper());
      fresh = false;
    }
    const bool repeat = tick % (kLoopRate / kStateRate) == 0;
    const bool changed = result == ReadResult::kNew && buttons != reading.buttons;
    if (changed) buttons = reading.buttons;
    if (repeat) topics->publish_state("ENABLED", true);
    if (buttons && (changed || repeat)) topics->publish_buttons(*buttons);
    next += period;
    const auto now = Clock::now();
    if (next < now) next = now;  // lost time is not made up for
    std::this_thread::sleep_until(next);
  }
  topics->publish_end("DISABLED", true);
  return 0;
}

int main_in_ros() {
  const std::optional<Options> options = read_options();
  if (!options) return 2;
  const Loaded loaded = load(places());
  if (!loaded.sdk) {
    std::fprintf(stderr, "lambda7: the Force Dimension SDK was not found. Tried, in this order:\n");
    for (const std::string& line : loaded.tried) std::fprintf(stderr, "  %s\n", line.c_str());
    std::fprintf(stderr,
                 "Get the SDK from its maker, unpack it and set FDSDK to its folder, or "
                 "FORCEDIM_LIBRARY to its libdrd.so.3.*\n");
    return 1;
  }
  ros::NodeHandle node;
  Topics topics(&node, *options);
  topics.publish_state("DISABLED", false);
  Handle handle(*loaded.sdk);
  std::string problem = handle.open(options->device);
  if (problem.empty()) {
    std::printf("lambda7: %s, by %s\n", handle.name().c_str(), loaded.path.c_str());
    if (!handle.initialized() && !options->auto_init) {
      problem =
          handle.name() +
          " has not found its reference; put it into its rest, or start with _auto_init:=true and "
          "hands off: the handle then moves by itself";
    } else if (!handle.initialized()) {
      std::printf("lambda7: finding its reference: HANDS OFF, the handle moves by itself\n");
      std::fflush(stdout);
      problem = handle.initialize();
    }
  }
  if (problem.empty()) problem = handle.start(options->max_force);
  int status = 1;
  if (problem.empty()) {
    std::fflush(stdout);
    Feeling feeling(&node, *options);
    ros::AsyncSpinner spinner(1);
    spinner.start();
    status = run(&handle, *options, &topics, &feeling);
  } else {
    topics.publish_state("FAULT", false);
    topics.publish_error(problem);
  }
  // The last messages must leave the sockets.
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  return status;
}

}  // namespace
}  // namespace surg_teleop

int main(int argc, char** argv) {
  ros::init(argc, argv, "lambda7", ros::init_options::NoSigintHandler);
  if (!ros::master::check()) {
    std::fprintf(stderr,
                 "lambda7: no ROS master at %s; start one with 'rosmaster --core' or './surg up "
                 "CELL'\n",
                 ros::master::getURI().c_str());
    return 1;
  }
  std::signal(SIGINT, surg_teleop::request_stop);
  std::signal(SIGTERM, surg_teleop::request_stop);
  std::signal(SIGHUP, surg_teleop::request_stop);
  ros::start();
  const int status = surg_teleop::main_in_ros();
  ros::shutdown();
  return status;
}
