#include "surg_control/loop/realtime.hpp"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <time.h>

#include <cerrno>
#include <cstring>

namespace surg_control {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr int kPriority = 80;  // above everything of the node, below the kernel's own threads (99)

}  // namespace

std::int64_t steady_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kSecond + now.tv_nsec;
}

std::int64_t Metronome::wait() {
  next_ += period_;
  const timespec until{next_ / kSecond, next_ % kSecond};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  const std::int64_t now = steady_ns();
  late_ = now - next_ > period_;
  if (late_) next_ = now;
  const std::int64_t since = last_ == 0 ? period_ : now - last_;
  last_ = now;
  return since;
}

std::string become_realtime(int below, bool lock) {
  std::string refused;
  if (lock && mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    refused = std::string("locked memory (") + std::strerror(errno) + ")";
  }
  sched_param parameters{};
  parameters.sched_priority = kPriority - below;
  if (const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters)) {
    refused +=
        (refused.empty() ? "" : " and ") + std::string("SCHED_FIFO (") + std::strerror(error) + ")";
  }
  if (refused.empty()) return {};
  return "the system refuses " + refused +
         "; the loop runs without: raise 'rtprio' and 'memlock' in /etc/security/limits.conf for "
         "this user";
}

}  // namespace surg_control
