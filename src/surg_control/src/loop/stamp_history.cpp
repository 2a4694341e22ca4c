#include "surg_control/loop/stamp_history.hpp"

#include <algorithm>

namespace surg_control {

void Echoes::remember(std::uint64_t stamp_ns, surg::Motion motion) {
  // A stream that another motion replaces has not been stopped: its sender knows of it.
  if (streaming_ && motion == surg::Motion::kNone) ended_ = count_;
  streaming_ = surg::is_servo(motion);
  if (count_ > 0 && stamp_ns < stamps_[(count_ - 1) % kCycles]) ascending_ = count_;
  stamps_[count_ % kCycles] = stamp_ns;
  ++count_;
}

bool Echoes::late(std::uint64_t stamp_ns) const {
  if (stamp_ns == 0) return false;
  return stopped_with(stamp_ns) || (stamp_ns > kTickNs && stopped_with(stamp_ns - kTickNs));
}

bool Echoes::stopped_with(std::uint64_t own) const {
  const std::size_t oldest = count_ > kCycles ? count_ - kCycles : 0;
  // Only what came before the link's clock went back, in the last four seconds, is walked through.
  const std::size_t walked = std::min(ended_, ascending_);
  for (std::size_t i = oldest; i < walked; ++i) {
    if (stamps_[i % kCycles] == own) return true;
  }
  std::size_t first = std::max(oldest, ascending_), last = ended_;
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
