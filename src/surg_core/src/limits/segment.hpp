// The point of a segment that is nearest to another point.
#pragma once

#include <algorithm>

#include "surg_core/types.hpp"

namespace surg {

/// Share in [0, 1] of the segment from 'from' along 'along' at which it is nearest to p; 0 for a
/// segment without length.
inline double nearest_share(const Vector3& from, const Vector3& along, const Vector3& p) {
  const double squared = along.squaredNorm();
  return squared > 0 ? std::clamp(along.dot(p - from) / squared, 0.0, 1.0) : 0.0;
}

}  // namespace surg
