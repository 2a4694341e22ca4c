// Filter for the samples of a tracked point (rcm/track).
#pragma once

#include <algorithm>

#include "surg_core/estimators/breathing_filter.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Constant-acceleration Kalman filter of a point: the jerk is white noise. The three axes share
/// one covariance, since they have the same noise and the same model.
class PointKalman {
 public:
  void start(const Vector3& p, const Vector3& v, const Matrix3& covariance);
  /// Advances the state by dt [s]. jerk: spectral density of the white jerk [m^2/s^5].
  void predict(double dt, double jerk);
  /// Takes a measured position with its variance per axis [m^2].
  void measure_position(const Vector3& p, double variance) { measure(0, p, variance); }
  /// Takes a measured velocity with its variance per axis [m^2/s^2].
  void measure_velocity(const Vector3& v, double variance) { measure(1, v, variance); }

  /// Position [m] and velocity [m/s] 'ahead' seconds after the last prediction.
  Vector3 p(double ahead = 0) const { return p_ + ahead * (v_ + 0.5 * ahead * a_); }
  Vector3 v(double ahead = 0) const { return v_ + ahead * a_; }
  /// Variances per axis [m^2], [m^2/s^2].
  double position_variance() const { return P_(0, 0); }
  double velocity_variance() const { return P_(1, 1); }

 private:
  void measure(int row, const Vector3& value, double variance);

  Vector3 p_ = Vector3::Zero(), v_ = Vector3::Zero(), a_ = Vector3::Zero();
  Matrix3 P_ = Matrix3::Zero();  // of p, v, a along one axis
};

/// Variance per axis of white noise on samples of a smooth motion, from their third differences. A
/// breathing trocar contributes T^3 jerk to them, 1 um at 25 Hz.
class NoiseEstimate {
 public:
  /// variance: to begin with; it counts as many third differences as 'weight' says.
  NoiseEstimate(double variance, int weight) : variance_(variance), known_(weight) {}
  /// Takes the next sample; 'evenly': it follows the last one at the usual spacing.
  void add(const Vector3& sample, bool evenly);
  double variance() const { return variance_; }

 private:
  double variance_;
  int known_;  // third differences so far, as far as they count
  int n_ = 0;  // samples in a row, at most 3
  Vector3 first_ = Vector3::Zero(), second_ = Vector3::Zero(), third_ = Vector3::Zero();
};

/// Estimates a point from noisy, irregular samples of its position and velocity.
///
/// Three Kalman filters run side by side. Two follow any motion: one takes positions and
/// velocities, one positions alone, because many trackers fill in a velocity that is zero or late.
/// The third takes positions and knows that breathing repeats itself. The one that has predicted
/// the positions best in the last 2 s gives the estimate; the third must have settled, and is
/// dropped as soon as the motion changes. The noise of positions and velocities is measured. A
/// sample is an outlier if it is far from the predictions, and farther from the sample before it
/// than the point can move. An outlier changes nothing.
class TrackFilter {
 public:
  /// noise: stated noise of a position, rms per axis [m]. jerk: of the point [m/s^3]; the filter
  /// takes it to change by about this much every 0.1 s. speed: largest of the point [m/s].
  TrackFilter(double noise, double jerk, double speed);

  void start(const Vector3& p, const Vector3& v);
  /// Takes a sample that was taken dt after the last one [s]. False: an outlier.
  bool add(const Vector3& p, const Vector3& v, double dt, bool evenly);

  /// Position [m] and velocity [m/s] 'ahead' seconds after the last sample.
  Vector3 p(double ahead) const { return regular() ? breathing_.p(ahead) : best().p(ahead); }
  Vector3 v(double ahead) const { return regular() ? breathing_.v(ahead) : best().v(ahead); }
  /// Standard deviation of the velocity per axis [m/s].
  double velocity_deviation() const;
  /// Measured noise of the positions, rms per axis [m].
  double noise() const;
  /// [m] up to which two places may be the same, for a standard deviation [m] between them.
  static double gate(double deviation);
  /// The estimate is that of regular breathing.
  bool regular() const {
    return breathing_.settled() && miss_breathing_ < std::min(miss_both_, miss_positions_);
  }

 private:
  bool both_are_better() const { return miss_both_ < miss_positions_; }
  const PointKalman& best() const { return both_are_better() ? both_ : positions_; }
  double position_variance() const;
  bool expected(const Vector3& p, double variance) const;
  void compare(const Vector3& p, double share);

  double jerk_;   // [m^2/s^5]
  double speed_;  // [m/s]
  PointKalman both_, positions_;
  BreathingFilter breathing_;
  NoiseEstimate position_noise_, velocity_noise_;
  // [m^2] low-passed squared prediction errors
  double miss_both_ = 0, miss_positions_ = 0, miss_breathing_ = 0;
  Vector3 last_ = Vector3::Zero();  // sample that was taken
  bool took_last_ = false;
};

}  // namespace surg
