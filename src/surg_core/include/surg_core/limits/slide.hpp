// Motion of the tip along virtual fixtures. A tip comes near a wall only as fast as it can brake
// before it; what leads farther in is removed and the rest goes on, so that the tip slides. Motion
// away is never limited. A tip that is already beyond a wall is not moved, but may not go deeper.
#pragma once

#include <array>

#include "surg_core/limits/fixtures.hpp"

namespace surg {

/// n . x >= least, with a unit vector n.
struct Constraint {
  Vector3 n;
  double least;
};

/// The point nearest to x0 in the intersection of 'count' half-spaces. Exact: Seidel's incremental
/// method. Returns false, and leaves x alone, if the half-spaces have no common point.
bool nearest_in(const Constraint* spaces, int count, const Vector3& x0, Vector3& x);

/// Limits a tip motion from one point by the walls of all fixtures. All in one frame.
class Slide {
 public:
  /// approach [m/s^2]: deceleration before a wall; brake [m/s^2]: of a tip that comes too fast
  /// because the wall is new. v: velocity at p_Tip. held [s]: time for which an arm goes on that
  /// nobody stops; a wall counts from where it then comes to rest.
  Slide(const Fixtures& fixtures, const Vector3& p_Tip, const Vector3& v, double approach,
        double brake, double held = 0);

  /// The part of a step of the tip in dt [s] that the walls allow.
  Vector3 step(const Vector3& wished, double dt) const;
  /// The part of a velocity, reached dt [s] later at p_Tip + step.
  Vector3 velocity(const Vector3& wished, const Vector3& step, double dt) const;
  /// Removes from an acceleration what leads on into the walls that hold the velocity v there.
  Vector3 acceleration(const Vector3& wished, const Vector3& step, const Vector3& v) const;
  /// Target of a stream. One beyond a wall comes back onto it and moves along it.
  struct Target {
    Vector3 p, v;
  };
  Target target(const Target& wished) const;
  /// How far [m] a point is on the allowed side of all walls. A wall beyond which the tip is now
  /// counts as if the tip touched it.
  double clearance(const Vector3& p) const;

 private:
  double approach_speed(double distance) const;
  double fastest(const Wall& wall, double dt) const;
  Vector3 slowed_on_curves(const std::array<Wall, Fixtures::kMost>& walls, const Vector3& wished,
                           double dt) const;

  const Fixtures& fixtures_;
  Vector3 p_, v_;
  double approach_, brake_, held_;
  std::array<Wall, Fixtures::kMost> here_;
};

}  // namespace surg
