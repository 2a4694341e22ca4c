// Where the joints have been: the guaranteed way back. What the arm has done forwards it can do
// backwards, while a straight retraction may be geometrically impossible.
#pragma once

#include <array>

#include "surg_core/types.hpp"

namespace surg {

/// A recorded joint path in bounded memory. New points are taken every 'spacing' of joint motion.
/// Where the joints come back to an earlier point the loop between is dropped. When the memory is
/// full all the same, every second point goes and the spacing doubles: the way from the first point
/// is always kept whole.
class JointTrace {
 public:
  static constexpr int kCapacity = 1024;
  static constexpr double kSpacing = 0.01;  ///< [rad] of the fastest joint, to begin with

  void clear();
  /// Where the joints are now [rad]; once a cycle.
  void record(const JointVector& q);
  /// The newest 's' [rad] have been gone back, and are no part of the way out any more.
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
