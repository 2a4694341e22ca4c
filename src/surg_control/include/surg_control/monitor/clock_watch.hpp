// F09: what a wall clock that jumps may do to us: nothing but be noticed. Pure.
#pragma once

#include <cstdint>

namespace surg_control {

/// More than 50 ms ahead of the wall clock; what lies behind it may have been under way.
inline bool is_from_the_future(std::int64_t stamp_ns, std::int64_t wall_ns) {
  return stamp_ns - wall_ns > 50'000'000;
}

/// Compares two clocks now and then.
class ClockWatch {
 public:
  static constexpr std::int64_t kStepNs = 500'000'000;

  /// How far [ns] the wall clock has stepped against the steady one since the last look, where that
  /// is more than kStepNs; otherwise 0. A slow drift is no step.
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
