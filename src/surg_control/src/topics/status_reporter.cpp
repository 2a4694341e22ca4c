#include "surg_control/topics/status_reporter.hpp"

#include <std_msgs/String.h>

#include <cmath>
#include <cstdio>

#include "surg_control/topics/decode.hpp"

namespace surg_control {
namespace {

constexpr double kWarningPeriod = 1.0;   // [s] at least, between two warnings of one key
constexpr double kRowEnds = 2.0;         // periods without a warning end a row of them
constexpr double kLagTolerance = 0.003;  // [s] between the measured and the stated lag

std_msgs::String text_message(const std::string& text) {
  std_msgs::String message;
  message.data = text;
  return message;
}

std::string thousandths(double value, const char* format) {
  char text[32];
  std::snprintf(text, sizeof text, format, value * 1e3);
  return text;
}

std::string millimetres(double metres) { return thousandths(metres, "%.2f mm"); }
std::string milliseconds(double seconds) { return thousandths(seconds, "%.1f ms"); }

const char* topic_of_answer(const Answer& answer) {
  switch (answer.kind) {
    case CommandItem::Kind::kState:
      return word_of(answer.state);
    case CommandItem::Kind::kTool:
      return "tool/mount";
    case CommandItem::Kind::kSetRcm:
      return "rcm/set_cp";
    case CommandItem::Kind::kSetFixture:
      return "fixtures/set";
    case CommandItem::Kind::kRemoveFixture:
      return "fixtures/remove";
    case CommandItem::Kind::kSetFrame:
      return "set_base_frame";
    case CommandItem::Kind::kClaim:
      return "authority/claim";
    case CommandItem::Kind::kAtWall:
      return "servo_cp/at_wall";
    case CommandItem::Kind::kTrack:
      return "rcm/track";
    case CommandItem::Kind::kMotion:
      return topic_of(answer.motion);
  }
  return "unknown";
}

}  // namespace

StatusReporter::StatusReporter(ros::NodeHandle& node, const std::string& arm,
                               const surg::RobotConfig& robot, const surg::Limits& limits,
                               const SourceTable& sources)
    : arm_(arm),
      limits_(limits),
      link_lag_(robot.tuning.link_lag),
      joint_lag_(robot.joint_lag),
      joint_names_(robot.joint_names),
      sources_(sources),
      warning_(node.advertise<std_msgs::String>("/" + arm + "/warning", 100)),
      status_(node.advertise<std_msgs::String>("/" + arm + "/status", 100)),
      // Latched: a client that connects after a FAULT still reads the cause.
      error_(node.advertise<std_msgs::String>("/" + arm + "/error", 100, true)) {}

void StatusReporter::warning(const std::string& key, const std::string& text, double now) {
  std::string counted = text;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto last = last_warnings_.find(key);
    if (last != last_warnings_.end() && now - last->second.when < kWarningPeriod) {
      ++last->second.suppressed;
      return;
    }
    double began = now;
    if (last != last_warnings_.end() && last->second.suppressed > 0) {
      counted +=
          " (and " + std::to_string(last->second.suppressed) + " times more since the last one";
      if (now - last->second.when < kRowEnds * kWarningPeriod) {
        began = last->second.began;
        counted += "; it began " + std::to_string(std::lround(now - began)) + " s ago";
      }
      counted += ")";
    }
    last_warnings_[key] = {now, began, 0};
  }
  warning_.publish(text_message(counted));
}

void StatusReporter::warning_once(const std::string& key, const std::string& text) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!last_warnings_.emplace(key, LastWarning{0, 0, 0}).second) return;
  }
  warning_.publish(text_message(text));
}

void StatusReporter::status(const std::string& text) {
  ROS_INFO_STREAM(text);
  status_.publish(text_message(text));
}

void StatusReporter::error(const std::string& text) {
  ROS_ERROR_STREAM(text);
  error_.publish(text_message(text));
}

void StatusReporter::robot_says(const std::string& sentence) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (robot_says_ != sentence) robot_says_ = sentence;
}

