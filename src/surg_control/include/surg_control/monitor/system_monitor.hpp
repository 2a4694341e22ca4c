// Monitors the ROS master, the wall clock and the parameters in a thread of its own, so that none
// of them can delay a control cycle.
#pragma once

#include <ros/ros.h>

#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "surg_control/monitor/clock_watch.hpp"
#include "surg_control/monitor/health.hpp"
#include "surg_control/monitor/master_probe.hpp"
#include "surg_control/monitor/parameter_watch.hpp"
#include "surg_control/topics/status_reporter.hpp"

namespace surg_control {

/// Checks every quarter second until it is destroyed. Reports through 'reporter', counts in
/// 'health'.
class SystemMonitor {
 public:
  SystemMonitor(const ros::NodeHandle& private_node, const std::string& arm,
                const std::string& limits_hash, bool lockstep, StatusReporter& reporter,
                Health& health);
  ~SystemMonitor();
  SystemMonitor(const SystemMonitor&) = delete;
  SystemMonitor& operator=(const SystemMonitor&) = delete;

 private:
  void run();
  void check_clock();
  void check_master();
  void check_parameters();

  std::string space_, arm_, limits_hash_;
  bool lockstep_;
  StatusReporter& reporter_;
  Health& health_;
  ClockWatch clock_;
  MasterWatch master_;
  ParameterWatch parameters_;

  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace surg_control
