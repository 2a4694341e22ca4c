// What must be watched and may wait: the ROS master, the wall clock, the parameters. A thread of
// its own, so that none of them can hold up a control cycle.
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
#include "surg_control/topics/announcer.hpp"

namespace surg_control {

/// Looks every quarter second until it is destroyed; speaks through the announcer, counts in
/// 'health'.
class Housekeeping {
 public:
  Housekeeping(const ros::NodeHandle& private_node, const std::string& arm,
               const std::string& limits_hash, Announcer& announcer, Health& health);
  ~Housekeeping();
  Housekeeping(const Housekeeping&) = delete;
  Housekeeping& operator=(const Housekeeping&) = delete;

 private:
  void run();
  void look_at_clock();
  void look_at_master();
  void look_at_parameters();

  std::string space_, arm_, limits_hash_;
  Announcer& announcer_;
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
