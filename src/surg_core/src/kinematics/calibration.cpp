#include "surg_core/kinematics/calibration.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace surg {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

std::string millimetres(double metres) { return number(1e3 * metres) + " mm"; }
std::string degrees(double rad) { return number(rad * 180.0 / M_PI) + " deg"; }

void check_count(const char* what, std::size_t n, const char* unit,
                 const CalibrationLimits& limits) {
  if (static_cast<int>(n) < limits.n_min) {
    throw CalibrationError(std::string(what) + ": " + std::to_string(n) + " " + unit +
                           "; at least " + std::to_string(limits.n_min) + " are needed");
  }
}

void check_poses(const char* what, const std::vector<Pose>& X_BF) {
  for (std::size_t i = 0; i < X_BF.size(); ++i) {
    if (!is_rotation(X_BF[i].linear()) || !X_BF[i].translation().allFinite()) {
      throw CalibrationError(std::string(what) + ": pose " + std::to_string(i + 1) +
                             " is not a pose; every number must be finite and its rotation proper");
    }
  }
}

void check_condition(const char* what, double condition, const char* cure,
                     const CalibrationLimits& limits) {
  if (!(condition <= limits.condition_max)) {
    const std::string found = condition < 1e9 ? number(condition) : "without bound";
    throw CalibrationError(std::string(what) + ": condition number " + found + "; at most " +
                           number(limits.condition_max) + " is allowed: " + cure);
  }
}

/// rms and worst of distances, refused where they are too large; names the worst one.
void judge(const char* what, const std::vector<double>& distances, double rms_max, double worst_max,
           std::string (*in_words)(double), const char* cure, Fit& fit) {
  double sum = 0;
  std::size_t worst = 0;
  for (std::size_t i = 0; i < distances.size(); ++i) {
    sum += distances[i] * distances[i];
    if (distances[i] > distances[worst]) worst = i;
  }
  fit.rms = std::sqrt(sum / static_cast<double>(distances.size()));
  fit.worst = distances[worst];
  if (!(fit.rms <= rms_max && fit.worst <= worst_max)) {
    throw CalibrationError(std::string(what) + ": residual rms " + in_words(fit.rms) +
                           ", largest " + in_words(fit.worst) + " (number " +
                           std::to_string(worst + 1) + " of " + std::to_string(distances.size()) +
                           "); at most " + in_words(rms_max) + " and " + in_words(worst_max) +
                           " are allowed: " + cure);
  }
}

/// Normal equations of [R_i  -I] (x; c) = ..., the unknowns of which are a vector x in F and where
/// it goes in B, c. Both halves are without a unit, so that the condition number means something.
Matrix6 rotation_normals(const std::vector<Pose>& X_BF) {
  Matrix3 sum = Matrix3::Zero();
  for (const Pose& X : X_BF) sum += X.linear();
  const double n = static_cast<double>(X_BF.size());
  Matrix6 N;
  N << n * Matrix3::Identity(), -sum.transpose(), -sum, n * Matrix3::Identity();
  return N;
}

/// From eigenvalues; infinite where the smaller one is zero but for rounding.
double condition_of(double smallest, double largest) {
  const double rounding = 1e-14 * largest;
  return smallest > rounding ? std::sqrt(largest / smallest)
                             : std::numeric_limits<double>::infinity();
}

double spread(double squares, int freedom) { return freedom > 0 ? squares / freedom : 0.0; }

}  // namespace

