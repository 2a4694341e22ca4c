#include "surg_control/loop/rcm_loop.hpp"

#include <std_msgs/String.h>

#include <algorithm>

#include "surg_control/files/kdl_check.hpp"
#include "surg_control/loop/exit_request.hpp"
#include "surg_control/loop/realtime.hpp"
#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

constexpr std::uint32_t kUnbounded = 0;      // lock-step loses nothing
constexpr std::uint32_t kCommandQueue = 64;  // free-run: roscpp's own queue per topic
constexpr std::size_t kCommandRing = 256;    // free-run: waiting for the control thread
constexpr std::size_t kRecordRing = 512;     // free-run: one second of cycles for the publisher
constexpr std::int64_t kStopWithinNs = 1'000'000'000;  // the fastest motion stops in 0.2 s
constexpr std::int64_t kNoTickNs = 250'000'000;        // lock-step: the link has stopped ticking

const char* name_of(surg::Law law) {
  switch (law) {
    case surg::Law::kVelocity:
      return "velocity";
    case surg::Law::kPaper:
      return "paper";
    case surg::Law::kExact:
      return "exact";
  }
  return "unknown";
}

ControllerInfo info_of(const Options& options, surg::Law law, bool twist,
                       const surg::ArmSetup& setup) {
  ControllerInfo info;
  info.lockstep = options.lockstep;
  info.twist = twist;
  info.track_rcm = options.track_rcm;
  info.law = name_of(law);
  info.limits_hash = surg::limits_hash(setup.robot, setup.limits);
  info.link_lag = setup.robot.tuning.link_lag;
  info.joint_lag = setup.robot.joint_lag;
  return info;
}

}  // namespace

RcmLoop::RcmLoop(const ros::NodeHandle& private_node)
    : options_(read_options(private_node)),
      setup_(surg::load_arm(options_.cell, options_.arm)),
      clearance_(load_clearance(setup_, options_.others)),
      arm_(setup_.arm.name),
      lockstep_gate_(options_.participants),
      commands_(kCommandRing),
      records_(options_.lockstep ? 1 : kRecordRing) {
  check_against_kdl(setup_.robot);
  check_for_arm(options_, setup_);
  sem_init(&records_waiting_, 0, 0);
  sem_init(&command_waiting_, 0, 0);
  surg::Controller::Options law;
  const bool twist = commands_twist(options_, setup_);
  sends_ = twist ? "cartesian_velocity" : "joint_velocity";
  // A twist link solves for its joints itself, so there is no reference for it to follow.
  law.law = twist && options_.law == surg::Law::kExact ? surg::Law::kVelocity : options_.law;
  law.dt = kTick;
  law.feedback_gain = options_.feedback_gain;
  law.track_rcm = options_.track_rcm;
  surg::ControllerSetup made{setup_.model.chain,        setup_.robot,        setup_.limits,
                             setup_.mounted.instrument, setup_.mounted.tool, law,
                             clearance_.setup};
  controller_ =
      std::make_unique<surg::Controller>(made.chain, made.robot, made.limits, made.instrument,
                                         made.tool, made.options, made.clearance);
  box_ = std::make_unique<surg::BlackBox>(*controller_, made);
  box_->set_rcm(setup_.trocar.p_BRcm);
  for (const surg::Fixture& fixture : setup_.arm.fixtures) box_->set_fixture(fixture);
  cycle_ = std::make_unique<ControlCycle>(*controller_, *box_, arm_ + "_rcm");

  node_.setCallbackQueue(&queue_);
  node_.setParam("/" + arm_ + "/robot_description", setup_.model.urdf);
  reporter_ = std::make_unique<StatusReporter>(node_, arm_, setup_.robot, setup_.limits, sources_);
  const ControllerInfo info = info_of(options_, law.law, twist, setup_);
  publishers_ =
      std::make_unique<StatePublishers>(node_, setup_, info, health_, sources_, *reporter_);
  services_ = std::make_unique<KinematicsServices>(node_, arm_, setup_.limits,
                                                   setup_.mounted.instrument.wrist);
  robot_ = std::make_unique<RobotCommand>(node_, setup_, twist, options_.lockstep);
  if (options_.lockstep) {
    undeclared_ = node_.advertise<std_msgs::String>("/sim/undeclared", 10, true);
  }
  command_subscribers_ = std::make_unique<CommandSubscribers>(
      node_, arm_, setup_.mounted.instrument.wrist.has_value(), options_.track_rcm,
      options_.lockstep ? kUnbounded : kCommandQueue,
      [this](const std::string& words) { return read_tool(words); },
      [this](const std::string& topic, const std::string& caller, const ros::Time& stamp,
             Decoded decoded) { on_command(topic, caller, stamp, std::move(decoded)); });
  subscribe_others();  // first: the link's ticks wait for them
  subscribe_link();
  monitor_ = std::make_unique<SystemMonitor>(private_node, arm_, info.limits_hash,
                                             options_.lockstep, *reporter_, health_);
  const surg::BlackBoxLabel label{arm_, setup_.cell_file, "", SURG_CONTROL_VERSION};
  black_box_writer_ =
      std::make_unique<BlackBoxWriter>(*box_, options_.black_box, label, *reporter_);
}

