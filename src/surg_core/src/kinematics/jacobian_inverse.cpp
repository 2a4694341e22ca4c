#include "kinematics/jacobian_inverse.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Pivots this far apart mean that the solution would be rounding noise.
constexpr double kSingular = 1e-12;

/// A row that was not yet taken, with the largest entry of a column.
inline int largest_entry(const double* column, const std::array<bool, 6>& taken) {
  int best = -1;
  double largest = -1;
  for (int i = 0; i < 6; ++i) {
    const double magnitude = std::abs(column[i]);
    if (!taken[i] && !(magnitude <= largest)) {  // a NaN is taken, and seen by the caller
      best = i;
      largest = magnitude;
    }
  }
  return best;
}

template <int n>
struct Solution {
  Vectors6<n> X;
  Pivots pivots;
};

/// X of A X = B by Gauss-Jordan elimination with partial pivoting. Rows stay where they are and
/// every step works on whole columns, which a general factorisation does not; it takes three times
/// as long for six rows. Inlined: a call would take a tenth of it.
template <int n>
[[gnu::always_inline]] inline Solution<n> solve(const Jacobian& A, const Vectors6<n>& B) {
  static const Matrix6 kOthers = Matrix6::Ones() - Matrix6::Identity();
  Vectors6<6 + n> M;  // A and B side by side: one loop serves both
  M.template leftCols<6>() = A;
  M.template rightCols<n>() = B;
  Vector6 inverse;
  std::array<int, 6> row;  // of each pivot
  std::array<bool, 6> taken{};
  for (int k = 0; k < 6; ++k) {
    const int best = largest_entry(&M(0, k), taken);
    row[k] = best;
    taken[best] = true;
    inverse[k] = 1.0 / M(best, k);
    const Vector6 factor = M.col(k).cwiseProduct(kOthers.col(best)) * inverse[k];
    for (int c = k + 1; c < 6 + n; ++c) M.col(c) -= factor * M(best, c);
  }
  Solution<n> solution;
  for (int k = 0; k < 6; ++k) {
    for (int c = 0; c < n; ++c) solution.X(k, c) = M(row[k], 6 + c) * inverse[k];
    solution.pivots.value[k] = M(row[k], k);
  }
  solution.pivots.row = row;
  return solution;
}

/// X of J J^T X = B, by L D L^T: no square roots, and no products of dynamic size that might take a
/// heap-using path.
template <int n>
Solution<n> solve_gram(const Jacobian& J, const Vectors6<n>& B) {
  Solution<n> solution;
  solution.pivots.squares = true;
  std::array<Vector6, 6> A;
  for (int k = 0; k < 6; ++k) {
    A[k] = J.col(0) * J(k, 0);
    for (Eigen::Index i = 1; i < J.cols(); ++i) A[k] += J.col(i) * J(k, i);
  }
  Vectors6<n>& X = solution.X;
  X = B;
  Vector6 inverse;
  for (int k = 0; k < 6; ++k) {
    solution.pivots.value[k] = A[k][k];
    inverse[k] = 1.0 / A[k][k];
    const Vector6 factor = A[k] * inverse[k];
    for (int c = k + 1; c < 6; ++c) A[c] -= factor * A[k][c];
    for (int i = k + 1; i < 6; ++i) X.row(i) -= factor[i] * X.row(k);
    A[k] = factor;
  }
  for (int k = 5; k >= 0; --k) {
    X.row(k) *= inverse[k];
    for (int i = k + 1; i < 6; ++i) X.row(k) -= A[k][i] * X.row(i);
  }
  return solution;
}

}  // namespace

double Pivots::ratio() const {
  const double smallest = value.cwiseAbs().minCoeff(), largest = value.cwiseAbs().maxCoeff();
  double ratio = smallest / largest;
  if (squares) ratio = value.minCoeff() > 0 ? std::sqrt(ratio) : 0.0;
  return std::isfinite(largest) && ratio > kSingular ? ratio : 0.0;
}

double Pivots::signed_ratio() const {
  double sign = 1;
  for (int k = 0; k < 6 && !squares; ++k) {
    if (value[k] < 0) sign = -sign;
    for (int i = 0; i < k; ++i) {
      if (row[i] > row[k]) sign = -sign;
    }
  }
  return sign * ratio();
}

