// Filter for a trocar that breathes regularly, from positions alone.
#pragma once

#include <array>

#include "surg_core/estimators/harmonics.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// The harmonics above those of Harmonics, up to a frequency: what a kink in the wave adds to them.
/// Samples of whole breaths hardly correlate them, so each has a variance of its own. It begins
/// with the one that a kink has, so that the noise does not enter where no kink can be.
class Overtones {
 public:
  Overtones() {
    cos_.fill(Vector3::Zero());
    sin_.fill(Vector3::Zero());
  }
  /// rate [rad/s]; size [m]: amplitude of the fundamental.
  void start(double rate, double size);
  void predict(double dt);
  /// Takes what a sample differs from the prediction; variance [m^2]: of that difference.
  void correct(double phase, const Vector3& miss, double variance);

  Vector3 p(double phase) const;               ///< [m]
  Vector3 v(double phase, double rate) const;  ///< [m/s]
  double variance() const;                     ///< of the position per axis [m^2]

 private:
  static constexpr int kFirstOvertone = Harmonics::kHarmonics + 1;  ///< first overtone
  static constexpr int kLast = 24;  ///< last overtone of the slowest breathing
  static constexpr int kMost = kLast - kFirstOvertone + 1;  ///< overtones at most

  int n_ = 0;
  double rate_ = 0;                       // [rad/s]
  double breath_ = 0;                     // share of a breath since the last sample
  std::array<Vector3, kMost> cos_, sin_;  // coefficients [m]
  std::array<double, kMost> variance_{};  // of both [m^2]
};

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
  Overtones overtones_;
  Vector3 bias_ = Vector3::Zero();  // [m] low-passed innovation
};

}  // namespace surg
