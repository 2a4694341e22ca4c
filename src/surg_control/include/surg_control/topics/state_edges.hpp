#pragma once

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// Decides which cycles operating_state reports, and whether it says is_busy.
///
/// A CRTK client's wait() ends at the first message without is_busy after one with it, both stamped
/// later than the command. So every command that such a client waits for is followed by both, also
/// when it is refused, when it ends in the cycle that takes it, or when records in between are
/// lost.
class StateEdges {
 public:
  struct Report {
    bool due = false;
    bool busy = false;
  };

  Report next(const CycleRecord& record);

 private:
  bool first_ = true, homed_ = false, busy_ = false;
  surg::State state_ = surg::State::kDisabled;
  std::uint32_t moves_ = 0;
};

}  // namespace surg_control
