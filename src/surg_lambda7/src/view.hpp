// The device's axes M turned into the view V: x right, y down, z away from the viewer.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "handle.hpp"

namespace surg_teleop {

/// R_VM for an operator who sits in front of the device: right is its y, down -z, away -x.
extern const std::vector<double> kSeated;

/// R_VM from nine numbers, row by row. Nothing, and the reason, if they are no rotation.
std::optional<Eigen::Matrix3d> master_to_view(const std::vector<double>& rows, std::string* why);

struct HandlePose {
  Eigen::Vector3d p_VH;  // [m]
  Eigen::Matrix3d R_VH;  // third column: the axis about which the hand rolls
};

/// p_VH = R_VM p_MH, R_VH = R_VM R_MH R_VM^T. With the hand at rest both orientations are the
/// identity, so the third column is the handle's axis, away from the operator (-x of M).
HandlePose in_view(const Reading& reading, const Eigen::Matrix3d& R_VM);

}  // namespace surg_teleop
