#include "kinematics/jacobian_inverse.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

constexpr double kSingular = 1e-12;  // smallest pivot of J over its greatest

}  // namespace

/// Gauss-Jordan elimination in place: each pivot exchanges a joint's velocity and a component of
/// the twist. Rows stay where they are and every step works on whole columns.
Inverse::Inverse(const Jacobian& J) : J_(J), n_(J.cols()) {
  static const Matrix6 kUnit = Matrix6::Identity(), kOthers = Matrix6::Ones() - kUnit;
  if (n_ == 6) {
    A_ = J;
  } else {
    const Vector6 first = J.col(0);
    for (int c = 0; c < 6; ++c) A_.col(c) = first * first[c];
    for (Eigen::Index i = 1; i < n_; ++i) {
      const Vector6 column = J.col(i);
#pragma GCC unroll 6
      for (int c = 0; c < 6; ++c) A_.col(c) += column * column[c];
    }
  }
  double smallest = INFINITY, greatest = 0;
  std::array<bool, 6> taken{};
  for (int k = 0; k < 6; ++k) {
    int best = k;
    double most = std::abs(A_(k, k));
    if (n_ == 6) {  // J J^T needs no pivoting
      most = -1;
      for (int i = 0; i < 6; ++i) {
        const double size = std::abs(A_(i, k));
        if (!taken[i] && !(size <= most)) {  // a NaN is taken
          best = i;
          most = size;
        }
      }
    }
    row_[k] = best;
    taken[best] = true;
    if (!(most >= smallest)) smallest = most;  // a NaN as well
    greatest = std::max(greatest, most);
    const double inverse = 1.0 / A_(best, k);
    // The pivot's row is divided by it, as a multiple of itself added like those of the others.
    const Vector6 unit = kUnit.col(best);
    const Vector6 factor =
        unit * (inverse - 1) - A_.col(k).cwiseProduct(kOthers.col(best)) * inverse;
    A_.col(k) = unit;
#pragma GCC unroll 6
    for (int c = 0; c < 6; ++c) A_.col(c) += factor * A_(best, c);
  }
  // J J^T has the squares.
  regular_ = n_ >= 6 && smallest > (n_ == 6 ? kSingular : kSingular * kSingular) * greatest;
}

JointVector Inverse::operator()(const Vector6& x, const JointVector& posture) const {
  if (!regular_) return JointVector::Zero(n_);
  Vector6 rest = x;
  if (n_ > 6) {
    for (Eigen::Index i = 0; i < n_; ++i) rest -= J_.col(i) * posture[i];
  }
  Vector6 y = A_.col(0) * rest[row_[0]];
  for (int k = 1; k < 6; ++k) y += A_.col(k) * rest[row_[k]];
  Vector6 solution;
  for (int k = 0; k < 6; ++k) solution[k] = y[row_[k]];
  if (n_ == 6) return solution;
  JointVector dq = posture;
  for (Eigen::Index i = 0; i < n_; ++i) dq[i] += J_.col(i).dot(solution);
  return dq;
}

Vector6 displacement(const Pose& from, const Pose& to) {
  Vector3 sine = Vector3::Zero();  // twice: the vector of R - R^T, R = to from^T
  for (int i = 0; i < 3; ++i) {
    sine += Vector3(from.linear().col(i)).cross(Vector3(to.linear().col(i)));
  }
  sine *= 0.5;
  Vector6 twist;
  twist.head<3>() = to.translation() - from.translation();
  twist.tail<3>() = (1.0 + sine.squaredNorm() / 6.0) * sine;
  return twist;
}

}  // namespace surg
