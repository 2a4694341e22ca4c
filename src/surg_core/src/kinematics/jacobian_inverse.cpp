#include "kinematics/jacobian_inverse.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kSingular = 1e-12;  // smallest pivot of J over its greatest

}  // namespace

// The loops over six rows are unrolled: a look ahead spends most of its time here, and loops as
// short as these take twice as long where the compiler leaves them as they are.

/// L and U in place, rows swapped for the greatest pivot.
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
#pragma GCC unroll 6
  for (int k = 0; k < 6; ++k) {
    int best = k;
    double most = std::abs(A_(k, k));
#pragma GCC unroll 6
    for (int i = k + 1; i < 6; ++i) {
      const double size = std::abs(A_(i, k));
      best = size > most ? i : best;
      most = size > most ? size : most;
    }
    swap_[k] = best;
    if (best != k) {
#pragma GCC unroll 6
      for (int c = 0; c < 6; ++c) std::swap(A_(k, c), A_(best, c));
    }
    if (!(most >= smallest)) smallest = most;  // a NaN as well
    greatest = std::max(greatest, most);
    const double inverse = 1.0 / A_(k, k);
#pragma GCC unroll 6
    for (int i = k + 1; i < 6; ++i) A_(i, k) *= inverse;
#pragma GCC unroll 6
    for (int c = k + 1; c < 6; ++c) {
      const double top = A_(k, c);
#pragma GCC unroll 6
      for (int i = k + 1; i < 6; ++i) A_(i, c) -= A_(i, k) * top;
    }
  }
  // J J^T has the squares.
  regular_ = n_ >= 6 && smallest > (n_ == 6 ? kSingular : kSingular * kSingular) * greatest;
}

JointVector Inverse::operator()(const Vector6& x, const JointVector& posture) const {
  return both(x, x, posture)[0];
}

std::array<JointVector, 2> Inverse::both(const Vector6& x, const Vector6& y,
                                         const JointVector& posture) const {
  if (!regular_) return {JointVector::Zero(n_), JointVector::Zero(n_)};
  Pair pair;
  pair.col(0) = x;
  pair.col(1) = y;
  if (n_ > 6) {
    for (Eigen::Index i = 0; i < n_; ++i) {
      const Vector6 moved = Vector6(J_.col(i)) * posture[i];
      pair.col(0) -= moved;
      pair.col(1) -= moved;
    }
  }
  substitute(pair);
  if (n_ == 6) return {JointVector(pair.col(0)), JointVector(pair.col(1))};
  const Vector6 first = pair.col(0), second = pair.col(1);
  std::array<JointVector, 2> dq{posture, posture};
  for (Eigen::Index i = 0; i < n_; ++i) {
    dq[0][i] += J_.col(i).dot(first);
    dq[1][i] += J_.col(i).dot(second);
  }
  return dq;
}

/// Forwards through L, back through U; the two columns side by side in one register.
void Inverse::substitute(Pair& x) const {
  for (int k = 0; k < 6; ++k) x.row(k).swap(x.row(swap_[k]));
#pragma GCC unroll 6
  for (int k = 0; k < 6; ++k) {
#pragma GCC unroll 6
    for (int i = k + 1; i < 6; ++i) x.row(i) -= A_(i, k) * x.row(k);
  }
#pragma GCC unroll 6
  for (int k = 5; k >= 0; --k) {
    x.row(k) /= A_(k, k);
#pragma GCC unroll 6
    for (int i = 0; i < k; ++i) x.row(i) -= A_(i, k) * x.row(k);
  }
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
