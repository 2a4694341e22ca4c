// F09: detects steps of the wall clock; control does not depend on it. Pure.
#pragma once

#include <cstdint>

namespace surg_control {

/// Whether a stamp is more than 50 ms ahead of the wall clock; an older one may have been in
/// transit.
inline bool is_from_the_future(std::int64_t stamp_ns, std::int64_t wall_ns) {
  return stamp_ns - wall_ns > 50'000'000;
}

/// Compares the wall clock with the steady clock.
class ClockWatch {
 public:
  static constexpr std::int64_t kStepNs = 500'000'000;

  /// Step [ns] of the wall clock against the steady clock since the last call if larger than
  /// kStepNs, otherwise 0. A slow drift is no step.
  std::int64_t look(std::int64_t wall_ns, std::int64_t steady_ns) {
    const std::int64_t offset = wall_ns - steady_ns;
    const std::int64_t by = seen_ ? offset - offset_ : 0;
    seen_ = true;
    offset_ = offset;
    return by > kStepNs || by < -kStepNs ? by : 0;
  }

 private:
  bool seen_ = false;
  std::int64_t offset_ = 0;
};

}  // namespace surg_control
