#include "surg_core/kinematics/kinematics.hpp"

#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "kinematics/sines.hpp"

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

/// x of A x = b with the pivots that were met, by Gauss-Jordan elimination with partial pivoting.
/// Rows stay where they are and every step works on whole columns, which a general factorisation
/// does not; it takes three times as long for six rows.
struct Solution6 {
  Vector6 x, pivots;
};
Solution6 solve(const Jacobian& A, const Vector6& b) {
  static const Matrix6 kOthers = Matrix6::Ones() - Matrix6::Identity();
  Eigen::Matrix<double, 6, 7> M;  // A and b side by side: one loop serves both
  M.leftCols<6>() = A;
  M.col(6) = b;
  Vector6 inverse;
  std::array<int, 6> row;  // of each pivot
  std::array<bool, 6> taken{};
  for (int k = 0; k < 6; ++k) {
    int best = -1;
    double largest = -1;
    for (int i = 0; i < 6; ++i) {
      const double magnitude = std::abs(M(i, k));
      if (!taken[i] && !(magnitude <= largest)) {  // a NaN is taken, and seen by the caller
        best = i;
        largest = magnitude;
      }
    }
    row[k] = best;
    taken[best] = true;
    inverse[k] = 1.0 / M(best, k);
    const Vector6 factor = M.col(k).cwiseProduct(kOthers.col(best)) * inverse[k];
    for (int c = k + 1; c < 7; ++c) M.col(c) -= factor * M(best, c);
  }
  Solution6 solution;
  for (int k = 0; k < 6; ++k) {
    solution.x[k] = M(row[k], 6) * inverse[k];
    solution.pivots[k] = M(row[k], k);
  }
  return solution;
}

/// x of J J^T x = b with the pivots, by L D L^T: no square roots, and no products of dynamic size
/// that might take a heap-using path.
Solution6 solve_gram(const Jacobian& J, const Vector6& b) {
  std::array<Vector6, 6> A;
  for (int k = 0; k < 6; ++k) {
    A[k] = J.col(0) * J(k, 0);
    for (Eigen::Index i = 1; i < J.cols(); ++i) A[k] += J.col(i) * J(k, i);
  }
  Solution6 solution;
  Vector6& x = solution.x;
  x = b;
  Vector6 inverse;
  for (int k = 0; k < 6; ++k) {
    solution.pivots[k] = A[k][k];
    inverse[k] = 1.0 / A[k][k];
    const Vector6 factor = A[k] * inverse[k];
    for (int c = k + 1; c < 6; ++c) A[c] -= factor * A[k][c];
    for (int i = k + 1; i < 6; ++i) x[i] -= factor[i] * x[k];
    A[k] = factor;
  }
  x = x.cwiseProduct(inverse);
  for (int k = 4; k >= 0; --k) {
    for (int i = k + 1; i < 6; ++i) x[k] -= A[k][i] * x[i];
  }
  return solution;
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
  Matrix3 Z;  // of the present joint: from the loop's frame to the joint's own, z onto the axis
  Z.col(0) = joints_[0].axis.unitOrthogonal();
  Z.col(1) = joints_[0].axis.cross(Vector3(Z.col(0)));
  Z.col(2) = joints_[0].axis;
  start_ = joints_[0].X_PJ * Pose(Z);
  for (int i = 0; i + 1 < dof(); ++i) {
    const Pose X = Pose(Z.transpose()) * joints_[i + 1].X_PJ;
    const Vector3 axis = X.linear() * joints_[i + 1].axis;
    const double sine = std::hypot(axis.x(), axis.y());
    Link& link = links_[i];
    // Any turn will do for parallel axes.
    link.turn = sine > 0 ? std::atan2(axis.x(), -axis.y()) : 0.0;
    const double norm = std::hypot(sine, axis.z());
    link.cos_tilt = axis.z() / norm;
    link.sin_tilt = sine / norm;
    const Matrix3 turn = Eigen::AngleAxisd(link.turn, Vector3::UnitZ()).toRotationMatrix();
    Matrix3 tilt;
    tilt << 1, 0, 0, 0, link.cos_tilt, -link.sin_tilt, 0, link.sin_tilt, link.cos_tilt;
    link.shift = turn.transpose() * X.translation();
    Z = X.linear().transpose() * turn * tilt;
  }
  end_ = Pose(Z.transpose()) * X_LF_;
}

/// Origin and z of every joint, and the flange, in B. Homogeneous, as four numbers fill two
/// registers where three take three.
struct Chain::Frames {
  std::array<Vector4, kMaxJoints> origin, axis;
  Vector4 x, y, z, p;  ///< of the present frame, at last the flange: axes, origin