/// The sentence of a reason; of a robot that does not obey, what its link says.
std::string StatusReporter::explain(surg::Reason reason) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const bool says = reason == surg::Reason::kRobot && !robot_says_.empty();
  return says ? robot_says_ : surg::sentence(reason);
}

void StatusReporter::report(const CycleRecord& record, double now) {
  report_answers(record, now);
  report_ignored(record);
  report_verdicts(record, now);
  report_lag(record.out);
  report_changes(record, now);
}

void StatusReporter::report_answers(const CycleRecord& record, double now) {
  for (int i = 0; i < record.n_answers; ++i) {
    const Answer& answer = record.answers[i];
    if (answer.reason != surg::Reason::kNone) {
      report_refused(answer, record, now);
      continue;
    }
    const std::string from =
        arm_ + ": " + topic_of_answer(answer) + " from " + sources_.name(answer.source);
    if (answer.kind == CommandItem::Kind::kTool && record.tool != nullptr) {
      const surg::MountedTool& tool = *record.tool;
      status(from + ": '" + tool.instrument.name + "' is mounted, with " + tool.calibration_file +
             " of " + tool.tool.date + ": home the arm again");
    } else if (answer.kind == CommandItem::Kind::kSetRcm) {
      status(from + ": trocar point taught");
    } else if (answer.kind == CommandItem::Kind::kSetFrame) {
      status(from + ": commands and measured_cp are in '" + record.frame.name.c_str() + "' now");
    } else if (answer.kind == CommandItem::Kind::kSetFixture ||
               answer.kind == CommandItem::Kind::kRemoveFixture) {
      status(from + ": the arm has " + std::to_string(record.fixtures.size()) + " fixtures now");
    } else if (answer.kind == CommandItem::Kind::kAtWall) {
      status(from + ": its servo_cp outside the workspace " +
             (answer.slide ? "slides along the wall" : "is refused"));
    } else if (answer.kind == CommandItem::Kind::kClaim) {
      status(from + ": it alone commands the arm until the arm leaves ENABLED");
    }
  }
}

void StatusReporter::report_refused(const Answer& answer, const CycleRecord& record, double now) {
  const std::string topic = topic_of_answer(answer);
  std::string why = explain(answer.reason);
  if (answer.reason == surg::Reason::kWrongFrame) {
    why = std::string("frame_id is '") + record.wrong_frame.c_str() + "'; allowed is '" +
          record.frame.name.c_str() +
          "' or an empty one; nothing is converted: transform at the sender, or name the frame on "
          "set_base_frame";
  } else if (answer.kind == CommandItem::Kind::kTrack &&
             answer.reason == surg::Reason::kNoAuthority) {
    why = "another node tracks the trocar: run one tracker only";
  } else if (answer.kind == CommandItem::Kind::kAtWall) {
    why = "too many senders slide along the wall; allowed are 16";
  } else if (answer.kind == CommandItem::Kind::kClaim) {
    why += " (held by " + sources_.name(record.out.source) + ")";
  }
  warning(topic + surg::name(answer.reason),
          arm_ + ": " + topic + " from " + sources_.name(answer.source) + " refused: " + why, now);
}

void StatusReporter::report_ignored(const CycleRecord& record) {
  const auto warn = [this](const Ignored& ignored, const char* text) {
    const std::uint32_t bit = 1U << static_cast<unsigned>(ignored.motion);
    if (ignored.motion == surg::Motion::kNone || (ignored_reported_ & bit) != 0) return;
    ignored_reported_ |= bit;
    const std::string topic = topic_of(ignored.motion);
    warning_once("ignored " + topic,
                 arm_ + ": " + topic + " from " + sources_.name(ignored.source) + ": " + text);
  };
  warn(record.orientation,
       "of an orientation only the roll about the shaft is followed: the trocar and the position "
       "fix the rest");
  warn(
      record.angular,
      "of an angular velocity only the part along the shaft (roll) is followed: the trocar and the "
      "linear velocity fix the rest");
}