RcmLoop::~RcmLoop() {
  sem_destroy(&records_waiting_);
  sem_destroy(&command_waiting_);
}

// --- lock-step ---

void RcmLoop::on_tick(const LinkState& state) {
  const std::uint64_t tick = state.stamp_ns / kTickNs;
  if (answered_tick_ != 0 && tick == answered_tick_) {
    robot_->send(LinkCommand::of(cycle_->record()));  // the link lost our answer: repeat it
    return;
  }
  if (tick < answered_tick_) {
    reporter_->error(arm_ + ": the link went back from tick " + std::to_string(answered_tick_) +
                     " to " + std::to_string(tick) +
                     ": it was restarted; restart the controller too");
    return;
  }
  if (tick == robot_tick_) {
    const std::string missing = lockstep_gate_.missing(tick);
    reporter_->status(arm_ + ": tick " + std::to_string(tick) + " waits: " +
                      (missing.empty()
                           ? "tool/measured_js, robot/status or another arm's robot/measured_js "
                             "has not come for this tick (~others names the arms that run)"
                           : missing));
  }
  robot_tick_ = tick;
  link_.stamp_ns = state.stamp_ns;
  link_.q = state.q;
  link_.qd = state.qd;
  try_step();
}

void RcmLoop::try_step() {
  if (robot_tick_ <= answered_tick_) return;
  if (tool_tick_ != robot_tick_ && !setup_.mounted.instrument.passive) return;
  if (status_tick_ != robot_tick_) return;
  for (const std::uint64_t tick : other_ticks_) {
    if (tick != robot_tick_) return;
  }
  // While exiting, commands are ignored, so there is nothing to wait for.
  if (!exiting_ && !lockstep_gate_.due(robot_tick_)) return;
  disable_if_exiting();
  const auto tick_ns = static_cast<std::int64_t>(robot_tick_ * kTickNs);
  link_.received_ns = link_.jaw_received_ns = link_.condition_received_ns = tick_ns;
  const std::vector<CommandItem>& items = lockstep_gate_.take();
  cycle_->run(link_, tick_ns, 0, items.data(), items.size());
  CycleRecord& record = cycle_->record();
  record.tick = answered_tick_ = robot_tick_;
  record.refused_by_node = refused_by_node_;
  record.moves_refused_by_node = moves_refused_by_node_;
  robot_->send(LinkCommand::of(record));
  publishers_->publish_cycle(record);
  publishers_->publish_rest(record, now());
  services_->set_frame(record.frame, record.out.wrist.geometry.turn);
  update_at_rest();
}

// --- free-run ---

void RcmLoop::control_thread() {
  request_realtime(0);
  CycleRecord& record = cycle_->record();
  LinkState link;
  std::vector<CommandItem> items(surg::kMaxCommands);
  Metronome metronome(static_cast<std::int64_t>(kTickNs));
  while (!stop_threads_) {
    const std::int64_t period_ns = metronome.wait();
    record.period_us = static_cast<double>(period_ns) * 1e-3;
    if (metronome.late()) ++record.overruns;
    latest_link_.take(link);
    std::size_t n = 0;
    while (n < items.size() && commands_.pop(items[n])) ++n;
    disable_if_exiting();
    cycle_->run(link, steady_ns(), period_ns, items.data(), n);
    ++record.tick;
    record.refused_by_node = refused_by_node_;
    record.moves_refused_by_node = moves_refused_by_node_;
    if (!record.out.withheld) hand_over(LinkCommand::of(record));
    update_at_rest();
    if (records_.push(record)) {
      sem_post(&records_waiting_);
    } else {
      ++health_.records_lost;
    }
  }
}

/// The control thread's half: it neither waits nor enters roscpp, which locks and allocates.
void RcmLoop::hand_over(const LinkCommand& command) {
  newest_command_.put(command);
  sem_post(&command_waiting_);
}

