// The image of an object's memory: what BlackBox needs to start a replay in the middle of a run.
// Only plain values have one: no pointers, no heap, their bytes are all there is.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "surg_core/types.hpp"

namespace surg {

/// Whether an object's bytes are all there is to it. Specialise it for classes with Eigen members
/// of fixed or bounded size: these live inline, but have constructors of their own, which the
/// language takes for more.
template <typename T>
struct IsPlain : std::is_trivially_copyable<T> {};
template <typename Scalar, int Rows, int Cols, int Options, int MaxRows, int MaxCols>
struct IsPlain<Eigen::Matrix<Scalar, Rows, Cols, Options, MaxRows, MaxCols>>
    : std::bool_constant<MaxRows != Eigen::Dynamic && MaxCols != Eigen::Dynamic> {};
template <>
struct IsPlain<Pose> : std::true_type {};

/// Writes members one after the other, the first at 'begin'. Beyond 'room' it only counts.
class ImageWriter {
 public:
  ImageWriter(std::byte* to, std::size_t room, std::size_t begin = 0)
      : to_(to), room_(room), size_(begin) {}
  template <typename... T>
  void operator()(T&... members) {
    (one(members), ...);
  }
  std::size_t size() const { return size_; }  ///< needed so far, 'begin' included
  std::uint64_t layout() const { return layout_; }

 private:
  template <typename T>
  void one(T& member) {
    static_assert(IsPlain<T>::value && !std::is_pointer_v<T>, "not a plain value");
    if (size_ + sizeof member <= room_) std::memcpy(to_ + size_, &member, sizeof member);
    size_ += sizeof member;
    layout_ = (layout_ ^ sizeof member) * 1099511628211ULL;  // FNV-1a over the sizes, in order
  }

  std::byte* to_;
  std::size_t room_, size_;
  std::uint64_t layout_ = 1469598103934665603ULL;
};

/// Puts members back. The caller has compared size and layout.
class ImageReader {
 public:
  explicit ImageReader(const std::byte* from) : from_(from) {}
  template <typename... T>
  void operator()(T&... members) {
    (one(members), ...);
  }

 private:
  template <typename T>
  void one(T& member) {
    static_assert(IsPlain<T>::value && !std::is_pointer_v<T>, "not a plain value");
    std::memcpy(static_cast<void*>(&member), from_, sizeof member);
    from_ += sizeof member;
  }

  const std::byte* from_;
};

}  // namespace surg
