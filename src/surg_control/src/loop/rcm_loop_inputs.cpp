// RcmLoop's incoming half: what links, participants and commanders send, in the thread of run().
#include <std_msgs/String.h>

#include <limits>

#include "surg_control/files/force_sensor.hpp"
#include "surg_control/loop/rcm_loop.hpp"
#include "surg_control/loop/realtime.hpp"
#include "surg_control/monitor/clock_watch.hpp"
#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

constexpr std::uint32_t kEveryMessage = 0;
/// F11: a joint state older than the last one by at most this was reordered on its way. A larger
/// difference is a step of the link's clock, which must not stop an arm.
constexpr std::int64_t kReorderedNs = 5 * static_cast<std::int64_t>(kTickNs);

std::string without_slash(const std::string& caller) {
  return !caller.empty() && caller.front() == '/' ? caller.substr(1) : caller;
}

bool enters_enabled(const CommandItem& item) {
  return item.kind == CommandItem::Kind::kState &&
         (item.state == surg::StateCommand::kEnable || item.state == surg::StateCommand::kResume);
}

}  // namespace

/// Lock-step loses no message; in free-run the newest one counts.
template <typename Message>
void RcmLoop::listen(const std::string& topic, const std::function<void(const Message&)>& take) {
  const boost::function<void(const typename Message::ConstPtr&)> callback =
      [take](const auto& message) { take(*message); };
  subscribers_.push_back(node_.subscribe<Message>(topic, options_.lockstep ? kEveryMessage : 1,
                                                  callback, ros::VoidConstPtr(),
                                                  ros::TransportHints().tcpNoDelay()));
}

void RcmLoop::subscribe_link() {
  using geometry_msgs::WrenchStamped;
  using sensor_msgs::JointState;
  const std::string prefix = "/" + arm_ + "/";
  listen<JointState>(prefix + "robot/measured_js",
                     [this](const auto& message) { on_robot_state(message); });
  listen<JointState>(prefix + "tool/measured_js",
                     [this](const auto& message) { on_tool_state(message); });
  // In lock-step the simulator's own forces come, where a task has them.
  if (!options_.lockstep && force_is_required(setup_)) {
    cycle_->require_force_below(setup_.limits.depth_slow);
  }
  for (const auto& [topic, which] : {std::pair{"tool/measured_cf", &LinkState::tip},
                                     std::pair{"trocar/measured_cf", &LinkState::trocar}}) {
    listen<WrenchStamped>(prefix + topic,
                          [this, which = which](const auto& message) { on_force(message, which); });
  }
  listen<surg_msgs::LinkStatus>(prefix + "robot/status",
                                [this](const auto& message) { on_link_status(message); });
  if (!options_.lockstep) return;
  listen<surg_msgs::Ready>("/sim/ready", [this](const auto& message) { on_ready(message); });
}

/// The clearance guard follows the other arms. In lock-step a tick waits for their states too.
void RcmLoop::subscribe_others() {
  if (!clearance_.missing.empty()) {
    reporter_->warning_once(
        "no_clearance", arm_ + ": no distance is kept to the other arms: " + clearance_.missing);
  }
  const std::size_t n = clearance_.setup.others.size();
  if (options_.lockstep) other_ticks_.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const std::string topic = "/" + clearance_.setup.others[i].name + "/robot/measured_js";
    listen<sensor_msgs::JointState>(topic,
                                    [this, i](const auto& message) { on_other_state(message, i); });
  }
}

void RcmLoop::on_other_state(const sensor_msgs::JointState& message, std::size_t which) {
  if (message.header.stamp.isZero()) return;  // CRTK: data that is not valid
  LinkState state;
  const std::string problem = decode_state_of_robot(message, clearance_.joint_names[which], state);
  if (!problem.empty()) {
    reporter_->warning("other_arm_state",
                       arm_ + ": " + clearance_.setup.others[which].name + ": " + problem, now());
    return;
  }
  OtherState& other = link_.others[which];
  const std::int64_t stamp_ns = static_cast<std::int64_t>(state.stamp_ns);
  other = {options_.lockstep ? stamp_ns : steady_ns(), state.q, state.qd};
  if (!options_.lockstep) {
    latest_link_.put(link_);
    return;
  }
  other_ticks_[which] = state.stamp_ns / kTickNs;
  try_step();
}

