// One arm's controller on ROS: wiring and the two ways of keeping time. Shared by the nodelet and
// the plain node. No arithmetic: messages are decoded, surg::Controller decides, records are
// encoded.
#pragma once

#include <crtk_msgs/StringStamped.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <semaphore.h>
#include <std_msgs/Empty.h>
#include <surg_msgs/LinkStatus.h>
#include <surg_msgs/Ready.h>

#include <atomic>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "surg_control/announcer.hpp"
#include "surg_control/control_cycle.hpp"
#include "surg_control/handover.hpp"
#include "surg_control/lockstep_gate.hpp"
#include "surg_control/messages.hpp"
#include "surg_control/model_loader.hpp"
#include "surg_control/options.hpp"
#include "surg_control/outlets.hpp"

namespace surg_control {

/// Lock-step: everything happens in the thread that calls run(). Free-run: run() takes messages in,
/// one thread controls at 500 Hz and publishes the robot command, one publishes everything else.
class RcmLoop {
 public:
  /// Reads parameters and files, checks the model, advertises and subscribes. 'private_node' names
  /// the parameters only; topics are /<arm>/…. Throws surg::ConfigError.
  explicit RcmLoop(const ros::NodeHandle& private_node);
  ~RcmLoop();
  RcmLoop(const RcmLoop&) = delete;
  RcmLoop& operator=(const RcmLoop&) = delete;

  /// Works until 'stop' or ROS ends, then commands zero velocity.
  void run(const std::atomic<bool>& stop);

 private:
  // --- coming in: the thread of run() ---
  template <typename Message>
  void subscribe_command(const std::string& topic, std::function<Decoded(const Message&)> decode);
  void subscribe_commands();
  void take_command(const std::string& topic, const std::string& caller, Decoded decoded);
  void on_robot_state(const sensor_msgs::JointState& message);
  void on_tool_state(const sensor_msgs::JointState& message);
  void on_ready(const surg_msgs::Ready& message);
  void on_link_status(const surg_msgs::LinkStatus& message);
  void report_undeclared(const std::string& caller);

  // --- lock-step ---
  void on_tick(const LinkState& state);
  void try_step();

  // --- free-run ---
  void control_thread();
  void publisher_thread();

  void send(const CycleRecord& record);
  void send_zero();
  double now() const;

  Options options_;
  ArmSetup setup_;
  Model model_;
  bool twist_;
  std::string arm_;
  std::unique_ptr<surg::Controller> controller_;
  std::unique_ptr<ControlCycle> cycle_;

  ros::CallbackQueue queue_;
  ros::NodeHandle node_;
  SourceTable sources_;
  std::unique_ptr<Announcer> announcer_;
  std::unique_ptr<Outlets> outlets_;
  ros::Publisher robot_, tool_, undeclared_;
  std::vector<ros::Subscriber> subscribers_;
  ros::Subscriber link_status_;

  LinkState link_;  // as received; in free-run handed over through link_box_
  sensor_msgs::JointState joint_command_, tool_command_;
  geometry_msgs::TwistStamped twist_command_;
  std::atomic<std::uint32_t> refused_by_node_{0};

  LockstepGate gate_;
  std::uint64_t robot_tick_ = 0, tool_tick_ = 0, answered_ = 0;
  std::set<std::string> undeclared_seen_;
  double jitter_ms_ = 0;
  std::minstd_rand jitter_;

  LatestBox<LinkState> link_box_;
  SpscRing<CommandItem> commands_;
  SpscRing<CycleRecord> records_;
  sem_t records_waiting_;
  std::atomic<bool> stop_threads_{false};
  std::atomic<std::uint32_t> records_lost_{0};
};

}  // namespace surg_control
