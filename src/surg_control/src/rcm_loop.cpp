#include "surg_control/rcm_loop.hpp"

#include <std_msgs/String.h>

#include <cmath>
#include <cstdlib>
#include <functional>

#include "surg_control/realtime.hpp"

namespace surg_control {
namespace {

constexpr std::uint32_t kUnbounded = 0;      // lock-step loses nothing
constexpr std::uint32_t kCommandQueue = 64;  // free-run: roscpp's own queue per topic
constexpr std::size_t kCommandRing = 256;    // free-run: waiting for the control thread
constexpr std::size_t kRecordRing = 512;     // free-run: one second of cycles for the publisher
constexpr double kLongPeriodUs = 5 * kTick * 1e6;  // F27: an overrun of five periods …
constexpr int kLongPeriodsAllowed = 3;             // … more than three times in a row

std::string without_slash(const std::string& caller) {
  return !caller.empty() && caller.front() == '/' ? caller.substr(1) : caller;
}

/// The testing knob of the determinism tests: sleeps before an answer, in milliseconds.
double jitter_from_environment() {
  const char* text = std::getenv("SURG_TEST_JITTER_MS");
  return text == nullptr ? 0.0 : std::max(0.0, std::atof(text));
}

}  // namespace

RcmLoop::RcmLoop(const ros::NodeHandle& private_node)
    : options_(read_options(private_node)),
      setup_(load_arm(options_.cell, options_.arm)),
      model_(load_model(setup_.robot, setup_.robot_urdf)),
      twist_(commands_twist(options_, setup_)),
      arm_(setup_.arm.name),
      gate_(options_.participants),
      jitter_ms_(jitter_from_environment()),
      jitter_(std::random_device{}()),
      commands_(kCommandRing),
      records_(options_.lockstep ? 1 : kRecordRing) {
  check_for_arm(options_, setup_);
  sem_init(&records_waiting_, 0, 0);
  surg::Controller::Options controller;
  controller.law = options_.law;
  controller.dt = kTick;
  controller.feedback_gain = options_.feedback_gain;
  controller_ = std::make_unique<surg::Controller>(model_.chain, setup_.robot, setup_.limits,
                                                   setup_.instrument, setup_.tool, controller);
  controller_->set_rcm(setup_.trocar.p_BRcm);
  cycle_ = std::make_unique<ControlCycle>(*controller_);

  node_.setCallbackQueue(&queue_);
  node_.setParam("/" + arm_ + "/robot_description", model_.urdf);
  announcer_ = std::make_unique<Announcer>(node_, arm_);
  const Outlets::Facts facts{options_.lockstep, twist_,
                             options_.law == surg::Law::kPaper ? "paper" : "ours",
                             surg::limits_hash(setup_.robot, setup_.limits)};
  outlets_ = std::make_unique<Outlets>(node_, setup_, facts, sources_, *announcer_);

  const std::string prefix = "/" + arm_ + "/";
  const std::uint32_t depth = options_.lockstep ? kUnbounded : 1;
  robot_ = twist_ ? node_.advertise<geometry_msgs::TwistStamped>(prefix + "robot/servo_cv", depth)
                  : node_.advertise<sensor_msgs::JointState>(prefix + "robot/servo_jv", depth);
  tool_ = node_.advertise<sensor_msgs::JointState>(prefix + "tool/servo_jp", depth);
  joint_command_.name = setup_.robot.joint_names;
  twist_command_.header.frame_id = arm_ + "_base";
  tool_command_.name = {"jaw"};
  if (options_.lockstep) {
    undeclared_ = node_.advertise<std_msgs::String>("/sim/undeclared", 10, true);
  }
  subscribe_commands();
}

RcmLoop::~RcmLoop() { sem_destroy(&records_waiting_); }

// --- coming in ---

template <typename Message>
void RcmLoop::subscribe_command(const std::string& topic,
                                std::function<Decoded(const Message&)> decode) {
  using Event = ros::MessageEvent<const Message>;
  const boost::function<void(const Event&)> callback = [this, topic, decode](const Event& event) {
    take_command(topic, event.getPublisherName(), decode(*event.getConstMessage()));
  };
  subscribers_.push_back(node_.subscribe<Message>(
      "/" + arm_ + "/" + topic, options_.lockstep ? kUnbounded : kCommandQueue, callback,
      ros::VoidConstPtr(), ros::TransportHints().tcpNoDelay()));
}

void RcmLoop::subscribe_commands() {
  using geometry_msgs::PoseStamped;
  using geometry_msgs::TwistStamped;
  using sensor_msgs::JointState;
  using surg::Motion;
  const std::string rcm = arm_ + "_rcm";
  const std::string base = arm_ + "_base";
  for (const Motion motion : {Motion::kServoCp, Motion::kInterpolateCp, Motion::kMoveCp}) {
    subscribe_command<PoseStamped>(topic_of(motion), [motion, rcm](const PoseStamped& message) {
      return decode_pose(message, motion, rcm);
    });
  }
  for (const Motion motion : {Motion::kServoJp, Motion::kServoJv}) {
    subscribe_command<JointState>(topic_of(motion), [motion](const JointState& message) {
      return decode_joints(message, motion);
    });
  }
  subscribe_command<TwistStamped>(
      "servo_cv", [rcm](const TwistStamped& message) { return decode_twist(message, rcm); });
  subscribe_command<JointState>("jaw/servo_jp", decode_jaw);
  subscribe_command<std_msgs::Empty>("hold", [](const std_msgs::Empty&) { return decode_hold(); });
  subscribe_command<crtk_msgs::StringStamped>("state_command", decode_state);
  subscribe_command<PoseStamped>(
      "rcm/set_cp", [base](const PoseStamped& message) { return decode_rcm(message, base); });

  const std::string prefix = "/" + arm_ + "/";
  const auto hints = ros::TransportHints().tcpNoDelay();
  const std::uint32_t depth = options_.lockstep ? kUnbounded : 1;
  const boost::function<void(const JointState::ConstPtr&)> robot = [this](const auto& message) {
    on_robot_state(*message);
  };
  const boost::function<void(const JointState::ConstPtr&)> tool = [this](const auto& message) {
    on_tool_state(*message);
  };
  subscribers_.push_back(node_.subscribe<JointState>(prefix + "robot/measured_js", depth, robot,
                                                     ros::VoidConstPtr(), hints));
  subscribers_.push_back(node_.subscribe<JointState>(prefix + "tool/measured_js", depth, tool,
                                                     ros::VoidConstPtr(), hints));
  const boost::function<void(const surg_msgs::LinkStatus::ConstPtr&)> status =
      [this](const auto& message) { on_link_status(*message); };
  link_status_ = node_.subscribe<surg_msgs::LinkStatus>(prefix + "robot/status", 1, status);
  if (!options_.lockstep) return;
  const boost::function<void(const surg_msgs::Ready::ConstPtr&)> ready =
      [this](const auto& message) { on_ready(*message); };
  subscribers_.push_back(node_.subscribe<surg_msgs::Ready>("/sim/ready", kUnbounded, ready,
                                                           ros::VoidConstPtr(), hints));
}

void RcmLoop::take_command(const std::string& topic, const std::string& caller, Decoded decoded) {
  const std::string sender = without_slash(caller);
  if (options_.lockstep) {
    if (!gate_.declared(sender)) report_undeclared(caller);
    gate_.received(sender);
  }
  if (!decoded.ignored.empty()) {
    announcer_->warning_once(topic + decoded.ignored,
                             arm_ + ": " + topic + " from " + caller + ": " + decoded.ignored);
  }
  if (decoded.reason == surg::Reason::kNone) {
    decoded.item.source = sources_.id(caller);
    if (options_.lockstep) {
      gate_.push(sender, topic, decoded.item);
    } else if (!commands_.push(decoded.item)) {
      ++refused_by_node_;
      announcer_->warning("flood",
                          arm_ + ": commands come faster than 500 Hz can take them; " + topic +
                              " from " + caller + " is dropped: send at most one per cycle",
                          now());
    }
  } else {
    ++refused_by_node_;
    announcer_->warning(topic + surg::name(decoded.reason),
                        arm_ + ": " + topic + " from " + caller + " refused: " + decoded.detail,
                        now());
  }
  if (options_.lockstep) try_step();
}

void RcmLoop::report_undeclared(const std::string& caller) {
  if (!undeclared_seen_.insert(caller).second) return;
  std_msgs::String message;
  message.data = caller;
  undeclared_.publish(message);
  announcer_->status(arm_ + ": undeclared sender " + caller +
                     " is obeyed, but this run cannot be repeated bit for bit: declare it in "
                     "~participants of controller and simulator");
}

void RcmLoop::on_robot_state(const sensor_msgs::JointState& message) {
  if (message.header.stamp.isZero()) return;  // CRTK: data that is not valid
  LinkState state = link_;                    // keeps the jaw; an unusable message leaves no trace
  const std::string problem = decode_state_of_robot(message, setup_.robot.joint_names, state);
  if (!problem.empty()) {
    announcer_->warning("robot_state", arm_ + ": " + problem, now());
    return;
  }
  if (!options_.lockstep) {
    state.received_ns = steady_ns();
    link_ = state;
    link_box_.put(link_);
    return;
  }
  if (state.stamp_ns % kTickNs != 0) {
    announcer_->warning("grid",
                        arm_ + ": robot/measured_js has stamp " + std::to_string(state.stamp_ns) +
                            " ns, which is no multiple of 2000000 ns: in lock-step a stamp is a "
                            "tick; start both sides with the same ~mode",
                        now());
    return;
  }
  on_tick(state);
}

void RcmLoop::on_tool_state(const sensor_msgs::JointState& message) {
  if (message.header.stamp.isZero() || message.position.size() != 1) return;
  link_.jaw = message.position[0];
  if (!options_.lockstep) {
    // Goes to the control thread with the next joint state, at most one period from now.
    return;
  }
  tool_tick_ = message.header.stamp.toNSec() / kTickNs;
  try_step();
}

void RcmLoop::on_ready(const surg_msgs::Ready& message) {
  std::uint64_t sent = 0;
  for (std::size_t i = 0; i < message.arms.size() && i < message.sent.size(); ++i) {
    if (message.arms[i] == arm_) sent = message.sent[i];
  }
  gate_.ready(message.participant, message.tick, sent);
  try_step();
}

void RcmLoop::on_link_status(const surg_msgs::LinkStatus& message) {
  if (static_cast<bool>(message.lockstep) != options_.lockstep) {
    announcer_->error(arm_ + ": the robot link keeps time in " +
                      (message.lockstep ? "lock-step" : "free-run") + " and this controller in " +
                      (options_.lockstep ? "lock-step" : "free-run") +
                      ": start both with the same ~mode");
  }
  link_status_.shutdown();  // a link does not change its mode; 500 messages a second saved
}

// --- lock-step ---

void RcmLoop::on_tick(const LinkState& state) {
  const std::uint64_t tick = state.stamp_ns / kTickNs;
  if (answered_ != 0 && tick == answered_) {
    send(cycle_->record());  // the link lost our answer: the same once more
    return;
  }
  if (tick < answered_) {
    announcer_->error(arm_ + ": the link went back from tick " + std::to_string(answered_) +
                      " to " + std::to_string(tick) +
                      ": it was restarted; restart the controller too");
    return;
  }
  if (tick == robot_tick_) {
    const std::string missing = gate_.missing(tick);
    announcer_->status(arm_ + ": tick " + std::to_string(tick) + " waits: " +
                       (missing.empty() ? "tool/measured_js of this tick has not come" : missing));
  }
  robot_tick_ = tick;
  link_.stamp_ns = state.stamp_ns;
  link_.q = state.q;
  link_.qd = state.qd;
  try_step();
}

void RcmLoop::try_step() {
  if (robot_tick_ <= answered_ || tool_tick_ != robot_tick_ || !gate_.due(robot_tick_)) return;
  if (jitter_ms_ > 0) {
    ros::WallDuration(std::uniform_real_distribution<>(0, jitter_ms_ * 1e-3)(jitter_)).sleep();
  }
  const std::vector<CommandItem>& items = gate_.take();
  cycle_->run(link_, 0.0, items.data(), items.size());
  CycleRecord& record = cycle_->record();
  record.tick = answered_ = robot_tick_;
  record.refused_by_node = refused_by_node_;
  send(record);
  outlets_->publish_cycle(record);
  outlets_->publish_rest(record, now());
}

// --- free-run ---

void RcmLoop::control_thread() {
  if (options_.realtime) {
    const std::string refused = become_realtime();
    if (!refused.empty()) announcer_->warning_once("realtime", arm_ + ": " + refused);
  }
  CycleRecord& record = cycle_->record();
  LinkState link;
  std::vector<CommandItem> items(surg::kMaxCommands);
  int long_periods = 0;
  Metronome metronome(static_cast<std::int64_t>(kTickNs));
  while (!stop_threads_) {
    record.period_us = static_cast<double>(metronome.wait()) * 1e-3;
    if (metronome.late()) ++record.overruns;
    long_periods = record.period_us > kLongPeriodUs ? long_periods + 1 : 0;
    if (long_periods > kLongPeriodsAllowed) controller_->pause(surg::Reason::kOverrun);
    link_box_.try_get(link);
    std::size_t n = 0;
    while (n < items.size() && commands_.pop(items[n])) ++n;
    const double age = static_cast<double>(steady_ns() - link.received_ns) * 1e-9;
    cycle_->run(link, link.stamp_ns == 0 ? 0.0 : age, items.data(), n);
    ++record.tick;
    record.refused_by_node = refused_by_node_;
    if (record.stamp_ns != 0) send(record);
    if (records_.push(record)) {
      sem_post(&records_waiting_);
    } else {
      ++records_lost_;
    }
  }
}

void RcmLoop::publisher_thread() {
  CycleRecord record;
  std::uint32_t lost = 0;
  for (;;) {
    sem_wait(&records_waiting_);
    if (!records_.pop(record)) {
      if (stop_threads_) return;
      continue;
    }
    outlets_->publish_cycle(record);
    outlets_->publish_rest(record, now());
    if (const std::uint32_t all = records_lost_; all != lost) {
      announcer_->warning("records_lost",
                          arm_ + ": " + std::to_string(all - lost) +
                              " cycle messages were lost: the publisher thread gets too little CPU",
                          now());
      lost = all;
    }
  }
}

// --- going out ---

void RcmLoop::send(const CycleRecord& record) {
  const ros::Time stamp = to_time(record.stamp_ns);
  if (twist_) {
    const surg::Vector6& twist = record.out.twist_command;
    twist_command_.header.stamp = stamp;
    twist_command_.twist.linear = to_vector(twist.head<3>());
    twist_command_.twist.angular = to_vector(twist.tail<3>());
    robot_.publish(twist_command_);
  } else {
    const surg::JointVector& qd = record.out.qd_command;
    joint_command_.header.stamp = stamp;
    joint_command_.velocity.assign(qd.data(), qd.data() + qd.size());
    robot_.publish(joint_command_);
  }
  if (!std::isfinite(record.out.jaw_set)) return;  // F31: an unknown jaw is not told to move
  tool_command_.header.stamp = stamp;
  tool_command_.position.assign(1, record.out.jaw_set);
  tool_.publish(tool_command_);
}

void RcmLoop::send_zero() {
  CycleRecord last = cycle_->record();
  if (last.stamp_ns == 0) return;
  last.out.twist_command.setZero();
  last.out.qd_command.setZero(model_.chain.dof());
  send(last);
}

double RcmLoop::now() const {
  return options_.lockstep ? static_cast<double>(answered_) * kTick
                           : static_cast<double>(steady_ns()) * 1e-9;
}

void RcmLoop::run(const std::atomic<bool>& stop) {
  announcer_->status(arm_ + ": controller of cell " + setup_.cell_name + " runs in " +
                     (options_.lockstep ? "lock-step" : "free-run"));
  std::thread control, publisher;
  if (!options_.lockstep) {
    publisher = std::thread(&RcmLoop::publisher_thread, this);
    control = std::thread(&RcmLoop::control_thread, this);
  }
  while (!stop && ros::ok()) queue_.callAvailable(ros::WallDuration(0.05));
  stop_threads_ = true;
  if (control.joinable()) control.join();
  sem_post(&records_waiting_);
  if (publisher.joinable()) publisher.join();
  send_zero();
  // roscpp writes from its own thread; without a moment the last command would die in a queue.
  ros::WallDuration(0.05).sleep();
}

}  // namespace surg_control
