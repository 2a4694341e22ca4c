// The free-run thread's clock and its optional privileges.
#pragma once

#include <cstdint>
#include <string>

namespace surg_control {

/// Nanoseconds of the steady clock (CLOCK_MONOTONIC): no step of the wall clock moves it.
std::int64_t steady_ns();

/// Wakes up every period on the steady clock.
class Metronome {
 public:
  explicit Metronome(std::int64_t period_ns) : period_(period_ns), next_(steady_ns()) {}

  /// Sleeps until the next beat and returns the nanoseconds since the last one (one period at the
  /// first). After a beat more than one period late, counting restarts from now: a thread that was
  /// suspended must not catch up in a burst.
  std::int64_t wait();
  /// Whether the last beat came more than one period late.
  bool late() const { return late_; }

 private:
  std::int64_t period_, next_, last_ = 0;
  bool late_ = false;
};

/// Gives the calling thread SCHED_FIFO, 'below' steps under the control thread's priority, and
/// locks the process's memory if 'lock'. Returns an empty text, or what was refused and how to
/// allow it; the thread then continues without.
std::string become_realtime(int below, bool lock);

}  // namespace surg_control
