// The fastest stop within acceleration and jerk limits, from any velocity and acceleration, in
// closed form: duration, end position and overshoot.
#pragma once

#include <array>

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// A motion of at most three segments of constant jerk, followed by constant velocity (zero after a
/// stop). A plain value; nothing here fails.
class Braking {
 public:
  /// At rest at position 0.
  Braking() = default;
  /// Stops in minimum time with |a| <= limits.acceleration and |jerk| <= limits.jerk; the velocity
  /// limit is not used. The velocity changes sign at most once, and only if the present
  /// acceleration forces it. An acceleration beyond its limit is reduced with full jerk.
  static Braking stop(const Kinematic& from, const DofLimits& limits);
  /// Reduces the acceleration to zero with full jerk, then keeps the velocity.
  static Braking ease(const Kinematic& from, const DofLimits& limits);

  double duration() const;       ///< until the jerk is over [s]
  Kinematic at(double t) const;  ///< t < 0: the start; from duration() on exactly a = 0
  /// Signed distance from the start to the end of the last jerk segment: for a stop, the exact
  /// braking distance.
  double distance() const { return end_.x - from_.x; }

 private:
  struct Piece {
    double duration = 0, jerk = 0;
  };
  void finish(double v_end);

  Kinematic from_{}, end_{};
  std::array<Piece, 3> pieces_{};
};

}  // namespace surg
