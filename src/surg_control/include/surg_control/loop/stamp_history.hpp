// Detects commands that answer a state from before the last stop, by the stamp that the sender
// copied from the arm.
//
// A stamp is looked up among those of the arm's own cycles and never interpreted as a time, so the
// clocks need not agree. After a stall, a network delivers everything sent meanwhile at once. A
// command that answers a cycle from before a stop comes from a sender that did not know of the
// stop.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// Stamps of the last four seconds of cycles. Allocates nothing; a look-up is a binary search, as
/// it runs in the control cycle once per command.
class StampHistory {
 public:
  /// 4 s: longer than the TCP timeout of any role of a distributed cell (3 s).
  static constexpr std::size_t kCycles = 2048;

  /// Adds a cycle computed from the state with this stamp (0: none), executing 'motion'.
  void add(std::uint64_t stamp_ns, surg::Motion motion);
  /// True for the stamp of a cycle before the last end of a stream, or for the tick after it (which
  /// a sender writes for the next cycle). False for all other stamps: they belong to another clock
  /// and are not judged (F09).
  bool is_late(std::uint64_t stamp_ns) const;

 private:
  /// Whether a cycle from before the last end of a stream had this stamp (not 0).
  bool before_last_stop(std::uint64_t own) const;

  std::array<std::uint64_t, kCycles> stamps_{};
  std::size_t count_ = 0;       // of cycles so far; the newest is at (count_ - 1) % kCycles
  std::size_t stream_end_ = 0;  // the cycle in which a stream was last obeyed no more; 0: none yet
  std::size_t ascending_ = 0;   // from this cycle on no stamp is smaller than the one before
  bool streaming_ = false;
};

}  // namespace surg_control
