#include "surg_core/kinematics.hpp"

#include <Eigen/Cholesky>
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

/// Gaussian elimination of A x = b with partial pivoting, in place: leaves the upper triangle and
/// the matching right-hand side, returns the pivots. Written out because a general library's
/// factorisation takes three times as long for six rows.
Vector6 eliminate(Matrix6& A, Vector6& b) {
  Vector6 pivots;
  for (int k = 0; k < 6; ++k) {
    int best = k;
    for (int i = k + 1; i < 6; ++i) {
      if (std::abs(A(i, k)) > std::abs(A(best, k))) best = i;
    }
    if (best != k) {
      for (int c = k; c < 6; ++c) std::swap(A(k, c), A(best, c));
      std::swap(b[k], b[best]);
    }
    pivots[k] = A(k, k);
    const double inverse = 1.0 / A(k, k);
    double factor[6];
    for (int i = k + 1; i < 6; ++i) factor[i] = A(i, k) * inverse;
    for (int c = k + 1; c < 6; ++c) {
      for (int i = k + 1; i < 6; ++i) A(i, c) -= factor[i] * A(k, c);
    }
    for (int i = k + 1; i < 6; ++i) b[i] -= factor[i] * b[k];
  }
  return pivots;
}

Vector6 back_substitute(const Matrix6& A, Vector6 b) {
  for (int k = 5; k >= 0; --k) {
    b[k] /= A(k, k);
    for (int i = 0; i < k; ++i) b[i] -= A(i, k) * b[k];
  }
  return b;
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
  Pose Z_previous = Pose::Identity();  // turns z of the joint's frame onto its axis
  for (int i = 0; i < dof(); ++i) {
    const Joint& joint = joints_[i];
    Pose Z = Pose::Identity();
    Z.linear().col(0) = joint.axis.unitOrthogonal();
    Z.linear().col(1) = joint.axis.cross(Vector3(Z.linear().col(0)));
    Z.linear().col(2) = joint.axis;
    links_[i] = Z_previous.inverse() * joint.X_PJ * Z;
    Z_previous = Z;
  }
  end_ = Z_previous.inverse() * X_LF_;
}

/// Origin and z of every joint, and the flange, in B.
struct Chain::Frames {
  std::array<Vector3, kMaxJoints> origin, axis;
  Vector3 x, y, z, p;  ///< flange: axes, origin

  void move(const Pose& X) {
    const Matrix3& R = X.linear();
    const Vector3 t = X.translation();
    p += x * t[0] + y * t[1] + z * t[2];
    const Vector3 x_new = x * R(0, 0) + y * R(1, 0) + z * R(2, 0);
    const Vector3 y_new = x * R(0, 1) + y * R(1, 1) + z * R(2, 1);
    z = x * R(0, 2) + y * R(1, 2) + z * R(2, 2);
    x = x_new;
    y = y_new;
  }
  void turn(double angle) {
    const double c = std::cos(angle), s = std::sin(angle);
    const Vector3 x_new = x * c + y * s;
    y = y * c - x * s;
    x = x_new;
  }
  Pose flange() const {
    Pose X = Pose::Identity();
    X.linear().col(0) = x;
    X.linear().col(1) = y;
    X.linear().col(2) = z;
    X.translation() = p;
    return X;
  }
};

void Chain::walk(const JointVector& q, Frames& frames) const {
  frames.x = Vector3::UnitX();
  frames.y = Vector3::UnitY();
  frames.z = Vector3::UnitZ();
  frames.p = Vector3::Zero();
  const int n = dof();
  for (int i = 0; i < n; ++i) {
    frames.move(links_[i]);
    frames.origin[i] = frames.p;
    frames.axis[i] = frames.z;
    frames.turn(q[i]);
  }
  frames.move(end_);
}

Pose Chain::forward(const JointVector& q) const {
  Frames frames;
  walk(q, frames);
  return frames.flange();
}

void Chain::forward(const JointVector& q, Pose& X_BF, Jacobian& J) const {
  Frames frames;
  walk(q, frames);
  X_BF = frames.flange();
  const int n = dof();
  J.resize(6, n);
  for (int i = 0; i < n; ++i) {
    J.col(i).head<3>() = frames.axis[i].cross(frames.p - frames.origin[i]);
    J.col(i).tail<3>() = frames.axis[i];
  }
}

InverseVelocity inverse_velocity(const Jacobian& J, const Vector6& twist,
                                 const JointVector& posture) {
  const Eigen::Index n = J.cols();
  InverseVelocity result;
  result.qd.setZero(n);
  if (n == 6) {
    Matrix6 A = J;
    Vector6 x = twist;
    result.conditioning = pivot_ratio(eliminate(A, x));
    if (result.conditioning > 0) result.qd = back_substitute(A, x);
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
