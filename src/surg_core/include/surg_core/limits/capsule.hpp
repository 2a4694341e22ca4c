// Capsules and half-spaces: the shapes between which the clearance guard keeps a distance. A
// capsule is every point within 'radius' of a segment.
#pragma once

#include <algorithm>
#include <array>

#include "surg_core/types.hpp"

namespace surg {

/// All points within 'radius' [m] of the segment from a to b [m].
struct Capsule {
  Vector3 a = Vector3::Zero(), b = Vector3::Zero();
  double radius = 0;
};

/// All points x with normal . (x - point) <= 0; 'normal' is a unit vector that points out of it.
struct HalfSpace {
  Vector3 point = Vector3::Zero(), normal = Vector3::UnitZ();
};

/// Two points, one on each body, and how far the surfaces are apart there.
struct Gap {
  Vector3 p = Vector3::Zero();        ///< on the axis of the first body
  Vector3 p_other = Vector3::Zero();  ///< on the axis, or the surface, of the second
  Vector3 away = Vector3::UnitZ();    ///< unit vector from the second to the first
  double distance = 0;                ///< [m] between the surfaces; negative: they overlap
};

/// Share in [0, 1] of the segment from 'from' along 'along' at which it is nearest to p; 0 for a
/// segment without length.
inline double nearest_share(const Vector3& from, const Vector3& along, const Vector3& p) {
  const double squared = along.squaredNorm();
  return squared > 0 ? std::clamp(along.dot(p - from) / squared, 0.0, 1.0) : 0.0;
}

/// The places where two capsules can be closest: between the insides of the segments first, then at
/// each of the four ends. The smallest of them is the distance. A guard must watch all of them:
/// where two segments are nearly parallel, the closest points jump from one end to the other.
std::array<Gap, 5> gaps(const Capsule& first, const Capsule& second);

/// The two ends of a capsule above a half-space.
std::array<Gap, 2> gaps(const Capsule& capsule, const HalfSpace& space);

/// Distance between the surfaces [m]; negative where they overlap.
double distance(const Capsule& first, const Capsule& second);
double distance(const Capsule& capsule, const HalfSpace& space);

/// A lower bound of the distance, from the balls round both.
double distance_at_least(const Capsule& first, const Capsule& second);

}  // namespace surg
