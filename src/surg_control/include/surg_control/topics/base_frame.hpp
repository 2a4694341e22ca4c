// set_base_frame: the user's frame U, in which commands arrive and measured_cp is published. The
// controller itself uses the rcm frame R only. Pure.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <string_view>

#include "surg_core/types.hpp"

namespace surg_control {

/// A frame_id as plain bytes, so that the control thread can compare one without the heap.
class FrameName {
 public:
  static constexpr std::size_t kLongest = 63;

  FrameName() = default;
  /// Keeps the first kLongest characters; 'fits' tells whether the name is that short.
  explicit FrameName(std::string_view name) {
    std::copy_n(name.begin(), std::min(name.size(), kLongest), text_.begin());
  }
  static bool fits(std::string_view name) {
    return name.size() <= kLongest && name.find('\0') == std::string_view::npos;
  }

  bool empty() const { return text_[0] == '\0'; }
  const char* c_str() const { return text_.data(); }
  bool operator==(const FrameName& other) const { return text_ == other.text_; }
  bool operator!=(const FrameName& other) const { return !(*this == other); }

 private:
  std::array<char, kLongest + 1> text_{};  // the last byte stays 0
};

/// U, and where the rcm frame lies in it.
struct BaseFrame {
  FrameName name;
  surg::Pose X_UR = surg::Pose::Identity();
  std::uint32_t version = 0;  ///< counts the changes
};

/// A tool pose without its frame.
struct ToolPose {
  surg::Vector3 p;
  Eigen::Quaterniond q;
};
/// X_RTool from X_UTool.
ToolPose pose_to_rcm(const surg::Pose& X_UR, const ToolPose& X_UTool);
/// X_UTool from X_RTool.
ToolPose pose_from_rcm(const surg::Pose& X_UR, const ToolPose& X_RTool);

/// Velocity of the tip and angular velocity of the tool. U and R do not move relative to each
/// other, so both vectors only rotate.
struct ToolTwist {
  surg::Vector3 v, omega;
};
ToolTwist twist_to_rcm(const surg::Pose& X_UR, const ToolTwist& in_U);
ToolTwist twist_from_rcm(const surg::Pose& X_UR, const ToolTwist& in_R);

}  // namespace surg_control
