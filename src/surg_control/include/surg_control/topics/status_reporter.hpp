// What happened in a cycle, in words for people: states, refusals, ignored parts.
#pragma once

#include <cstdint>
#include <string>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/topics/announcer.hpp"
#include "surg_control/topics/source_table.hpp"
#include "surg_core/config.hpp"

namespace surg_control {

/// Reads records and speaks through an Announcer. Lives in the publisher's thread.
class Spokesman {
 public:
  Spokesman(const std::string& arm, const surg::Limits& limits, const SourceTable& sources,
            Announcer& announcer);

  /// 'now' [s] as for Announcer. Returns whether the operating state differs from the last one.
  bool speak(const CycleRecord& record, double now);

 private:
  void say_answers(const CycleRecord& record, double now);
  void say_refused(const Answer& answer, const CycleRecord& record, double now);
  void say_ignored(const CycleRecord& record);
  void say_verdicts(const CycleRecord& record, double now);
  bool say_changes(const CycleRecord& record, double now);

  std::string arm_;
  surg::Limits limits_;
  const SourceTable& sources_;
  Announcer& announcer_;
  surg::State state_ = surg::State::kDisabled;
  surg::Reason reason_ = surg::Reason::kNone;
  bool homed_ = false, busy_ = false, first_ = true;
  std::uint32_t said_ignored_ = 0;  // one bit per motion
};

}  // namespace surg_control
