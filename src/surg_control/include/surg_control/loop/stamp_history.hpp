// What a command answers: told by the stamp that its sender has copied from the arm.
//
// A stamp is looked up among those of the arm's own cycles and never read as a time, so it takes no
// clock in common. A network that stalls delivers what was sent meanwhile all at once; what answers
// a cycle from before the arm has stopped was sent by somebody who did not know of the stop.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// Remembers the stamps of the last four seconds of cycles. Allocates nothing; a look-up is a
/// search by halves, for it stands in the control cycle, once for every command.
class Echoes {
 public:
  /// Longer than any role keeps what the other machine has not acknowledged (3 s).
  static constexpr std::size_t kCycles = 2048;

  /// One cycle has been computed from the state with this stamp (0: none), obeying 'motion'.
  void remember(std::uint64_t stamp_ns, surg::Motion motion);
  /// True for the stamp of a cycle from before the last end of a stream, or for the tick after it,
  /// which is what a sender writes that means the next cycle. False for every other stamp: it is of
  /// some clock, and clocks decide nothing (F09).
  bool late(std::uint64_t stamp_ns) const;

 private:
  /// Whether a cycle from before the last end of a stream had this stamp (not 0).
  bool stopped_with(std::uint64_t own) const;

  std::array<std::uint64_t, kCycles> stamps_{};
  std::size_t count_ = 0;      // of cycles so far; the newest is at (count_ - 1) % kCycles
  std::size_t ended_ = 0;      // the cycle in which a stream was last obeyed no more; 0: none yet
  std::size_t ascending_ = 0;  // from this cycle on no stamp is smaller than the one before
  bool streaming_ = false;
};

}  // namespace surg_control
