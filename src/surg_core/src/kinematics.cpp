#include "surg_core/kinematics.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace surg {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Pivots this far apart mean that the solution would be rounding noise.
constexpr double kSingular = 1e-12;

bool is_rotation(const Matrix3& R) {
  return (R * R.transpose() - Matrix3::Identity()).cwiseAbs().maxCoeff() < 1e-6 &&
         R.determinant() > 0;
}

void check_pose(const Pose& X, const std::string& what) {
  if (!X.matrix().allFinite()) throw std::invalid_argument(what + ": the pose is not finite");
  if (!is_rotation(X.linear())) {
    throw std::invalid_argument(what + ": the pose's rotation part is not a rotation matrix");
  }
}

// Smallest over largest magnitude on a triangular factor's diagonal; 0 for anything not finite.
double pivot_ratio(const Vector6& pivots) {
  const double largest = pivots.cwiseAbs().maxCoeff();
  const double smallest = pivots.cwiseAbs().minCoeff();
  const double ratio = smallest / largest;
  return std::isfinite(largest) && ratio > kSingular ? ratio : 0.0;
}

}  // namespace

Chain::Chain(std::vector<Joint> joints, const Pose& X_LF)
    : joints_(std::move(joints)), X_LF_(X_LF) {
  if (joints_.empty() || joints_.size() > static_cast<std::size_t>(kMaxJoints)) {
    throw std::invalid_argument("a chain has 1 to " + std::to_string(kMaxJoints) + " joints, not " +
                                std::to_string(joints_.size()));
  }
  for (const Joint& joint : joints_) {
    check_pose(joint.X_PJ, "joint '" + joint.name + "'");
    // Written so that a NaN fails as well.
    if (!(std::abs(joint.axis.norm() - 1.0) < 1e-9)) {
      throw std::invalid_argument("joint '" + joint.name + "': the axis is not a unit vector");
    }
  }
  check_pose(X_LF_, "flange");
}

Pose Chain::forward(const JointVector& q) const {
  Pose X = Pose::Identity();
  for (int i = 0; i < dof(); ++i) {
    const Joint& joint = joints_[i];
    X = X * joint.X_PJ;
    X.linear() = X.linear() * Eigen::AngleAxisd(q[i], joint.axis).toRotationMatrix();
  }
  return X * X_LF_;
}

void Chain::forward(const JointVector& q, Pose& X_BF, Jacobian& J) const {
  const int n = dof();
  std::array<Vector3, kMaxJoints> origin, axis;  // of each joint, in B
  Pose X = Pose::Identity();
  for (int i = 0; i < n; ++i) {
    const Joint& joint = joints_[i];
    X = X * joint.X_PJ;
    origin[i] = X.translation();
    axis[i] = X.linear() * joint.axis;
    X.linear() = X.linear() * Eigen::AngleAxisd(q[i], joint.axis).toRotationMatrix();
  }
  X_BF = X * X_LF_;
  J.resize(6, n);
  for (int i = 0; i < n; ++i) {
    J.col(i).head<3>() = axis[i].cross(X_BF.translation() - origin[i]);
    J.col(i).tail<3>() = axis[i];
  }
}

InverseVelocity inverse_velocity(const Jacobian& J, const Vector6& twist,
                                 const JointVector& posture) {
  const Eigen::Index n = J.cols();
  InverseVelocity result;
  result.qd.setZero(n);
  if (n == 6) {
    const Matrix6 A = J;
    const Eigen::PartialPivLU<Matrix6> lu(A);
    result.conditioning = pivot_ratio(lu.matrixLU().diagonal());
    if (result.conditioning > 0) result.qd = lu.solve(twist);
  } else if (n > 6 && posture.size() == n) {
    // qd = J^T (J J^T)^-1 (twist - J posture) + posture, which is J^+ twist + (I - J^+ J) posture.
    // Column by column: products of fixed 6-vectors never take Eigen's heap-using paths.
    Matrix6 A = Matrix6::Zero();
    Vector6 rest = twist;
    for (Eigen::Index i = 0; i < n; ++i) {
      const Vector6 column = J.col(i);
      A.noalias() += column * column.transpose();
      rest -= column * posture[i];
    }
    const Eigen::LLT<Matrix6> llt(A);
    if (llt.info() == Eigen::Success) {
      // The factor scales like J itself, so the ratio compares with the one for six joints.
      result.conditioning = pivot_ratio(llt.matrixLLT().diagonal());
    }
    if (result.conditioning > 0) {
      const Vector6 multiplier = llt.solve(rest);
      for (Eigen::Index i = 0; i < n; ++i) {
        result.qd[i] = J.col(i).dot(multiplier) + posture[i];
      }
    }
  }
  if (!result.qd.allFinite()) {
    result.qd.setZero(n);
    result.conditioning = 0;
  }
  return result;
}

}  // namespace surg
