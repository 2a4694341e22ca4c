// Publishes the controller's state on /diagnostics once a second.
#pragma once

#include <ros/ros.h>

#include <string>
#include <vector>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/monitor/health.hpp"
#include "surg_control/topics/source_table.hpp"

namespace surg_control {

/// Configuration shown in the diagnostics.
struct ControllerInfo {
  bool lockstep;
  bool twist;
  bool track_rcm;
  std::string law;
  std::string limits_hash;
  double link_lag;              // as configured, of the slowest joint [s]
  surg::JointVector joint_lag;  // as configured [s]; empty: one value for all
};

/// Publishes every kDiagnosticsTicks cycles.
class Diagnostics {
 public:
  Diagnostics(ros::NodeHandle& node, const std::string& arm, const ControllerInfo& info,
              const Health& health, const SourceTable& sources);

  /// Every cycle. 'now' [s] as for StatusReporter.
  void add(const CycleRecord& record, double now);

 private:
  void publish(const CycleRecord& record, double rate);

  std::string arm_;
  ControllerInfo info_;
  const Health& health_;
  const SourceTable& sources_;
  ros::Publisher publisher_;
  std::vector<double> compute_us_;
  double last_now_ = 0;
  std::uint64_t last_tick_ = 0;
};

}  // namespace surg_control
