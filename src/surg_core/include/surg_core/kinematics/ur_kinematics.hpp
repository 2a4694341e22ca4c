// A UR arm's own kinematics in place of the drawing's: factory calibration moves its axes by
// millimetres.
#pragma once

#include <string>

#include "surg_core/kinematics/kinematics.hpp"

namespace surg {

/// Standard Denavit-Hartenberg parameters of one arm, as its controller states them: joint i turns
/// about z of frame i - 1 by q + theta. Nearly parallel axes make single values large, up to
/// hundreds of metres; the axes themselves are close to the drawing's.
struct UrKinematics {
  std::string file, model, serial, date;
  JointVector theta, d, a, alpha;  ///< [rad, m], one value per joint
};

/// The chain with the arm's own axes and flange. Each joint frame stays as near as possible to the
/// drawing's, since the capsules of the clearance guard are stated in them. Throws
/// std::invalid_argument where an axis or the flange is farther from the drawing's than any arm of
/// this model: 20 mm or 2 degrees.
Chain with_kinematics(const Chain& drawn, const UrKinematics& own);

}  // namespace surg
