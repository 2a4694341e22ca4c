// Estimate of a stream between its samples: position, velocity and acceleration of four degrees of
// freedom, by a Kalman filter on a model of hand motion.
#pragma once

#include <array>

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Kalman filter whose model is an acceleration that decays exponentially (Singer, 1970). The
/// degrees of freedom share one covariance, in units of the variance of a sample: what counts is
/// the ratio of process to measurement noise.
class StreamEstimate {
 public:
  static constexpr int kDof = 4;
  using Values = std::array<double, kDof>;
  using State = std::array<Kinematic, kDof>;

  /// Starts at rest at the first sample.
  void reset(const Values& x);
  /// Takes a sample 'elapsed' seconds >= 0 after the last one; 'period' [s]: mean spacing of the
  /// samples.
  void update(const Values& x, double elapsed, double period);
  /// The state 'age' seconds after the last sample; a negative age looks back.
  State predict(double age) const;

 private:
  struct Transition;
  void propagate(const Transition& step, double elapsed);

  State state_{};
  /// Covariance: xx, xv, xa, vv, va, aa.
  double xx_ = 1, xv_ = 0, xa_ = 0, vv_ = 0, va_ = 0, aa_ = 0;
};

}  // namespace surg
