#include "surg_control/outlets.hpp"

#include <crtk_msgs/OperatingState.h>
#include <diagnostic_msgs/DiagnosticArray.h>
#include <tf2_msgs/TFMessage.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "surg_control/messages.hpp"
#include "surg_core/rcm.hpp"

namespace surg_control {
namespace {

// Ticks between two messages.
constexpr std::uint64_t kFeedbackLockstep = 5;  // 100 Hz of simulated time
constexpr std::uint64_t kStateTicks = 50;       // 10 Hz
constexpr std::uint64_t kTfTicks = 10;          // 50 Hz
constexpr std::uint64_t kDiagnosticsTicks = 500;

/// 200 Hz on the 500 Hz grid: two of five ticks, evenly.
bool feedback_due(std::uint64_t tick, bool lockstep) {
  if (lockstep) return tick % kFeedbackLockstep == 0;
  return tick * 2 / 5 != (tick - 1) * 2 / 5;
}

void fill_joints(sensor_msgs::JointState& message, const surg::Vector4& q,
                 const surg::Vector4* qd) {
  if (message.name.empty()) message.name = {"yaw", "pitch", "insertion", "roll"};
  message.position.assign(q.data(), q.data() + 4);
  if (qd != nullptr) message.velocity.assign(qd->data(), qd->data() + 4);
}

void fill_jaw(sensor_msgs::JointState& message, double jaw) {
  if (message.name.empty()) message.name = {"jaw"};
  message.position.assign(1, jaw);
}

std::string millimetres(double metres) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f mm", metres * 1e3);
  return text;
}

diagnostic_msgs::KeyValue entry(const std::string& key, const std::string& value) {
  diagnostic_msgs::KeyValue pair;
  pair.key = key;
  pair.value = value;
  return pair;
}

/// For what belongs to no joint state. Not ros::Time::now(): a simulator's clock may stand still.
ros::Time wall_time() { return to_time(static_cast<std::uint64_t>(ros::WallTime::now().toNSec())); }

double percentile(std::vector<double>& values, double part) {
  if (values.empty()) return 0;
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(part * (values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

}  // namespace

Outlets::Outlets(ros::NodeHandle& node, const ArmSetup& setup, const Facts& facts,
                 const SourceTable& sources, Announcer& announcer)
    : arm_(setup.arm.name),
      base_(arm_ + "_base"),
      flange_(arm_ + "_flange"),
      tool_(arm_ + "_tool"),
      rcm_(arm_ + "_rcm"),
      limits_(setup.limits),
      p_FTip_(setup.tool.p_FTip),
      facts_(facts),
      sources_(sources),
      announcer_(announcer),
      // Unbounded in lock-step, where nothing may be lost; latched there, so that a participant
      // whose connection comes up late still gets the cycle it has to answer.
      cycle_(node.advertise<surg_msgs::Cycle>("/" + arm_ + "/cycle", facts.lockstep ? 0 : 500,
                                              facts.lockstep)),
      operating_state_(
          node.advertise<crtk_msgs::OperatingState>("/" + arm_ + "/operating_state", 100, true)),
      tf_(node.advertise<tf2_msgs::TFMessage>("/tf", 100)),
      tf_static_(node.advertise<tf2_msgs::TFMessage>("/tf_static", 1, true)),
      diagnostics_(node.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10)),
      rcm_limit_(node.advertise<surg_msgs::ScalarStamped>("/" + arm_ + "/rcm/limit", 1, true)),
      measured_js_(node, "/" + arm_ + "/measured_js"),
      setpoint_js_(node, "/" + arm_ + "/setpoint_js"),
      jaw_measured_js_(node, "/" + arm_ + "/jaw/measured_js"),
      jaw_setpoint_js_(node, "/" + arm_ + "/jaw/setpoint_js"),
      measured_cp_(node, "/" + arm_ + "/measured_cp"),
      setpoint_cp_(node, "/" + arm_ + "/setpoint_cp"),
      goal_cp_(node, "/" + arm_ + "/goal_cp"),
      rcm_measured_cp_(node, "/" + arm_ + "/rcm/measured_cp"),
      measured_cv_(node, "/" + arm_ + "/measured_cv"),
      rcm_error_(node, "/" + arm_ + "/rcm/error") {
  surg_msgs::ScalarStamped limit;
  limit.header.stamp = wall_time();
  limit.header.frame_id = base_;
  limit.value = limits_.rcm_error_fault;
  rcm_limit_.publish(limit);
  CycleRecord still;
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform(still, base_, setup.X_WB, "world"));
  tf_static_.publish(message);
  publish_state(still, true);
}

void Outlets::publish_cycle(const CycleRecord& record) {
  if (record.stamp_ns == 0) return;
  encode_cycle(record, base_, sources_, cycle_message_);
  cycle_.publish(cycle_message_);
}

void Outlets::publish_rest(const CycleRecord& record, double now) {
  say_answers(record, now);
  say_verdicts(record, now);
  say_changes(record, now);
  if (feedback_due(record.tick, facts_.lockstep)) {
    publish_feedback(record);
    publish_rcm(record);
  }
  if (record.tick % kTfTicks == 0) publish_tf(record);
  compute_us_.push_back(record.compute_us);
  if (record.tick % kDiagnosticsTicks == 0) publish_diagnostics(record, now);
}

void Outlets::publish_feedback(const CycleRecord& record) {
  const surg::Outputs& out = record.out;
  const ros::Time stamp = to_time(record.stamp_ns);
  // The rcm frame, and with it every virtual joint, exists from 'home' on.
  const bool known = record.stamp_ns != 0 && out.reason != surg::Reason::kLinkLost &&
                     out.reason != surg::Reason::kStateNotFinite;
  const bool valid = known && out.homed;
  const surg::Pose X_RB = record.X_BR.inverse();

  measured_js_.publish(
      valid, stamp, [&](auto& message) { fill_joints(message, out.virtual_q, &out.virtual_qd); });
  setpoint_js_.publish(valid, stamp,
                       [&](auto& message) { fill_joints(message, out.virtual_set, nullptr); });
  const auto fill_pose = [&](const surg::Vector3& p_B, const Eigen::Quaterniond& q_R) {
    return [&](geometry_msgs::PoseStamped& message) {
      message.header.frame_id = rcm_;
      message.pose = to_pose(X_RB * p_B, q_R);
    };
  };
  measured_cp_.publish(valid, stamp, fill_pose(out.p_BTip, record.q_RTool));
  setpoint_cp_.publish(valid, stamp, fill_pose(out.p_set, record.q_RSet));
  goal_cp_.publish(valid, stamp, fill_pose(out.p_goal, record.q_RGoal));
  measured_cv_.publish(valid, stamp, [&](geometry_msgs::TwistStamped& message) {
    const surg::Vector3 s_R = X_RB.linear() * out.s_B;
    const surg::Vector3 s_dot = surg::shaft_direction_rate(out.virtual_q[0], out.virtual_q[1],
                                                           out.virtual_qd[0], out.virtual_qd[1]);
    message.header.frame_id = rcm_;
    message.twist.linear = to_vector(X_RB.linear() * out.v_BTip);
    message.twist.angular = to_vector(s_R.cross(s_dot) + out.virtual_qd[3] * s_R);
  });
  jaw_measured_js_.publish(known, stamp, [&](auto& message) { fill_jaw(message, out.jaw); });
  jaw_setpoint_js_.publish(known, stamp, [&](auto& message) { fill_jaw(message, out.jaw_set); });
}

void Outlets::publish_rcm(const CycleRecord& record) {
  const bool valid = record.stamp_ns != 0;
  const ros::Time stamp = to_time(record.stamp_ns);
  rcm_error_.publish(valid, stamp, [&](surg_msgs::ScalarStamped& message) {
    message.header.frame_id = base_;
    message.value = record.out.rcm_error;
  });
  rcm_measured_cp_.publish(valid, stamp, [&](geometry_msgs::PoseStamped& message) {
    message.header.frame_id = base_;
    message.pose = to_pose(record.out.p_BRcm, Eigen::Quaterniond(record.X_BR.linear()));
  });
}

void Outlets::publish_state(const CycleRecord& record, bool changed) {
  if (!changed && record.tick % kStateTicks != 0) return;
  crtk_msgs::OperatingState message;
  message.header.stamp = to_time(record.stamp_ns);
  message.state = surg::name(record.out.state);
  message.is_homed = record.out.homed;
  message.is_busy = record.out.busy;
  operating_state_.publish(message);
}

geometry_msgs::TransformStamped Outlets::transform(const CycleRecord& record,
                                                   const std::string& child, const surg::Pose& X,
                                                   const std::string& parent) const {
  geometry_msgs::TransformStamped message;
  message.header.stamp = to_time(record.stamp_ns);
  message.header.frame_id = parent;
  message.child_frame_id = child;
  message.transform.translation = to_vector(X.translation());
  message.transform.rotation = to_quaternion(Eigen::Quaterniond(X.linear()));
  return message;
}

void Outlets::publish_tf(const CycleRecord& record) {
  if (record.stamp_ns == 0 || tf_.getNumSubscribers() == 0) return;
  // The tool frame as measured_cp states it, so that both say the same; fixed in the flange.
  surg::Pose X_FTool = surg::Pose::Identity();
  X_FTool.linear() = record.out.X_BF.linear().transpose() * record.X_BR.linear() *
                     record.q_RTool.toRotationMatrix();
  X_FTool.translation() = p_FTip_;
  tf2_msgs::TFMessage message;
  message.transforms.push_back(transform(record, flange_, record.out.X_BF, base_));
  message.transforms.push_back(transform(record, tool_, X_FTool, flange_));
  message.transforms.push_back(transform(record, rcm_, record.X_BR, base_));
  tf_.publish(message);
}

void Outlets::publish_diagnostics(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  const double elapsed = now - diagnosed_at_;
  const auto ticks = static_cast<double>(record.tick - diagnosed_tick_);
  const double rate = diagnosed_at_ > 0 && elapsed > 0 ? ticks / elapsed : 0;
  diagnosed_at_ = now;
  diagnosed_tick_ = record.tick;
  if (diagnostics_.getNumSubscribers() > 0) {
    diagnostic_msgs::DiagnosticStatus status;
    status.name = arm_ + "/controller";
    status.hardware_id = arm_;
    status.level = out.state == surg::State::kFault ? diagnostic_msgs::DiagnosticStatus::ERROR
                   : out.state == surg::State::kPaused || out.warn_rcm
                       ? diagnostic_msgs::DiagnosticStatus::WARN
                       : diagnostic_msgs::DiagnosticStatus::OK;
    status.message = surg::name(out.state);
    if (out.reason != surg::Reason::kNone) {
      status.message += std::string("(") + surg::name(out.reason) + ")";
    }
    status.values = {entry("state", surg::name(out.state)),
                     entry("reason", surg::name(out.reason)),
                     entry("mode", facts_.lockstep ? "lockstep" : "freerun"),
                     entry("rate_hz", std::to_string(rate)),
                     entry("compute_us_p50", std::to_string(percentile(compute_us_, 0.50))),
                     entry("compute_us_p99", std::to_string(percentile(compute_us_, 0.99))),
                     entry("overruns", std::to_string(record.overruns)),
                     entry("rcm_error_m", std::to_string(out.rcm_error)),
                     entry("limits_hash", facts_.limits_hash),
                     entry("law", facts_.law),
                     entry("link", facts_.twist ? "cartesian_velocity" : "joint_velocity")};
    diagnostic_msgs::DiagnosticArray message;
    message.header.stamp = wall_time();
    message.status.push_back(status);
    diagnostics_.publish(message);
  }
  compute_us_.clear();
}

void Outlets::say_changes(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  const bool moved = first_ || out.state != state_;
  const bool because = out.reason != reason_;
  const bool changed = moved || out.homed != homed_ || out.busy != busy_;
  publish_state(record, changed);
  const std::string why =
      out.reason == surg::Reason::kNone
          ? ""
          : std::string("(") + surg::name(out.reason) + "): " + surg::sentence(out.reason);
  if (out.state == surg::State::kFault && (moved || because)) {
    announcer_.error(arm_ + ": FAULT" + why);
  } else if (moved) {
    announcer_.status(arm_ + ": " + surg::name(out.state) + why);
  } else if (because && !why.empty()) {
    // Still in the same state and yet held: said where a person looks for what does not work.
    announcer_.warning(surg::name(out.reason), arm_ + ": " + surg::sentence(out.reason), now);
  }
  if (out.homed != homed_) announcer_.status(arm_ + (out.homed ? ": homed" : ": no longer homed"));
  if (out.warn_rcm) {
    announcer_.warning("rcm_warn",
                       arm_ + ": the shaft is " + millimetres(out.rcm_error) +
                           " from the trocar point (warning from " +
                           millimetres(limits_.rcm_error_warn) + ", FAULT from " +
                           millimetres(limits_.rcm_error_fault) + ")",
                       now);
  }
  state_ = out.state;
  reason_ = out.reason;
  homed_ = out.homed;
  busy_ = out.busy;
  first_ = false;
}

void Outlets::say_answers(const CycleRecord& record, double now) {
  for (int i = 0; i < record.n_answers; ++i) {
    const Answer& answer = record.answers[i];
    const bool taught = answer.kind == CommandItem::Kind::kSetRcm;
    const std::string what = taught ? "rcm/set_cp" : word_of(answer.state);
    const std::string from = arm_ + ": " + what + " from " + sources_.name(answer.source);
    if (answer.reason != surg::Reason::kNone) {
      announcer_.warning(what + surg::name(answer.reason),
                         from + " refused: " + surg::sentence(answer.reason), now);
    } else if (taught) {
      announcer_.status(from + ": trocar point taught");
    }
  }
}

void Outlets::say_verdicts(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  for (int i = 0; i < out.n_verdicts; ++i) {
    const surg::Verdict& verdict = out.verdicts[i];
    if (verdict.reason == surg::Reason::kNone) continue;
    std::string text = arm_ + ": " + topic_of(verdict.motion) + " from " +
                       sources_.name(verdict.source) +
                       " refused: " + surg::sentence(verdict.reason);
    if (verdict.reason == surg::Reason::kNoAuthority) {
      text += " (held by " + sources_.name(out.source) + ")";
    }
    announcer_.warning(surg::name(verdict.reason), text, now);
  }
}

}  // namespace surg_control
