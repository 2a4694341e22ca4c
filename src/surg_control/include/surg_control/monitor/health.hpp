// Counters that several threads add to and the diagnostics read.
#pragma once

#include <atomic>
#include <cstdint>

namespace surg_control {

struct Health {
  std::atomic<bool> master_lost{false};          ///< F07
  std::atomic<std::uint32_t> clock_steps{0};     ///< F09: wall clock stepped against the steady one
  std::atomic<std::uint32_t> future_stamps{0};   ///< F09: messages stamped in the future
  std::atomic<std::uint32_t> late_states{0};     ///< F11: joint states older than the last one
  std::atomic<std::uint32_t> records_lost{0};    ///< cycles that were not published
  std::atomic<std::uint32_t> changed_params{0};  ///< F16: parameters that differ from the copy
};

}  // namespace surg_control
