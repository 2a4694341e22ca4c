#include "surg_control/echoes.hpp"

namespace surg_control {

void Echoes::remember(std::uint64_t stamp_ns, surg::Motion motion) {
  // A stream that another motion replaces has not been stopped: its sender knows of it.
  if (streaming_ && motion == surg::Motion::kNone) ended_ = count_;
  streaming_ = surg::is_servo(motion);
  stamps_[count_ % kCycles] = stamp_ns;
  ++count_;
}

bool Echoes::late(std::uint64_t stamp_ns) const {
  if (stamp_ns == 0) return false;
  const std::size_t oldest = count_ > kCycles ? count_ - kCycles : 0;
  for (std::size_t i = oldest; i < ended_; ++i) {
    const std::uint64_t own = stamps_[i % kCycles];
    if (own != 0 && (stamp_ns == own || stamp_ns == own + kTickNs)) return true;
  }
  return false;
}

}  // namespace surg_control
