// Publishes texts for people on <arm>/warning, /status and /error: what was wrong and what to do.
#pragma once

#include <ros/ros.h>

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/topics/source_table.hpp"
#include "surg_core/config.hpp"

namespace surg_control {

/// Rate-limits the texts and derives them from cycle records. warning, warning_once, status and
/// error are safe from every thread but the control thread: they lock and allocate.
class StatusReporter {
 public:
  /// limits: of the robot, tightened by the cell.
  StatusReporter(ros::NodeHandle& node, const std::string& arm, const surg::RobotConfig& robot,
                 const surg::Limits& limits, const SourceTable& sources);

  /// Publishes at most once a second per 'key'; the next text counts the suppressed ones. 'now' [s]
  /// is the steady clock, or the tick's time in lock-step.
  void warning(const std::string& key, const std::string& text, double now);
  /// Publishes once in the life of the node per 'key'.
  void warning_once(const std::string& key, const std::string& text);
  void status(const std::string& text);
  void error(const std::string& text);

  /// Notes the link's sentence on its robot, for Reason::kRobot.
  void robot_says(const std::string& sentence);

  /// Reports refusals, ignored parts and changes of state in one cycle. One thread only.
  void report(const CycleRecord& record, double now);

 private:
  struct LastWarning {
    double when;
    double began;  // of a row of warnings
    std::uint64_t suppressed;
  };

  void report_answers(const CycleRecord& record, double now);
  void report_refused(const Answer& answer, const CycleRecord& record, double now);
  void report_ignored(const CycleRecord& record);
  void report_verdicts(const CycleRecord& record, double now);
  void report_changes(const CycleRecord& record, double now);
  std::string explain(surg::Reason reason);
  void report_lag(const surg::Outputs& out);
  std::string what_holds_the_elbow(int limit) const;

  std::string arm_;
  surg::Limits limits_;
  double link_lag_;              // [s] as stated
  surg::JointVector joint_lag_;  // [s] as stated of each joint; empty: one value
  std::vector<std::string> joint_names_;
  const SourceTable& sources_;
  ros::Publisher warning_, status_, error_;
  std::mutex mutex_;
  std::map<std::string, LastWarning> last_warnings_;
  std::string robot_says_;

  // The last reported cycle; only report() uses them.
  surg::State state_ = surg::State::kDisabled;
  surg::Reason reason_ = surg::Reason::kNone;
  bool homed_ = false, first_ = true;
  std::uint32_t ignored_reported_ = 0;  // one bit per motion
  bool lag_reported_ = false;
};

}  // namespace surg_control