void RcmLoop::sender_thread() {
  request_realtime(1);
  LinkCommand command;
  for (;;) {
    sem_wait(&command_waiting_);
    if (newest_command_.take(command)) {
      robot_->send(command);
    } else if (stop_threads_) {
      return;
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
    publishers_->publish_cycle(record);
    publishers_->publish_rest(record, now());
    services_->set_frame(record.frame, record.out.wrist.geometry.turn);
    if (const std::uint32_t all = health_.records_lost; all != lost) {
      reporter_->warning("records_lost",
                         arm_ + ": " + std::to_string(all - lost) +
                             " cycle messages were lost: the publisher thread gets too little CPU",
                         now());
      lost = all;
    }
  }
}

// --- beginning and end ---

/// Leaving ENABLED stops the tip through the law and refuses every later command (F28).
void RcmLoop::disable_if_exiting() {
  if (!exiting_ || disabled_for_exit_) return;
  disabled_for_exit_ = true;
  if (cycle_->record().out.state == surg::State::kEnabled) {
    box_->request(surg::StateCommand::kDisable);
  }
}

void RcmLoop::update_at_rest() {
  const surg::Outputs& out = cycle_->record().out;
  disabled_ = out.state == surg::State::kDisabled;
  if (disabled_for_exit_ && out.qd_command.isZero(0) && out.twist_command.isZero(0))
    at_rest_ = true;
}

double RcmLoop::now() const {
  return options_.lockstep ? static_cast<double>(answered_tick_) * kTick
                           : static_cast<double>(steady_ns()) * 1e-9;
}

/// A thread that ends with a zero command if its body throws.
std::thread RcmLoop::start(void (RcmLoop::*body)()) {
  return std::thread([this, body] {
    try {
      (this->*body)();
    } catch (...) {
      fail();
    }
  });
}

/// Notes the exception in flight. Whoever it hit, the arm is told to stop, and run() ends.
void RcmLoop::fail() {
  {
    const std::lock_guard<std::mutex> lock(failure_mutex_);
    if (!failure_) failure_ = std::current_exception();
  }
  failed_ = true;
}

/// Every loop in real time asks for the priority: one that is served late leaves its pivot, and a
/// simulated arm's pivot counts, too. Only those of real arms need it.
void RcmLoop::request_realtime(int below) {
  const std::string refused = become_realtime(below, options_.realtime);
  if (!refused.empty() && options_.realtime)
    reporter_->warning_once("realtime", arm_ + ": " + refused);
}

void RcmLoop::serve(const std::atomic<bool>& stop) {
  while (!stop && !failed_ && !exit_requested() && ros::ok()) {
    queue_.callAvailable(ros::WallDuration(0.01));
  }
}

/// Leaves ENABLED and waits until the command is zero.
void RcmLoop::come_to_rest() {
  exiting_ = true;
  const std::int64_t begin = steady_ns();
  std::int64_t last_step = begin;
  for (std::uint64_t last_tick = answered_tick_; !at_rest_ && !failed_ && ros::ok();) {
    const std::int64_t time = steady_ns();
    if (answered_tick_ != last_tick) last_step = time;
    last_tick = answered_tick_;
    if (time - begin > kStopWithinNs) break;
    if (options_.lockstep && time - last_step > kNoTickNs) break;
    queue_.callAvailable(ros::WallDuration(0.005));
  }
}

void RcmLoop::run(const std::atomic<bool>& stop) {
  reporter_->status(arm_ + ": controller of cell " + setup_.cell_name + " runs in " +
                    (options_.lockstep ? "lock-step" : "free-run"));
  for (const auto& [what, source] : {std::pair{"tool", &setup_.mounted.tool.source},
                                     std::pair{"trocar", &setup_.trocar.source}}) {
    if (setup_.arm.link == surg::kSimulator || *source == "measured") continue;
    reporter_->warning_once(what, arm_ + ": the calibration of its " + what + " is " + *source +
                                      ", not measured: the pivot is only where it was computed");
  }
  std::thread control, sender, publisher;
  if (!options_.lockstep) {
    publisher = start(&RcmLoop::publisher_thread);
    sender = start(&RcmLoop::sender_thread);
    control = start(&RcmLoop::control_thread);
  }
  try {
    serve(stop);
    come_to_rest();
  } catch (...) {
    fail();
  }
  stop_threads_ = true;
  if (control.joinable()) control.join();
  sem_post(&command_waiting_);
  sem_post(&records_waiting_);
  if (sender.joinable()) sender.join();
  if (publisher.joinable()) publisher.join();
  robot_->send(LinkCommand::of(cycle_->record()).at_rest());
  // roscpp sends from its own thread; without a pause the last command would stay in its queue.
  ros::WallDuration(0.05).sleep();
  if (failure_) std::rethrow_exception(failure_);
}

}  // namespace surg_control
