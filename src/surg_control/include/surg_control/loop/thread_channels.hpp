// Channels between callback, control and publisher thread; the control thread never waits.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <vector>

namespace surg_control {

/// Preallocated single-producer single-consumer ring. Neither side blocks; push returns false if
/// full.
template <typename T>
class SpscRing {
 public:
  /// Room for 'capacity' values.
  explicit SpscRing(std::size_t capacity) : slots_(capacity + 1) {}

  bool push(const T& value) {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    const std::size_t next = (tail + 1) % slots_.size();
    if (next == head_.load(std::memory_order_acquire)) return false;
    slots_[tail] = value;
    tail_.store(next, std::memory_order_release);
    return true;
  }

  bool pop(T& value) {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head == tail_.load(std::memory_order_acquire)) return false;
    value = slots_[head];
    head_.store((head + 1) % slots_.size(), std::memory_order_release);
    return true;
  }

 private:
  std::vector<T> slots_;
  alignas(64) std::atomic<std::size_t> head_{0};
  alignas(64) std::atomic<std::size_t> tail_{0};
};

/// The latest value of one writer, for one reader. Neither waits: three slots, of which writer and
/// reader own one each and swap it with the third.
template <typename T>
class LatestSlot {
 public:
  void put(const T& value) {
    slots_[back_] = value;
    back_ = middle_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex;
  }

  /// Copies the newest value into 'value'; false if it was taken before.
  bool take(T& value) {
    if ((middle_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    value = slots_[front_];
    return true;
  }

 private:
  static constexpr unsigned kFresh = 4, kIndex = 3;
  std::array<T, 3> slots_{};
  unsigned back_ = 0, front_ = 1;
  std::atomic<unsigned> middle_{2};
};

}  // namespace surg_control