InverseVelocity inverse_velocity(const Jacobian& J, const Vector6& twist,
                                 const JointVector& posture) {
  const Eigen::Index n = J.cols();
  InverseVelocity result;
  if (n == 6) {
    const Solution<1> solution = solve<1>(J, twist);
    if (solution.X.allFinite()) result.conditioning = solution.pivots.ratio();
    if (result.conditioning > 0) result.qd = solution.X;
  } else if (n > 6 && posture.size() == n) {
    // qd = J^T (J J^T)^-1 (twist - J posture) + posture, which is J^+ twist + (I - J^+ J) posture.
    Vector6 rest = twist;
    for (Eigen::Index i = 0; i < n; ++i) rest -= J.col(i) * posture[i];
    const Solution<1> multiplier = solve_gram<1>(J, rest);
    if (multiplier.X.allFinite()) result.conditioning = multiplier.pivots.ratio();
    if (result.conditioning > 0) {
      result.qd = posture;
      for (Eigen::Index i = 0; i < n; ++i) result.qd[i] += J.col(i).dot(multiplier.X);
      if (!result.qd.allFinite()) result.conditioning = 0;
    }
  }
  if (!(result.conditioning > 0)) result.qd.setZero(n);
  return result;
}

template <int n>
Steps<n> least_steps(const Jacobian& J, const Vectors6<n>& twists) {
  const Solution<n> solution = J.cols() == 6 ? solve<n>(J, twists) : solve_gram<n>(J, twists);
  Steps<n> steps;
  steps.pivots = solution.pivots;
  for (int c = 0; c < n; ++c) {
    Joints& dq = steps.dq[c];
    const Vector6 x = solution.X.col(c);
    dq.setZero();
    if (J.cols() == 6) {
      dq.head<6>() = x;
    } else {
      for (Eigen::Index i = 0; i < J.cols(); ++i) dq[i] = J.col(i).dot(x);
    }
  }
  return steps;
}
template Steps<1> least_steps<1>(const Jacobian&, const Vectors6<1>&);
template Steps<2> least_steps<2>(const Jacobian&, const Vectors6<2>&);

/// Gauss-Jordan elimination in place: each pivot exchanges a joint's velocity and a component of
/// the twist. Rows stay where they are and every step works on whole columns.
Inverse::Inverse(const Jacobian& J) : J_(J), n_(J.cols()) {
  static const Matrix6 kUnit = Matrix6::Identity(), kOthers = Matrix6::Ones() - kUnit;
  Matrix6 A;
  if (n_ == 6) {
    A = J;
  } else {
    const Vector6 first = J.col(0);
    for (int c = 0; c < 6; ++c) A.col(c) = first * first[c];
    for (Eigen::Index i = 1; i < n_; ++i) {
      const Vector6 column = J.col(i);
#pragma GCC unroll 6
      for (int c = 0; c < 6; ++c) A.col(c) += column * column[c];
    }
  }
  std::array<int, 6> row;  // of each pivot
  std::array<bool, 6> taken{};
  for (int k = 0; k < 6; ++k) {
    const int best = n_ == 6 ? largest_entry(&A(0, k), taken) : k;  // J J^T needs no pivoting
    taken[best] = true;
    row[k] = best;
    pivots_.value[k] = A(best, k);
    const double inverse = 1.0 / A(best, k);
    // The pivot's row is divided by it, as a multiple of itself added like those of the others.
    const Vector6 unit = kUnit.col(best);
    const Vector6 factor =
        unit * (inverse - 1) - A.col(k).cwiseProduct(kOthers.col(best)) * inverse;
    A.col(k) = unit;
#pragma GCC unroll 6
    for (int c = 0; c < 6; ++c) A.col(c) += factor * A(best, c);
  }
  pivots_.row = row;
  pivots_.squares = n_ > 6;
  regular_ = n_ >= 6 && pivots_.ratio() > 0;
  for (int k = 0; k < 6; ++k) {
    for (int i = 0; i < 6; ++i) A_(i, row[k]) = A(row[i], k);
  }
}

Joints Inverse::operator()(const Vector6& x) const {
  Joints dq = Joints::Zero();
  if (!regular_) return dq;
  Vector6 y = A_.col(0) * x[0];
#pragma GCC unroll 6
  for (int k = 1; k < 6; ++k) y += A_.col(k) * x[k];
  if (n_ == 6) {
    dq.head<6>() = y;
  } else {
    for (Eigen::Index i = 0; i < n_; ++i) dq[i] = J_.col(i).dot(y);
  }
  return dq;
}

Joints Inverse::operator()(const Vector6& x, const Joints& posture) const {
  if (n_ <= 6 || !regular_) return (*this)(x);
  return posture + (*this)(x - flange_twist(J_, posture));
}

}  // namespace surg
