// Preloaded by tests into the nodes of a graph: delays what they send, at random, as a busy machine
// does. See socket_jitter.py.

#include <dlfcn.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdint>
#include <cstdlib>

namespace {

/// In [0, 1); another sequence in every process and run.
double random_share() {
  static std::atomic<std::uint64_t> state{[] {
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<std::uint64_t>(now.tv_nsec) ^ (static_cast<std::uint64_t>(getpid()) << 32);
  }()};
  std::uint64_t x = state.fetch_add(0x9e3779b97f4a7c15ULL);
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return static_cast<double>((x ^ (x >> 31)) >> 11) * 0x1p-53;
}

double setting(const char* name) {
  const char* text = std::getenv(name);
  return text == nullptr ? 0.0 : std::atof(text);
}

void delay() {
  static const double seconds = 1e-3 * setting("SOCKET_JITTER_MS");
  static const double share = setting("SOCKET_JITTER_SHARE");
  if (seconds <= 0 || random_share() >= share) return;
  const int error = errno;
  const timespec wait{0, static_cast<long>(1e9 * seconds * random_share())};
  nanosleep(&wait, nullptr);
  errno = error;
}

template <typename Function>
Function* original(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

}  // namespace

extern "C" ssize_t send(int socket, const void* data, size_t size, int flags) {
  static auto* const next = original<ssize_t(int, const void*, size_t, int)>("send");
  delay();
  return next(socket, data, size, flags);
}

extern "C" ssize_t sendmsg(int socket, const msghdr* message, int flags) {
  static auto* const next = original<ssize_t(int, const msghdr*, int)>("sendmsg");
  delay();
  return next(socket, message, flags);
}
