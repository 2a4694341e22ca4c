// One arm's controller on ROS: topics and the two ways of keeping time, for the nodelet and the
// plain node. No arithmetic: messages are decoded, surg::Controller decides, records are encoded.
#pragma once

#include <geometry_msgs/WrenchStamped.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <semaphore.h>
#include <sensor_msgs/JointState.h>
#include <surg_msgs/LinkStatus.h>
#include <surg_msgs/Ready.h>

#include <atomic>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "surg_control/files/clearance_loader.hpp"
#include "surg_control/loop/control_cycle.hpp"
#include "surg_control/loop/lockstep_gate.hpp"
#include "surg_control/loop/options.hpp"
#include "surg_control/loop/thread_channels.hpp"
#include "surg_control/monitor/black_box_writer.hpp"
#include "surg_control/monitor/health.hpp"
#include "surg_control/monitor/system_monitor.hpp"
#include "surg_control/topics/command_subscribers.hpp"
#include "surg_control/topics/kinematics_services.hpp"
#include "surg_control/topics/robot_command.hpp"
#include "surg_control/topics/state_publishers.hpp"
#include "surg_control/topics/status_reporter.hpp"
#include "surg_core/files/robot_model.hpp"

namespace surg_control {

/// Lock-step: everything runs in the thread that calls run(). Free-run: run() receives messages,
/// one thread controls at 500 Hz, one sends its newest command to robot and tool, one publishes
/// everything else.
class RcmLoop {
 public:
  /// Reads parameters and files, checks the model, advertises and subscribes. 'private_node' names
  /// the parameters only; topics are /<arm>/…. Throws surg::ConfigError.
  explicit RcmLoop(const ros::NodeHandle& private_node);
  ~RcmLoop();
  RcmLoop(const RcmLoop&) = delete;
  RcmLoop& operator=(const RcmLoop&) = delete;

  /// Runs until 'stop', an exit request or ROS's shutdown. Then it stops the arm through the law,
  /// commands zero and returns, at most about a second later, whatever the link does. An exception
  /// in any of its threads also ends with a zero command and is then thrown on.
  void run(const std::atomic<bool>& stop);

 private:
  // --- coming in: the thread of run() (rcm_loop_inputs.cpp) ---
  template <typename Message>
  void listen(const std::string& topic, const std::function<void(const Message&)>& take);
  void subscribe_link();
  void on_command(const std::string& topic, const std::string& caller, const ros::Time& stamp,
                  Decoded decoded);
  Decoded read_tool(const std::string& words);
  bool enqueue(const std::string& topic, const std::string& caller, const Decoded& decoded);
  void on_robot_state(const sensor_msgs::JointState& message);
  void on_force(const geometry_msgs::WrenchStamped& message, MeasuredForce LinkState::*which);
  void subscribe_others();
  void on_other_state(const sensor_msgs::JointState& message, std::size_t which);
  void on_tool_state(const sensor_msgs::JointState& message);
  void on_ready(const surg_msgs::Ready& message);
  void on_link_status(const surg_msgs::LinkStatus& message);
  surg::RobotCondition condition_of(const surg_msgs::LinkStatus& message);
  void count_refused(const std::string& topic);
  void report_undeclared(const std::string& caller);
  void note_stamp(const ros::Time& stamp);

  // --- lock-step ---
  void on_tick(const LinkState& state);
  void try_step();

  // --- free-run ---
  void control_thread();
  void sender_thread();
  void publisher_thread();
  void hand_over(const LinkCommand& command);
  std::thread start(void (RcmLoop::*body)());
  void request_realtime(int below);

  void serve(const std::atomic<bool>& stop);
  void come_to_rest();
  void fail();

  void disable_if_exiting();
  void update_at_rest();
  double now() const;

  Options options_;
  surg::ArmSetup setup_;
  ClearanceFiles clearance_;
  std::string arm_;
  std::deque<surg::MountedTool>
      tools_;  // every one that was read; cycles and black box point to them
  std::unique_ptr<surg::Controller> controller_;
  std::unique_ptr<surg::BlackBox> box_;
  std::unique_ptr<ControlCycle> cycle_;

  ros::CallbackQueue queue_;
  ros::NodeHandle node_;
  SourceTable sources_;
  Health health_;
  std::unique_ptr<StatusReporter> reporter_;
  std::unique_ptr<StatePublishers> publishers_;
  std::unique_ptr<KinematicsServices> services_;
  std::unique_ptr<RobotCommand> robot_;
  std::unique_ptr<CommandSubscribers> command_subscribers_;
  std::unique_ptr<SystemMonitor> monitor_;
  std::unique_ptr<BlackBoxWriter> black_box_writer_;
  ros::Publisher undeclared_;
  std::vector<ros::Subscriber> subscribers_;
  std::string sends_;             // "joint_velocity" or "cartesian_velocity"
  bool time_is_checked_ = false;  // a link does not change its mode

  std::atomic<bool> disabled_{true};  // after the last cycle

  LinkState link_;  // as received; in free-run handed over through latest_link_
  std::atomic<std::uint32_t> refused_by_node_{0}, moves_refused_by_node_{0};

  LockstepGate lockstep_gate_;
  std::uint64_t robot_tick_ = 0, tool_tick_ = 0, status_tick_ = 0, answered_tick_ = 0;
  std::vector<std::uint64_t> other_ticks_;
  std::set<std::string> undeclared_seen_;

  LatestSlot<LinkState> latest_link_;
  SpscRing<CommandItem> commands_;
  SpscRing<CycleRecord> records_;
  sem_t records_waiting_;
  LatestSlot<LinkCommand> newest_command_;
  sem_t command_waiting_;
  std::atomic<bool> stop_threads_{false};

  std::atomic<bool> exiting_{false};  // asked to end: no commands any more, stop through the law
  bool disabled_for_exit_ = false;    // that has been told to the controller
  std::atomic<bool> at_rest_{false};  // and it commands zero

  std::atomic<bool> failed_{false};
  std::mutex failure_mutex_;
  std::exception_ptr failure_;  // the first one
};

}  // namespace surg_control
