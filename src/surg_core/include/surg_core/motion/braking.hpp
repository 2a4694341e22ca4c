// The hardest stop that acceleration and jerk limits allow, from any velocity and acceleration, in
// closed form: how long it takes, where it ends and how far out it swings on the way.
#pragma once

#include <array>

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// A motion of at most three pieces of constant jerk, then at constant velocity (none, after a
/// stop). A plain value; nothing here fails.
class Braking {
 public:
  /// Stands still at 0 for ever.
  Braking() = default;
  /// To a standstill in the least time with |a| <= limits.acceleration, |jerk| <= limits.jerk; the
  /// velocity limit plays no part. The velocity changes its sign at most once, and only where the
  /// present acceleration leaves no other way. An acceleration beyond its limit comes back with
  /// full jerk.
  static Braking stop(const Kinematic& from, const DofLimits& limits);
  /// To zero acceleration with full jerk, then on at the velocity reached.
  static Braking ease(const Kinematic& from, const DofLimits& limits);

  double duration() const;       ///< until the jerk is over [s]
  Kinematic at(double t) const;  ///< t < 0: the start; from duration() on exactly a = 0
  /// From the start to the end of the jerk, signed: the exact braking distance of a stop.
  double distance() const { return end_.x - from_.x; }
  /// Least and greatest position between two times, exact.
  Interval range(double t0, double t1) const;

 private:
  struct Piece {
    double duration = 0, jerk = 0;
  };
  void finish(double v_end);

  Kinematic from_{}, end_{};
  std::array<Piece, 3> pieces_{};
};

}  // namespace surg
