// A clock that throws, for processes that must end with a zero command: preloaded into a node, it
// throws in the thread that waits for an absolute time (the control loop) once FAILING_CLOCK
// exists.
#include <dlfcn.h>
#include <time.h>
#include <unistd.h>

#include <cstdlib>
#include <stdexcept>

extern "C" int clock_nanosleep(clockid_t clock, int flags, const timespec* until, timespec* left) {
  using Function = int (*)(clockid_t, int, const timespec*, timespec*);
  static const auto real = reinterpret_cast<Function>(dlsym(RTLD_NEXT, "clock_nanosleep"));
  const char* path = std::getenv("FAILING_CLOCK");
  if ((flags & TIMER_ABSTIME) != 0 && path != nullptr && access(path, F_OK) == 0) {
    throw std::runtime_error("the clock failed");
  }
  return real(clock, flags, until, left);
}
