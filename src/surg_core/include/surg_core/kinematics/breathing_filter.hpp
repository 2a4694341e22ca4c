// Filter for a trocar that breathes regularly, from positions alone.
#pragma once

#include "surg_core/kinematics/harmonics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Kalman filter of the harmonics of a regular motion, at a rate that RateSearch finds. A
/// ventilator repeats itself, so this filter averages over several breaths, where a filter that
/// follows any motion averages over a fraction of one. The three axes share one covariance.
class BreathingFilter {
 public:
  void start(const Vector3& p, double variance);
  void predict(double dt);
  /// Takes a position with its variance per axis [m^2].
  void measure(const Vector3& p, double variance);
  /// The motion is regular, and the filter follows it. It settles within 10 s or 3 periods.
  bool settled() const { return settled_; }

  /// Position [m] and velocity [m/s] 'ahead' seconds after the last prediction.
  Vector3 p(double ahead = 0) const;
  Vector3 v(double ahead = 0) const;
  /// Of the breathing [Hz]; 0: unknown.
  double rate() const { return settled_ ? rate_ / (2 * M_PI) : 0; }

 private:
  void settle();
  void drop(const Vector3& p, double variance);
  void correct(const Vector3& miss, double variance);
  bool departs(const Vector3& miss, double variance);

  RateSearch search_;
  double since_ = 0;  // [s] since the last sample
  bool settled_ = false;
  double settled_for_ = 0;       // [s]
  double rate_ = 0, phase_ = 0;  // [rad/s], [rad]
  Harmonics::Coefficients x_ = Harmonics::Coefficients::Zero();
  Harmonics::Covariance P_ = Harmonics::Covariance::Zero();
  Vector3 bias_ = Vector3::Zero();  // [m] low-passed innovation
};

}  // namespace surg