void StatusReporter::report_verdicts(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  for (int i = 0; i < out.n_verdicts; ++i) {
    const surg::Verdict& verdict = out.verdicts[i];
    if (verdict.reason == surg::Reason::kNone) continue;
    std::string text = arm_ + ": " + topic_of(verdict.motion) + " from " +
                       sources_.name(verdict.source) +
                       " refused: " + surg::sentence(verdict.reason);
    if (verdict.reason == surg::Reason::kNoAuthority) {
      text += " (held by " + sources_.name(out.source) + ")";
    } else if (verdict.reason == surg::Reason::kElbowOutOfReach) {
      text += what_holds_the_elbow(out.elbow_limit);
    }
    warning(surg::name(verdict.reason), text, now);
  }
}

std::string StatusReporter::what_holds_the_elbow(int limit) const {
  if (limit < 0) return "";
  if (limit >= static_cast<int>(joint_names_.size())) {
    return " (a singularity or a straight arm is in between)";
  }
  return " (joint '" + joint_names_[limit] + "' comes to its limit)";
}

/// Of the link where one value is stated, else of the joint that differs most.
void StatusReporter::report_lag(const surg::Outputs& out) {
  double measured = out.link_lag, stated = link_lag_;
  if (std::isnan(measured)) return;
  std::string who = "the robot link";
  for (Eigen::Index i = 0, first = 1; i < joint_lag_.size() && i < out.joint_lag.size(); ++i) {
    const double lag = out.joint_lag[i];
    if (std::isnan(lag)) continue;
    if (!first && std::abs(lag - joint_lag_[i]) <= std::abs(measured - stated)) continue;
    first = 0;
    measured = lag;
    stated = joint_lag_[i];
    who = "joint '" + joint_names_[i] + "'";
  }
  const std::string text = who + " lags " + milliseconds(measured) +
                           " behind its commands; link_lag is " + milliseconds(stated);
  if (!lag_reported_) status(arm_ + ": " + text);
  lag_reported_ = true;
  if (std::abs(measured - stated) > kLagTolerance) {
    warning_once("link_lag", arm_ + ": " + text +
                                 ": on a busy machine that is its lateness; elsewhere set the "
                                 "measured value in the link's YAML");
  }
}

void StatusReporter::report_changes(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  const bool new_state = first_ || out.state != state_;
  const bool new_reason = out.reason != reason_;
  const std::string why =
      out.reason == surg::Reason::kNone
          ? ""
          : std::string("(") + surg::name(out.reason) + "): " + explain(out.reason);
  if (out.state == surg::State::kFault && (new_state || new_reason)) {
    error(arm_ + ": FAULT" + why);
  } else if (new_state) {
    status(arm_ + ": " + surg::name(out.state) + why);
  } else if (new_reason && !why.empty()) {
    // The state is the same, but the arm is held: a warning, since a command has no effect.
    std::string text = arm_ + ": " + surg::sentence(out.reason);
    if (out.reason == surg::Reason::kNotArrived) {
      text += " (" + millimetres((out.p_goal - out.p_BTip).norm()) + " away from it" +
              (*out.limited_by == 0 ? "" : std::string(", held by ") + out.limited_by) + ")";
    }
    if (out.reason == surg::Reason::kElbowOutOfReach) {
      text += what_holds_the_elbow(out.elbow_limit);
    }
    warning(surg::name(out.reason), text, now);
  }
  if (out.homed != homed_) status(arm_ + (out.homed ? ": homed" : ": no longer homed"));
  if (out.warn_rcm) {
    warning("rcm_warn",
            arm_ + ": the shaft is " + millimetres(out.rcm_error) +
                " from the trocar point (warning from " + millimetres(limits_.rcm_error_warn) +
                ", FAULT from " + millimetres(limits_.rcm_error_fault) + ")",
            now);
  }
  if (out.warn_track != surg::TrackWarning::kNone) {
    warning(surg::name(out.warn_track), arm_ + ": " + surg::sentence(out.warn_track), now);
  }
  state_ = out.state;
  reason_ = out.reason;
  homed_ = out.homed;
  first_ = false;
}

}  // namespace surg_control
