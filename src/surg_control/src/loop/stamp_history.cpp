#include "surg_control/loop/stamp_history.hpp"

#include <algorithm>

namespace surg_control {

void StampHistory::add(std::uint64_t stamp_ns, surg::Motion motion) {
  // A stream that another motion replaces has not been stopped: its sender knows of it.
  if (streaming_ && motion == surg::Motion::kNone) stream_end_ = count_;
  streaming_ = surg::is_servo(motion);
  if (count_ > 0 && stamp_ns < stamps_[(count_ - 1) % kCycles]) ascending_ = count_;
  stamps_[count_ % kCycles] = stamp_ns;
  ++count_;
}

bool StampHistory::is_late(std::uint64_t stamp_ns) const {
  if (stamp_ns == 0) return false;
  return before_last_stop(stamp_ns) || (stamp_ns > kTickNs && before_last_stop(stamp_ns - kTickNs));
}

bool StampHistory::before_last_stop(std::uint64_t own) const {
  const std::size_t oldest = count_ > kCycles ? count_ - kCycles : 0;
  // Only what came before the link's clock went back, in the last four seconds, is walked through.
  const std::size_t walked = std::min(stream_end_, ascending_);
  for (std::size_t i = oldest; i < walked; ++i) {
    if (stamps_[i % kCycles] == own) return true;
  }
  std::size_t first = std::max(oldest, ascending_), last = stream_end_;
  while (first < last) {
    const std::size_t middle = first + (last - first) / 2;
    const std::uint64_t stamp = stamps_[middle % kCycles];
    if (stamp == own) return true;
    if (stamp < own) {
      first = middle + 1;
    } else {
      last = middle;
    }
  }
  return false;
}

}  // namespace surg_control