/// F09: counts stamps from the future; control does not use stamps as times.
void RcmLoop::note_stamp(const ros::Time& stamp) {
  if (options_.lockstep) return;  // stamps are ticks
  const auto wall_ns = static_cast<std::int64_t>(ros::WallTime::now().toNSec());
  if (!is_from_the_future(static_cast<std::int64_t>(stamp.toNSec()), wall_ns)) return;
  ++health_.future_stamps;
  reporter_->warning("future_stamp",
                     arm_ + ": a message is stamped " +
                         std::to_string((stamp - ros::Time().fromNSec(wall_ns)).toSec()) +
                         " s in the future; allowed is 0.05 s; nothing is decided by it: "
                         "synchronise the clocks of the machines",
                     now());
}

void RcmLoop::on_command(const std::string& topic, const std::string& caller,
                         const ros::Time& stamp, Decoded decoded) {
  const std::string sender = without_slash(caller);
  if (options_.lockstep) {
    if (!lockstep_gate_.declared(sender)) report_undeclared(caller);
    lockstep_gate_.received(sender);
  }
  note_stamp(stamp);
  // Not in lock-step: when a busy master answers again would decide what a run does.
  if (!options_.lockstep && decoded.reason == surg::Reason::kNone && health_.master_lost &&
      enters_enabled(decoded.item)) {
    decoded.reason = surg::Reason::kMasterLost;
    decoded.detail = surg::sentence(decoded.reason);
  }
  if (decoded.reason != surg::Reason::kNone) {
    count_refused(topic);
    reporter_->warning(topic + surg::name(decoded.reason),
                       arm_ + ": " + topic + " from " + caller + " refused: " + decoded.detail,
                       now());
  } else {
    decoded.item.source = sources_.id(caller);
    decoded.item.stamp_ns = stamp.toNSec();
    if (!enqueue(topic, sender, decoded)) {
      count_refused(topic);
      reporter_->warning("flood",
                         arm_ + ": commands come faster than 500 Hz can take them; " + topic +
                             " from " + caller + " is dropped: send at most one per cycle",
                         now());
    }
  }
  if (options_.lockstep) try_step();
}

/// Reads a tool's files here, not in the control thread; of an enabled arm not at all, since a slow
/// disk would hold up its joint states. The cycle judges again.
Decoded RcmLoop::read_tool(const std::string& words) {
  Decoded decoded;
  decoded.item.kind = CommandItem::Kind::kTool;
  if (!disabled_) {
    decoded.reason = surg::Reason::kToolWhileEnabled;
    decoded.detail = surg::sentence(decoded.reason);
    return decoded;
  }
  try {
    decoded.item.tool = &tools_.emplace_back(surg::load_tool(setup_, words));
  } catch (const surg::ConfigError& error) {
    decoded.reason = surg::Reason::kRefusedTransition;
    decoded.detail = std::string(error.what()) + "; the old tool stays mounted";
  }
  return decoded;
}

/// Queues a command for the next cycle; false if there is no room.
bool RcmLoop::enqueue(const std::string& topic, const std::string& sender, const Decoded& decoded) {
  if (options_.lockstep) return lockstep_gate_.push(sender, topic, decoded.item);
  CommandItem item = decoded.item;
  item.received_ns = steady_ns();
  return commands_.push(item);
}

void RcmLoop::count_refused(const std::string& topic) {
  ++refused_by_node_;
  if (topic.find("move_") != std::string::npos) ++moves_refused_by_node_;
}

void RcmLoop::report_undeclared(const std::string& caller) {
  if (!undeclared_seen_.insert(caller).second) return;
  std_msgs::String message;
  message.data = caller;
  undeclared_.publish(message);
  reporter_->status(arm_ + ": undeclared sender " + caller +
                    " is obeyed, but this run cannot be repeated bit for bit: declare it in "
                    "~participants of controller and simulator");
}

void RcmLoop::on_robot_state(const sensor_msgs::JointState& message) {
  if (message.header.stamp.isZero()) return;  // CRTK: data that is not valid
  LinkState state = link_;                    // keeps the jaw; an unusable message leaves no trace
  const std::string problem = decode_state_of_robot(message, setup_.robot.joint_names, state);
  if (!problem.empty()) {
    reporter_->warning("robot_state", arm_ + ": " + problem, now());
    return;
  }
  if (!options_.lockstep) {
    note_stamp(message.header.stamp);
    const auto newer_by = static_cast<std::int64_t>(state.stamp_ns - link_.stamp_ns);
    if (link_.stamp_ns != 0 && newer_by <= 0 && newer_by >= -kReorderedNs) {
      ++health_.late_states;
      return;
    }
    state.received_ns = steady_ns();
    link_ = state;
    latest_link_.put(link_);
    return;
  }
  if (state.stamp_ns % kTickNs != 0) {
    reporter_->warning("grid",
                       arm_ + ": robot/measured_js has stamp " + std::to_string(state.stamp_ns) +
                           " ns, which is no multiple of 2000000 ns: in lock-step a stamp is a "
                           "tick; start both sides with the same ~mode",
                       now());
    return;
  }
  on_tick(state);
}

