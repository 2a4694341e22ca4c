// Estimate of a motion that swings: one model of the bank of HandEstimate.
#pragma once

#include "surg_core/estimators/stream_estimate.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// What a SwingEstimate takes a motion for: the sum of a slow motion, whose velocity is a damped
/// oscillator in white noise, and of a swing, another one. Variances are in units of that for which
/// the jerk's spectral density is 5e11 / s^5.
struct SwingModel {
  double noise;         ///< variance of a sample
  double return_rate;   ///< [1/s^2] stiffness with which the slow velocity returns to zero
  double return_decay;  ///< [1/s] damping of it
  double hertz = 0;     ///< of the swing; 0: none
  double size = 0;      ///< variance of the swing
  double fade = 0;      ///< [1/s] with which an oscillation of the swing fades
};

/// Kalman filter on a SwingModel. The degrees of freedom share one covariance.
class SwingEstimate {
 public:
  using Values = StreamEstimate::Values;
  using State = StreamEstimate::State;

  SwingEstimate() = default;
  explicit SwingEstimate(const SwingModel& model);
  /// Starts at rest at the first sample.
  void reset(const Values& x);
  /// Takes a sample 'elapsed' seconds >= 0 after the last one. Returns how far it was from what
  /// the model had predicted.
  Values update(const Values& x, double elapsed);
  /// The motion 'age' seconds after the last sample, swing and all; a negative age looks back.
  State predict(double age) const;

 private:
  using Mixed = Eigen::Matrix<double, 5, 1>;  ///< position, velocity, acceleration; swing, rate
  using Covariance = Eigen::Matrix<double, 5, 5>;
  Covariance transition(double h) const;
  Covariance process(const Covariance& transition, double h) const;

  SwingModel model_{};
  double stiffness_ = 0;  ///< [1/s^2] of the swing
  std::array<Mixed, StreamEstimate::kDof> state_{};
  Covariance covariance_ = Covariance::Zero();
};

}  // namespace surg
