// What the tests of the core share: sizes of the random families, and proof that a function leaves
// the heap alone. Include it in one file per test program only: it replaces malloc.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>

namespace surg::test {

/// Size of a random family: 'reduced' as a rule, 'full' with SURG_TEST_FULL=1 in the environment.
inline int family(int reduced, int full) {
  const char* setting = std::getenv("SURG_TEST_FULL");
  return setting != nullptr && std::strcmp(setting, "1") == 0 ? full : reduced;
}

/// Prints how much a test looked at.
inline void report(const char* what, long count) {
  std::printf("[   count  ] %ld %s\n", count, what);
}

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  double normal() { return std::normal_distribution<double>()(engine_); }
  int integer(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  /// Log-uniform, for values whose order of magnitude is unknown.
  double magnitude(double low, double high) {
    return low * std::pow(high / low, uniform(0.0, 1.0));
  }

 private:
  std::mt19937_64 engine_;
};

inline thread_local bool watching_heap = false;
inline thread_local long heap_calls = 0;

/// Counts heap calls of this thread during its life.
class HeapWatch {
 public:
  HeapWatch() {
    heap_calls = 0;
    watching_heap = true;
  }
  ~HeapWatch() { watching_heap = false; }
  HeapWatch(const HeapWatch&) = delete;
  HeapWatch& operator=(const HeapWatch&) = delete;
  /// Stops counting and tells how many there were.
  long calls() {
    watching_heap = false;
    return heap_calls;
  }
};

}  // namespace surg::test

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define SURG_HEAP_IS_WATCHED 1
// The program's own definitions come first in symbol look-up, for shared libraries and operator new
// too.
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t n, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);

void* malloc(std::size_t size) noexcept {
  if (surg::test::watching_heap) ++surg::test::heap_calls;
  return __libc_malloc(size);
}
void* calloc(std::size_t n, std::size_t size) noexcept {
  if (surg::test::watching_heap) ++surg::test::heap_calls;
  return __libc_calloc(n, size);
}
void* realloc(void* block, std::size_t size) noexcept {
  if (surg::test::watching_heap) ++surg::test::heap_calls;
  return __libc_realloc(block, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  if (surg::test::watching_heap) ++surg::test::heap_calls;
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** block, std::size_t alignment, std::size_t size) noexcept {
  if (surg::test::watching_heap) ++surg::test::heap_calls;
  *block = __libc_memalign(alignment, size);
  return *block == nullptr ? 12 : 0;  // ENOMEM
}
}
#else
#define SURG_HEAP_IS_WATCHED 0
#endif