TipFit calibrate_tip(const std::vector<Pose>& X_BF, const CalibrationLimits& limits) {
  const char* what = "tip by pivoting";
  check_count(what, X_BF.size(), "poses", limits);
  check_poses(what, X_BF);
  const int n = static_cast<int>(X_BF.size());
  Vector3 middle = Vector3::Zero();  // of the flange: c from there is a short vector
  for (const Pose& X : X_BF) middle += X.translation() / n;

  const Matrix6 N = rotation_normals(X_BF);
  Vector6 b = Vector6::Zero();
  for (const Pose& X : X_BF) {
    const Vector3 p = X.translation() - middle;
    b.head<3>() -= X.linear().transpose() * p;
    b.tail<3>() += p;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix6> eigen(N);
  TipFit tip;
  tip.fit.n = n;
  tip.fit.condition = condition_of(eigen.eigenvalues()[0], eigen.eigenvalues()[5]);
  check_condition(what, tip.fit.condition,
                  "tilt the instrument further, about two axes, and roll it between the poses",
                  limits);
  const Matrix6 inverse = eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
                          eigen.eigenvectors().transpose();
  const Vector6 x = inverse * b;
  tip.p_FTip = x.head<3>();
  tip.p_BDivot = middle + x.tail<3>();

  std::vector<double> distances;
  double squares = 0;
  for (const Pose& X : X_BF) {
    distances.push_back((X * tip.p_FTip - tip.p_BDivot).norm());
    squares += distances.back() * distances.back();
  }
  judge(what, distances, limits.rms_max, limits.worst_max, millimetres,
        "the tip has left its divot, or the robot was still moving; record anew", tip.fit);
  tip.covariance = spread(squares, 3 * n - 6) * inverse.topLeftCorner<3, 3>();
  return tip;
}

AxisFit calibrate_axis_by_rolling(const std::vector<Pose>& X_BF, const Vector3& p_FTip,
                                  const CalibrationLimits& limits) {
  const char* what = "shaft axis by rolling";
  check_count(what, X_BF.size(), "poses", limits);
  check_poses(what, X_BF);
  const int n = static_cast<int>(X_BF.size());
  // The unit vector (s; a) that the equations change least: |s| = |a|, as R_i s = a.
  const Eigen::SelfAdjointEigenSolver<Matrix6> eigen(rotation_normals(X_BF));
  AxisFit axis;
  axis.fit.n = n;
  // The next one says how well the axis is told apart from a vector that turns.
  axis.fit.condition = condition_of(eigen.eigenvalues()[1], eigen.eigenvalues()[5]);
  check_condition(what, axis.fit.condition, "roll the instrument further about its shaft", limits);
  axis.s_F = eigen.eigenvectors().col(0).head<3>().normalized();
  const double outwards = axis.s_F.dot(p_FTip);
  if (!(std::abs(outwards) > 0.5 * p_FTip.norm())) {
    throw CalibrationError(std::string(what) + ": the axis is " +
                           degrees(std::acos(std::min(1.0, std::abs(outwards) / p_FTip.norm()))) +
                           " from the direction of the tip; at most 60 deg is plausible: turn the "
                           "instrument about its shaft, not the flange about its own axis");
  }
  if (outwards < 0) axis.s_F = -axis.s_F;

  Vector3 a = Vector3::Zero();
  for (const Pose& X : X_BF) a += X.linear() * axis.s_F / n;
  std::vector<double> angles;
  double squares = 0;
  Matrix3 M = Matrix3::Zero();  // with a eliminated
  Matrix3 mean = Matrix3::Zero();
  for (const Pose& X : X_BF) mean += X.linear() / n;
  for (const Pose& X : X_BF) {
    angles.push_back((X.linear() * axis.s_F - a).norm());
    squares += angles.back() * angles.back();
    M += (X.linear() - mean).transpose() * (X.linear() - mean);
  }
  judge(what, angles, limits.axis_rms_max, limits.axis_worst_max, degrees,
        "the shaft has tilted in its guide; use a longer or tighter guide and record anew",
        axis.fit);
  const Vector3 u = axis.s_F.unitOrthogonal(), v = axis.s_F.cross(u);
  Eigen::Matrix<double, 3, 2> across;
  across << u, v;
  axis.covariance = spread(squares, 2 * n - 4) * across *
                    (across.transpose() * M * across).inverse() * across.transpose();
  return axis;
}

AxisFit calibrate_axis_by_points(const TipFit& tip, const TipFit& second,
                                 const CalibrationLimits& limits) {
  const Vector3 between = tip.p_FTip - second.p_FTip;
  const double distance = between.norm();
  if (!(distance >= limits.distance_min)) {
    throw CalibrationError("shaft axis by two points: they are " + millimetres(distance) +
                           " apart; at least " + millimetres(limits.distance_min) +
                           " are needed: use a rod of another length");
  }
  AxisFit axis;
  axis.s_F = between / distance;
  if (axis.s_F.dot(tip.p_FTip) < 0) axis.s_F = -axis.s_F;  // the second point lies further out
  const Matrix3 across = Matrix3::Identity() - axis.s_F * axis.s_F.transpose();
  axis.covariance = across * (tip.covariance + second.covariance) * across / (distance * distance);
  axis.fit.n = second.fit.n;  // beside those of the tip
  axis.fit.rms = std::hypot(tip.fit.rms, second.fit.rms) / distance;
  axis.fit.worst = (tip.fit.worst + second.fit.worst) / distance;
  axis.fit.condition = std::max(tip.fit.condition, second.fit.condition);
  return axis;
}

PointFit calibrate_trocar(const std::vector<Line>& shafts, const CalibrationLimits& limits) {
  const char* what = "trocar point from shafts";
  check_count(what, shafts.size(), "shafts", limits);
  const int n = static_cast<int>(shafts.size());
  Vector3 middle = Vector3::Zero();
  for (std::size_t i = 0; i < shafts.size(); ++i) {
    if (!shafts[i].p_B.allFinite() || !(std::abs(shafts[i].s_B.norm() - 1.0) < 1e-6)) {
      throw CalibrationError(std::string(what) + ": shaft " + std::to_string(i + 1) +
                             ": a finite point and a unit direction are needed");
    }
    middle += shafts[i].p_B / n;
  }
  Matrix3 N = Matrix3::Zero();
  Vector3 b = Vector3::Zero();
  for (const Line& line : shafts) {
    const Matrix3 across = Matrix3::Identity() - line.s_B * line.s_B.transpose();
    N += across;
    b += across * (line.p_B - middle);
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3> eigen(N);
  PointFit point;
  point.fit.n = n;
  point.fit.condition = condition_of(eigen.eigenvalues()[0], eigen.eigenvalues()[2]);
  check_condition(what, point.fit.condition, "tilt the instrument further between the poses",
                  limits);
  const Matrix3 inverse = eigen.eigenvectors() * eigen.eigenvalues().cwiseInverse().asDiagonal() *
                          eigen.eigenvectors().transpose();
  point.p_BRcm = middle + inverse * b;

  std::vector<double> distances;
  double squares = 0;
  for (const Line& line : shafts) {
    const Vector3 d = point.p_BRcm - line.p_B;
    distances.push_back((d - d.dot(line.s_B) * line.s_B).norm());
    squares += distances.back() * distances.back();
  }
  judge(what, distances, limits.rms_max, limits.worst_max, millimetres,
        "the shafts do not meet in one point; the trocar has moved, or the tool is calibrated "
        "wrongly (./surg calibrate CELL tool)",
        point.fit);
  point.covariance = spread(squares, 2 * n - 3) * inverse;
  return point;
}

ToolCalibration tool_calibration(const TipFit& tip, const AxisFit& axis, const std::string& date) {
  const double length = axis.s_F.dot(tip.p_FTip);
  const Evidence evidence{std::max(tip.fit.rms, axis.fit.rms * std::abs(length)),
                          std::max(tip.fit.condition, axis.fit.condition), tip.fit.n + axis.fit.n,
                          date, "measured"};
  return {evidence, axis.s_F, tip.p_FTip};
}

TrocarCalibration trocar_calibration(const PointFit& point, const std::string& date) {
  return {{point.fit.rms, point.fit.condition, point.fit.n, date, "measured"}, point.p_BRcm};
}

}  // namespace surg
