// Recorded joint path: the guaranteed way back. An arm can reverse any motion it has made, while a
// straight retraction may be geometrically impossible.
#pragma once

#include <array>

#include "surg_core/types.hpp"

namespace surg {

/// A joint path in bounded memory, with a point every 'spacing' of joint motion. Where the joints
/// return to an earlier point, the loop between is removed. When the memory is full, every second
/// point is removed and the spacing doubles, so the way from the first point stays complete.
class JointTrace {
 public:
  static constexpr int kCapacity = 1024;    ///< points of the trace
  static constexpr double kSpacing = 0.01;  ///< [rad] of the fastest joint, to begin with

  void clear();
  /// Records the present joints [rad]; call it once per cycle.
  void record(const JointVector& q);
  /// Removes the newest 's' [rad], which have been retraced.
  void shorten(double s);

  bool empty() const { return n_ == 0; }
  int size() const { return n_; }
  /// Length of the way back [rad]: sum of the largest joint motion from point to point.
  double length() const { return n_ == 0 ? 0.0 : arc_[n_ - 1] + ahead_; }
  /// Joints 's' [rad] of that length back from the newest point; clamped to 0..length().
  /// Continuous with its first derivative.
  JointVector at(double s) const;

 private:
  const JointVector& point(int i) const { return i < n_ ? points_[i] : newest_; }
  double arc(int i) const { return i < n_ ? arc_[i] : length(); }
  bool cut_loop(const JointVector& q);
  void thin();

  int n_ = 0;
  double spacing_ = kSpacing;
  std::array<JointVector, kCapacity> points_;
  std::array<double, kCapacity> arc_{};  ///< from the first point
  JointVector newest_;                   ///< not yet a point of its own
  double ahead_ = 0;                     ///< its distance from the last point
};

}  // namespace surg
