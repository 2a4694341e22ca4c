#include "surg_control/topics/status_reporter.hpp"

#include <cstdio>

#include "surg_control/topics/decode.hpp"

namespace surg_control {
namespace {

std::string millimetres(double metres) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f mm", metres * 1e3);
  return text;
}

const char* topic_of_answer(const Answer& answer) {
  switch (answer.kind) {
    case CommandItem::Kind::kState:
      return word_of(answer.state);
    case CommandItem::Kind::kSetRcm:
      return "rcm/set_cp";
    case CommandItem::Kind::kSetFrame:
      return "set_base_frame";
    case CommandItem::Kind::kClaim:
      return "authority/claim";
    case CommandItem::Kind::kTrack:
      return "rcm/track";
    case CommandItem::Kind::kMotion:
      return topic_of(answer.motion);
  }
  return "unknown";
}

}  // namespace

Spokesman::Spokesman(const std::string& arm, const surg::Limits& limits, const SourceTable& sources,
                     Announcer& announcer)
    : arm_(arm), limits_(limits), sources_(sources), announcer_(announcer) {}

bool Spokesman::speak(const CycleRecord& record, double now) {
  say_answers(record, now);
  say_ignored(record);
  say_verdicts(record, now);
  return say_changes(record, now);
}

void Spokesman::say_answers(const CycleRecord& record, double now) {
  for (int i = 0; i < record.n_answers; ++i) {
    const Answer& answer = record.answers[i];
    if (answer.reason != surg::Reason::kNone) {
      say_refused(answer, record, now);
      continue;
    }
    const std::string from =
        arm_ + ": " + topic_of_answer(answer) + " from " + sources_.name(answer.source);
    if (answer.kind == CommandItem::Kind::kSetRcm) {
      announcer_.status(from + ": trocar point taught");
    } else if (answer.kind == CommandItem::Kind::kSetFrame) {
      announcer_.status(from + ": commands and measured_cp are in '" + record.frame.name.c_str() +
                        "' now");
    } else if (answer.kind == CommandItem::Kind::kClaim) {
      announcer_.status(from + ": it alone commands the arm until the arm leaves ENABLED");
    }
  }
}

void Spokesman::say_refused(const Answer& answer, const CycleRecord& record, double now) {
  const std::string topic = topic_of_answer(answer);
  std::string why = surg::sentence(answer.reason);
  if (answer.reason == surg::Reason::kWrongFrame) {
    why = std::string("frame_id is '") + record.wrong_frame.c_str() + "'; allowed is '" +
          record.frame.name.c_str() +
          "' or an empty one; nothing is converted: transform at the sender, or name the frame on "
          "set_base_frame";
  } else if (answer.kind == CommandItem::Kind::kTrack &&
             answer.reason == surg::Reason::kNoAuthority) {
    why = "another node tracks the trocar: run one tracker only";
  } else if (answer.kind == CommandItem::Kind::kClaim) {
    why += " (held by " + sources_.name(record.out.source) + ")";
  }
  announcer_.warning(
      topic + surg::name(answer.reason),
      arm_ + ": " + topic + " from " + sources_.name(answer.source) + " refused: " + why, now);
}

void Spokesman::say_ignored(const CycleRecord& record) {
  const auto say = [this](const Ignored& ignored, const char* what) {
    const std::uint32_t bit = 1U << static_cast<unsigned>(ignored.motion);
    if (ignored.motion == surg::Motion::kNone || (said_ignored_ & bit) != 0) return;
    said_ignored_ |= bit;
    const std::string topic = topic_of(ignored.motion);
    announcer_.warning_once("ignored " + topic, arm_ + ": " + topic + " from " +
                                                    sources_.name(ignored.source) + ": " + what);
  };
  say(record.orientation,
      "of an orientation only the roll about the shaft is followed: the trocar and the position "
      "fix the rest");
  say(record.angular,
      "of an angular velocity only the part along the shaft (roll) is followed: the trocar and the "
      "linear velocity fix the rest");
}

void Spokesman::say_verdicts(const CycleRecord& record, double now) {
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

bool Spokesman::say_changes(const CycleRecord& record, double now) {
  const surg::Outputs& out = record.out;
  const bool moved = first_ || out.state != state_;
  const bool because = out.reason != reason_;
  const bool changed = moved || out.homed != homed_ || out.busy != busy_;
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
  return changed;
}

}  // namespace surg_control
