// A periodic motion as a line and harmonics, and the search for its rate.
#pragma once

#include <Eigen/Core>
#include <array>

#include "surg_core/types.hpp"

namespace surg {

/// A line and the harmonics of one rate, per axis:
/// p = x0 + x1 t + sum over k of x2k cos(k phase) + x2k+1 sin(k phase).
struct Harmonics {
  static constexpr int kHarmonics = 6;  ///< of the breathing
  static constexpr int kTerms = 2 + 2 * kHarmonics;
  using Row = Eigen::Matrix<double, kTerms, 1>;
  using Coefficients = Eigen::Matrix<double, kTerms, 3>;  // [m], [m/s]; one column per axis
  using Covariance = Eigen::Matrix<double, kTerms, kTerms>;

  /// The factors of the coefficients. phase [rad], t [s]
  static Row row(double phase, double t);
  /// Their derivatives by time. rate: of the phase [rad/s]
  static Row derivative(double phase, double rate);
};

/// Least-squares search for the rate of a periodic motion in its last 20 s. Each call looks at one
/// rate (several while the motion is short), so that the work per call is bounded.
class RateSearch {
 public:
  static constexpr double kLeastSpan = 8;  ///< [s] of samples before a rate is believed

  struct Fit {
    double rate = 0;            // [rad/s]
    double variance = 0;        // [m^2] of the residual per axis
    Harmonics::Coefficients x;  // now: phase 0, t = 0
    Harmonics::Covariance covariance;
  };

  void clear();
  /// The rate is wrong: searches on.
  void reject();
  /// Takes a sample dt after the last one [s], with its variance per axis [m^2].
  void add(const Vector3& p, double dt, double variance);
  /// A rate explains the motion up to the noise.
  bool found() const { return found_; }
  /// [rad/s]
  double rate() const { return rate_; }
  /// At this rate.
  Fit fit() const { return fit(rate_); }

 private:
  static constexpr int kBlocks = 200;
  static constexpr int kRates = 64;  ///< that a sweep may look at
  struct Block {
    double t = 0;                 // [s]
    Vector3 p = Vector3::Zero();  // mean of its samples
  };
  const Block& block(int i) const { return ring_[(first_ + i) % kBlocks]; }
  double span() const { return n_ > 1 ? block(n_ - 1).t - block(0).t : 0; }
  void close_block();
  Fit fit(double rate) const;
  void sweep();
  void choose();
  void refine(double variance);

  std::array<Block, kBlocks> ring_{};
  int first_ = 0, n_ = 0;
  double t_ = 0;  // [s] now
  // The block that fills.
  int in_block_ = 0;
  double block_from_ = 0, sum_t_ = 0;
  Vector3 sum_ = Vector3::Zero();
  // The sweep, from fast to slow.
  int swept_ = 0;
  std::array<double, kRates> swept_rate_{}, swept_variance_{};
  // The rate, and what the fit leaves at three rates about it.
  double rate_ = 0;  // [rad/s]; 0: none
  bool found_ = false;
  int probe_ = 0, refined_ = 0;
  std::array<double, 3> probed_{};
};

}  // namespace surg
