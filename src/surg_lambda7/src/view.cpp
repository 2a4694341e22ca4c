#include "view.hpp"

#include <Eigen/LU>

namespace surg_teleop {

const std::vector<double> kSeated = {0, 1, 0, 0, 0, -1, -1, 0, 0};

std::optional<Eigen::Matrix3d> master_to_view(const std::vector<double>& rows, std::string* why) {
  constexpr double kTolerance = 1e-6;
  if (rows.size() != 9) {
    *why = std::to_string(rows.size()) + " numbers; allowed: 9, a rotation row by row";
    return std::nullopt;
  }
  const Eigen::Matrix3d R_VM =
      Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rows.data());
  const Eigen::Matrix3d defect = R_VM * R_VM.transpose() - Eigen::Matrix3d::Identity();
  if (!(defect.cwiseAbs().maxCoeff() <= kTolerance)) {
    *why = "no rotation (its rows are not of length 1 and at right angles); allowed: a rotation";
    return std::nullopt;
  }
  if (!(R_VM.determinant() > 0.0)) {
    *why = "a mirror (determinant -1); allowed: a rotation. One axis has the wrong sign";
    return std::nullopt;
  }
  return R_VM;
}

HandlePose in_view(const Reading& reading, const Eigen::Matrix3d& R_VM) {
  return {R_VM * reading.p_MH, R_VM * reading.R_MH * R_VM.transpose()};
}

}  // namespace surg_teleop
