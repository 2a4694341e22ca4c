#include "surg_control/monitor/diagnostics.hpp"

#include <diagnostic_msgs/DiagnosticArray.h>

#include <algorithm>

#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

using diagnostic_msgs::DiagnosticStatus;

constexpr std::uint64_t kDiagnosticsTicks = 500;
constexpr double kLateShare = 0.05;  // of late cycles, from which the diagnostics warn

diagnostic_msgs::KeyValue entry(const std::string& key, const std::string& value) {
  diagnostic_msgs::KeyValue pair;
  pair.key = key;
  pair.value = value;
  return pair;
}

diagnostic_msgs::KeyValue number(const std::string& key, double value) {
  return entry(key, std::to_string(value));
}

diagnostic_msgs::KeyValue numbers(const std::string& key, const surg::JointVector& values) {
  std::string text;
  for (const double value : values) text += (text.empty() ? "" : " ") + std::to_string(value);
  return entry(key, text);
}

diagnostic_msgs::KeyValue count(const std::string& key, std::uint32_t value) {
  return entry(key, std::to_string(value));
}

diagnostic_msgs::KeyValue flag(const std::string& key, bool value) {
  return entry(key, value ? "true" : "false");
}

double percentile(std::vector<double>& values, double part) {
  if (values.empty()) return 0;
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(part * (values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

}  // namespace

Diagnostics::Diagnostics(ros::NodeHandle& node, const std::string& arm, const ControllerInfo& info,
                         const Health& health, const SourceTable& sources)
    : arm_(arm),
      info_(info),
      health_(health),
      sources_(sources),
      publisher_(node.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10)) {}

void Diagnostics::add(const CycleRecord& record, double now) {
  compute_us_.push_back(record.compute_us);
  if (record.tick % kDiagnosticsTicks != 0) return;
  const double elapsed = now - last_now_;
  const auto ticks = static_cast<double>(record.tick - last_tick_);
  const double rate = last_now_ > 0 && elapsed > 0 ? ticks / elapsed : 0;
  last_now_ = now;
  last_tick_ = record.tick;
  if (publisher_.getNumSubscribers() > 0) publish(record, rate);
  compute_us_.clear();
}

void Diagnostics::publish(const CycleRecord& record, double rate) {
  const surg::Outputs& out = record.out;
  DiagnosticStatus status;
  status.name = arm_ + "/controller";
  status.hardware_id = arm_;
  const bool starved = out.late_share > kLateShare;
  const bool warn =
      starved || out.state == surg::State::kPaused || out.warn_rcm || health_.master_lost;
  status.level = out.state == surg::State::kFault ? DiagnosticStatus::ERROR
                 : warn                           ? DiagnosticStatus::WARN
                                                  : DiagnosticStatus::OK;
  status.message = surg::name(out.state);
  if (out.reason != surg::Reason::kNone) {
    status.message += std::string("(") + surg::name(out.reason) + ")";
  }
  if (health_.master_lost) status.message += ", master lost";
  if (starved) status.message += ", cycles are late: free the CPU";
  status.values = {entry("state", surg::name(out.state)),
                   entry("reason", surg::name(out.reason)),
                   flag("homed", out.homed),
                   entry("holder", sources_.name(out.source)),
                   entry("mode", info_.lockstep ? "lockstep" : "freerun"),
                   number("rate_hz", rate),
                   number("compute_us_p50", percentile(compute_us_, 0.50)),
                   number("compute_us_p99", percentile(compute_us_, 0.99)),
                   number("compute_us_max", percentile(compute_us_, 1.0)),
                   count("overruns", record.overruns),
                   number("late_share", out.late_share),
                   number("link_lag_s", out.link_lag),
                   number("link_lag_stated_s", info_.link_lag),
                   numbers("joint_lag_s", out.joint_lag),
                   numbers("joint_lag_stated_s", info_.joint_lag),
                   count("accepted", out.accepted),
                   count("refused", out.refused + record.refused_by_node + record.refused_by_cycle),
                   number("rcm_error_m", out.rcm_error),
                   number("clearance_m", out.clearance),
                   number("scale", out.scale),
                   entry("limited_by", out.limited_by),
                   count("tier", out.tier),
                   entry("base_frame", record.frame.name.c_str()),
                   flag("master_lost", health_.master_lost),
                   count("clock_step", health_.clock_steps),
                   count("future_stamps", health_.future_stamps),
                   count("late_states", health_.late_states),
                   count("records_lost", health_.records_lost),
                   count("changed_params", health_.changed_params),
                   flag("track_rcm", info_.track_rcm),
                   entry("limits_hash", info_.limits_hash),
                   entry("law", info_.law),
                   entry("link", info_.twist ? "cartesian_velocity" : "joint_velocity")};
  diagnostic_msgs::DiagnosticArray message;
  // Not ros::Time::now(): a simulator's clock may stand still.
  message.header.stamp = wall_time();
  message.status.push_back(status);
  publisher_.publish(message);
}

}  // namespace surg_control
