// Snapshots of the controller's memory, from which BlackBox starts a replay in the middle of a run.
// Only plain values can be stored: no pointers, no heap, nothing beyond their bytes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "surg_core/types.hpp"

namespace surg {

/// Whether an object consists of its bytes alone: what has nothing to release holds no heap.
/// Eigen's matrices of fixed or bounded size are such, though not trivially copyable.
template <typename T>
constexpr bool kIsPlain = std::is_trivially_destructible_v<T> && !std::is_pointer_v<T>;

/// Writes members one after the other, starting at 'begin'. Beyond 'room' it only counts.
class SnapshotWriter {
 public:
  SnapshotWriter(std::byte* to, std::size_t room, std::size_t begin = 0)
      : to_(to), room_(room), size_(begin) {}
  template <typename... T>
  void operator()(T&... members) {
    (copy(members), ...);
  }
  std::size_t size() const { return size_; }  ///< needed so far, 'begin' included
  std::uint64_t layout() const { return layout_; }

 private:
  template <typename T>
  void copy(T& member) {
    static_assert(kIsPlain<T>, "not a plain value");
    if (size_ + sizeof member <= room_) {
      std::memcpy(to_ + size_, static_cast<const void*>(&member), sizeof member);
    }
    size_ += sizeof member;
    layout_ = (layout_ ^ sizeof member) * 1099511628211ULL;  // FNV-1a over the sizes, in order
  }

  std::byte* to_;
  std::size_t room_, size_;
  std::uint64_t layout_ = 1469598103934665603ULL;
};

/// Reads members back. The caller has compared size and layout.
class SnapshotReader {
 public:
  explicit SnapshotReader(const std::byte* from) : from_(from) {}
  template <typename... T>
  void operator()(T&... members) {
    (copy(members), ...);
  }

 private:
  template <typename T>
  void copy(T& member) {
    static_assert(kIsPlain<T>, "not a plain value");
    std::memcpy(static_cast<void*>(&member), from_, sizeof member);
    from_ += sizeof member;
  }

  const std::byte* from_;
};

}  // namespace surg
