// Estimate of a slow stream by several models of a hand's motion.
#pragma once

#include "surg_core/estimators/swing_estimate.hpp"

namespace surg {

/// At slow rates no fixed predictor is right below 3 Hz without amplifying a tremor, so several run
/// side by side: StreamEstimate, and models that swing at one frequency each. Their mean is
/// returned, weighted in each degree of freedom by how well they have predicted the recent samples
/// (multiple-model adaptive estimation, Magill 1965). Streams of 48 Hz and more get StreamEstimate
/// alone.
class HandEstimate {
 public:
  static constexpr int kDof = StreamEstimate::kDof;
  using Values = StreamEstimate::Values;
  using State = StreamEstimate::State;

  HandEstimate();
  /// Starts at rest at the first sample.
  void reset(const Values& x);
  /// Takes a sample 'elapsed' seconds >= 0 after the last one; 'period' [s]: mean spacing of the
  /// samples.
  void update(const Values& x, double elapsed, double period);
  /// The state 'age' seconds after the last sample; a negative age looks back. The acceleration is
  /// StreamEstimate's: what a hand demands of an arm shall not jump with the weights.
  State predict(double age) const;
  /// [s] by which the motion should be asked for late, for samples that are 'period' apart.
  static double late(double period);

 private:
  static constexpr int kSwings = 8;  ///< models of a hand that run beside the plain one
  void begin_swings(const Values& x);
  void weigh(double share);

  StreamEstimate plain_;
  std::array<SwingEstimate, kSwings> swings_;
  /// Recent sum of the squared innovations and weight of each model; the last one is plain_.
  std::array<Values, kSwings + 1> errors_{}, weights_{};
  bool swinging_ = false;  ///< the models that swing have followed the stream
};

}  // namespace surg
