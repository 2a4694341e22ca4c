// The port guard: `./surg up CELL --role R --port-guard` preloads it into every node, for machines
// with a second network (docs/guide/two_machines.md).
//
// ROS 1 opens its ports on every address of a machine. This library replaces three libc functions,
// in C++ and Python nodes alike:
//  * bind: a TCP port on "any address" is bound to SURG_LISTEN_ON alone;
//  * listen, connect: a connection ends when data stays unacknowledged for SURG_TCP_TIMEOUT_MS.
//    A restored link then delivers nothing old.
// Without these variables it does nothing. `./surg up --role` checks the open ports afterwards.

#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstdlib>

namespace {

/// The libc function that this library hides.
template <typename Function>
Function* next(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}

bool is_tcp(int socket) {
  int type = 0, family = 0;
  socklen_t size = sizeof type;
  if (getsockopt(socket, SOL_SOCKET, SO_TYPE, &type, &size) != 0) return false;
  size = sizeof family;
  if (getsockopt(socket, SOL_SOCKET, SO_DOMAIN, &family, &size) != 0) return false;
  return type == SOCK_STREAM && (family == AF_INET || family == AF_INET6);
}

void limit_waiting(int socket) {
  const int before = errno;
  const char* text = std::getenv("SURG_TCP_TIMEOUT_MS");
  const long milliseconds = text ? std::strtol(text, nullptr, 10) : 0;
  if (milliseconds > 0 && is_tcp(socket)) {
    const unsigned int value = static_cast<unsigned int>(milliseconds);
    setsockopt(socket, IPPROTO_TCP, TCP_USER_TIMEOUT, &value, sizeof value);
  }
  errno = before;
}

}  // namespace

extern "C" int bind(int socket, const sockaddr* address, socklen_t length) {
  static auto* const real = next<int(int, const sockaddr*, socklen_t)>("bind");
  const char* text = std::getenv("SURG_LISTEN_ON");
  if (!text || !address || length < sizeof(sockaddr_in) || !is_tcp(socket)) {
    return real(socket, address, length);
  }
  if (address->sa_family == AF_INET6) {  // nobody asked for it: no port rather than an open one
    if (length >= sizeof(sockaddr_in6) &&
        IN6_IS_ADDR_LOOPBACK(&reinterpret_cast<const sockaddr_in6*>(address)->sin6_addr)) {
      return real(socket, address, length);
    }
    errno = EADDRNOTAVAIL;
    return -1;
  }
  sockaddr_in chosen = *reinterpret_cast<const sockaddr_in*>(address);
  if (chosen.sin_family == AF_INET && chosen.sin_addr.s_addr == htonl(INADDR_ANY) &&
      inet_pton(AF_INET, text, &chosen.sin_addr) != 1) {
    errno = EADDRNOTAVAIL;
    return -1;
  }
  return real(socket, reinterpret_cast<const sockaddr*>(&chosen), sizeof chosen);
}

extern "C" int listen(int socket, int backlog) {
  static auto* const real = next<int(int, int)>("listen");
  limit_waiting(socket);  // what it accepts inherits it
  return real(socket, backlog);
}

extern "C" int connect(int socket, const sockaddr* address, socklen_t length) {
  static auto* const real = next<int(int, const sockaddr*, socklen_t)>("connect");
  limit_waiting(socket);
  return real(socket, address, length);
}