void RcmLoop::on_tool_state(const sensor_msgs::JointState& message) {
  if (message.header.stamp.isZero() && !options_.lockstep) {  // the drive says that it has failed
    link_.jaw_received_ns = 0;
    latest_link_.put(link_);
  }
  const std::optional<surg::WristConfig>& wrist = setup_.mounted.instrument.wrist;
  const std::size_t joints = !wrist ? 1 : wrist->rolls() ? 4 : 3;
  if (message.header.stamp.isZero() || message.position.size() != joints) return;
  link_.jaw = message.position[wrist ? 2 : 0];
  const auto driven = [](const std::vector<double>& of) {
    return surg::DriveJoints(of[0], of[1], of.size() > 3 ? of[3] : 0);
  };
  if (wrist) {
    link_.wrist = driven(message.position);
    link_.wrist_rate.setZero();
    if (message.velocity.size() == joints) link_.wrist_rate = driven(message.velocity);
  }
  if (!options_.lockstep) {
    note_stamp(message.header.stamp);
    link_.jaw_received_ns = steady_ns();
    latest_link_.put(link_);
    return;
  }
  tool_tick_ = message.header.stamp.toNSec() / kTickNs;
  try_step();
}

void RcmLoop::on_force(const geometry_msgs::WrenchStamped& message,
                       MeasuredForce LinkState::*which) {
  const std::string& frame = message.header.frame_id;
  if (!frame.empty() && frame != arm_ + "_base") {
    reporter_->warning("force_frame",
                       arm_ + ": a measured force is in frame '" + frame + "' and not obeyed; " +
                           "allowed is '" + arm_ + "_base' or an empty one",
                       now());
    return;
  }
  const geometry_msgs::Vector3& f = message.wrench.force;
  MeasuredForce& force = link_.*which;
  force.f_B = {f.x, f.y, f.z};
  constexpr double kNotKnown = std::numeric_limits<double>::infinity();
  if (!force.f_B.allFinite()) force.f_B.setConstant(std::numeric_limits<double>::quiet_NaN());
  if (message.header.stamp.isZero()) force.f_B.setConstant(kNotKnown);  // CRTK: data not valid
  force.received_ns =
      options_.lockstep ? static_cast<std::int64_t>(robot_tick_ * kTickNs) + 1 : steady_ns();
  if (!options_.lockstep) latest_link_.put(link_);
}

void RcmLoop::on_ready(const surg_msgs::Ready& message) {
  std::uint64_t sent = 0;
  for (std::size_t i = 0; i < message.arms.size() && i < message.sent.size(); ++i) {
    if (message.arms[i] == arm_) sent = message.sent[i];
  }
  lockstep_gate_.ready(message.participant, message.tick, sent);
  try_step();
}

/// F33: what the link says of its robot; in lock-step it belongs to the tick of its stamp.
void RcmLoop::on_link_status(const surg_msgs::LinkStatus& message) {
  const bool lockstep = message.lockstep;
  if (!time_is_checked_ && lockstep != options_.lockstep) {
    reporter_->error(arm_ + ": the robot link keeps time in " +
                     (lockstep ? "lock-step" : "free-run") + " and this controller in " +
                     (options_.lockstep ? "lock-step" : "free-run") +
                     ": start both with the same ~mode");
  }
  time_is_checked_ = true;
  link_.condition = condition_of(message);
  if (!options_.lockstep) {
    link_.condition_received_ns = steady_ns();
    latest_link_.put(link_);
    return;
  }
  status_tick_ = message.header.stamp.toNSec() / kTickNs;
  try_step();
}

surg::RobotCondition RcmLoop::condition_of(const surg_msgs::LinkStatus& message) {
  const surg::RobotCondition condition = surg::robot_condition(message.condition);
  if (condition == surg::RobotCondition::kActive && !message.command.empty() &&
      message.command != sends_) {
    reporter_->robot_says("the link obeys '" + message.command + "' and the controller sends '" +
                          sends_ + "': start both alike, by ~link or the robot's YAML");
    return surg::RobotCondition::kOtherCommand;
  }
  reporter_->robot_says(message.fault.empty() ? surg::sentence(condition) : message.fault);
  return condition;
}

}  // namespace surg_control