  explicit Frames(const Pose& start)
      : x(start.matrix().col(0)),
        y(start.matrix().col(1)),
        z(start.matrix().col(2)),
        p(start.matrix().col(3)) {}
  void turn(double c, double s) {
    const Vector4 x_new = x * c + y * s;
    y = y * c - x * s;
    x = x_new;
  }
  void shift(const Vector3& t) { p += x * t[0] + y * t[1] + z * t[2]; }
  void tilt(double c, double s) {
    const Vector4 y_new = y * c + z * s;
    z = z * c - y * s;
    y = y_new;
  }
  Pose move(const Pose& X) const {
    const Eigen::Matrix4d& A = X.matrix();
    Pose moved;
    for (int i = 0; i < 3; ++i) moved.matrix().col(i) = x * A(0, i) + y * A(1, i) + z * A(2, i);
    moved.matrix().col(3) = p + x * A(0, 3) + y * A(1, 3) + z * A(2, 3);
    return moved;
  }
};

Pose Chain::walk(const JointVector& q, Frames& frames) const {
  const int n = dof();
  Angles<kMaxJoints> angle = Angles<kMaxJoints>::Zero(), s, c;
  for (int i = 0; i < n; ++i) angle[i] = q[i] + links_[i].turn;
  if (n <= 6) {
    Angles<6> s6, c6;
    sines<6>(angle.head<6>(), s6, c6);
    s.head<6>() = s6;
    c.head<6>() = c6;
  } else {
    sines(angle, s, c);
  }
  for (int i = 0; i < n; ++i) {
    frames.origin[i] = frames.p;
    frames.axis[i] = frames.z;
    frames.turn(c[i], s[i]);
    if (i + 1 == n) break;
    frames.shift(links_[i].shift);
    frames.tilt(links_[i].cos_tilt, links_[i].sin_tilt);
  }
  return frames.move(end_);
}

Pose Chain::forward(const JointVector& q) const {
  if (joints_.empty()) return X_LF_;
  Frames frames(start_);
  return walk(q, frames);
}

void Chain::forward(const JointVector& q, Pose& X_BF, Jacobian& J) const {
  Frames frames(start_);
  X_BF = walk(q, frames);
  const Vector4 p = X_BF.matrix().col(3);
  const int n = dof();
  J.resize(6, n);
  for (int i = 0; i < n; ++i) {
    const Vector4& z = frames.axis[i];
    const Vector4 r = p - frames.origin[i];
    double* column = J.data() + 6 * i;
    column[0] = z[1] * r[2] - z[2] * r[1];
    column[1] = z[2] * r[0] - z[0] * r[2];
    column[2] = z[0] * r[1] - z[1] * r[0];
    column[3] = z[0];
    column[4] = z[1];
    column[5] = z[2];
  }
}

Vector6 bias_acceleration(const Jacobian& J, const JointVector& qd) {
  Vector3 linear = Vector3::Zero(), angular = Vector3::Zero();
  Vector3 omega = Vector3::Zero();  // of the link before the joint
  for (Eigen::Index i = 0; i < J.cols(); ++i) {
    const Vector3 v = qd[i] * J.col(i).head<3>(), turn = qd[i] * J.col(i).tail<3>();
    linear += Vector3(2 * omega + turn).cross(v);
    angular += omega.cross(turn);
    omega += turn;
  }
  Vector6 acceleration;
  acceleration << linear, angular;
  return acceleration;
}

InverseVelocity inverse_velocity(const Jacobian& J, const Vector6& twist,
                                 const JointVector& posture) {
  const Eigen::Index n = J.cols();
  InverseVelocity result;
  if (n == 6) {
    const Solution6 solution = solve(J, twist);
    if (solution.x.allFinite()) result.conditioning = pivot_ratio(solution.pivots);
    if (result.conditioning > 0) result.qd = solution.x;
  } else if (n > 6 && posture.size() == n) {
    // qd = J^T (J J^T)^-1 (twist - J posture) + posture, which is J^+ twist + (I - J^+ J) posture.
    Vector6 rest = twist;
    for (Eigen::Index i = 0; i < n; ++i) rest -= J.col(i) * posture[i];
    const Solution6 multiplier = solve_gram(J, rest);
    // The root scales like J itself, so the ratio compares with the one for six joints.
    if (multiplier.x.allFinite()) {
      result.conditioning = pivot_ratio(multiplier.pivots.cwiseMax(0.0).cwiseSqrt());
    }
    if (result.conditioning > 0) {
      result.qd = posture;
      for (Eigen::Index i = 0; i < n; ++i) result.qd[i] += J.col(i).dot(multiplier.x);
      if (!result.qd.allFinite()) result.conditioning = 0;
    }
  }
  if (!(result.conditioning > 0)) result.qd.setZero(n);
  return result;
}

}  // namespace surg
