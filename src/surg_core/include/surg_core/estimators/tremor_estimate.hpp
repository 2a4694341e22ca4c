// Estimate of a hand's motion without its tremor.
#pragma once

#include "surg_core/estimators/stream_estimate.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Kalman filter that takes samples as the sum of a slow motion, whose jerk is white noise, and of
/// a tremor, a damped oscillator in white noise (8 to 12 Hz). It returns the slow motion alone.
/// Told apart, a tremor is not predicted: the filter works at any rate that samples it, also at 30
/// Hz.
class TremorEstimate {
 public:
  using Values = StreamEstimate::Values;
  using State = StreamEstimate::State;

  /// centre [Hz] of the tremor; 0: off.
  explicit TremorEstimate(double centre = 0);
  bool works() const { return omega_ > 0; }
  /// [s] by which the motion should be asked for late, for samples that are 'period' apart.
  static double late(double period);
  /// Starts at rest at the first sample.
  void reset(const Values& x);
  /// Takes a sample 'elapsed' seconds >= 0 after the last one.
  void update(const Values& x, double elapsed);
  /// The slow motion 'age' seconds after the last sample; a negative age looks back.
  State predict(double age) const;

 private:
  using Mixed = Eigen::Matrix<double, 5, 1>;  ///< position, velocity, acceleration; tremor, rate
  using Covariance = Eigen::Matrix<double, 5, 5>;
  Covariance transition(double h) const;
  Covariance process(const Covariance& transition, double h) const;
  void take(const Values& x);

  double omega_ = 0;  ///< [rad/s]
  std::array<Mixed, StreamEstimate::kDof> state_;
  Covariance covariance_ = Covariance::Zero();  ///< of every axis, in variances of a sample
};

}  // namespace surg
