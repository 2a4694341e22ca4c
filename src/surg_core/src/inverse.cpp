#include "inverse.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kSingular = 1e-12;  // smallest pivot of J over its greatest

}  // namespace

Inverse::Inverse(const Jacobian& J) : J_(J), n_(J.cols()) {
  if (n_ == 6) {
    A_ = J;
  } else {
    A_.setZero();
    for (Eigen::Index i = 0; i < n_; ++i) {
      const Vector6 column = J.col(i);
      A_.noalias() += column * column.transpose();
    }
  }
  double smallest = INFINITY, greatest = 0;
  for (int k = 0; k < 6; ++k) {
    int best = k;
    for (int i = k + 1; i < 6; ++i) {
      if (std::abs(A_(i, k)) > std::abs(A_(best, k))) best = i;
    }
    swap_[k] = best;
    if (best != k) {
      for (int c = 0; c < 6; ++c) std::swap(A_(k, c), A_(best, c));
    }
    const double pivot = std::abs(A_(k, k));
    smallest = std::min(smallest, pivot);
    greatest = std::max(greatest, pivot);
    const double inverse = 1.0 / A_(k, k);
    for (int i = k + 1; i < 6; ++i) A_(i, k) *= inverse;
    for (int c = k + 1; c < 6; ++c) {
      for (int i = k + 1; i < 6; ++i) A_(i, c) -= A_(i, k) * A_(k, c);
    }
  }
  // Written so that a NaN fails as well; J J^T has the squares.
  regular_ = n_ >= 6 && smallest > (n_ == 6 ? kSingular : kSingular * kSingular) * greatest;
}

JointVector Inverse::operator()(Vector6 x, const JointVector& posture) const {
  if (!regular_) return JointVector::Zero(n_);
  if (n_ > 6) {
    for (Eigen::Index i = 0; i < n_; ++i) x -= Vector6(J_.col(i)) * posture[i];
  }
  for (int k = 0; k < 6; ++k) {
    std::swap(x[k], x[swap_[k]]);
  }
  for (int k = 0; k < 6; ++k) {
    for (int i = k + 1; i < 6; ++i) x[i] -= A_(i, k) * x[k];
  }
  for (int k = 5; k >= 0; --k) {
    x[k] /= A_(k, k);
    for (int i = 0; i < k; ++i) x[i] -= A_(i, k) * x[k];
  }
  if (n_ == 6) return x;
  JointVector dq = posture;
  for (Eigen::Index i = 0; i < n_; ++i) dq[i] += J_.col(i).dot(x);
  return dq;
}

Vector6 displacement(const Pose& from, const Pose& to) {
  const Matrix3 R = to.linear() * from.linear().transpose();
  const Vector3 sine = 0.5 * Vector3(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  Vector6 twist;
  twist.head<3>() = to.translation() - from.translation();
  twist.tail<3>() = (1.0 + sine.squaredNorm() / 6.0) * sine;
  return twist;
}

}  // namespace surg
