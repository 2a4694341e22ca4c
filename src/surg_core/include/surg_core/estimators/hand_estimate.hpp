// Estimate of a stream by several models of a hand's motion.
#pragma once

#include "surg_core/estimators/swing_estimate.hpp"

namespace surg {

/// No fixed predictor is right below 7 Hz without amplifying beyond, so several run side by side:
/// StreamEstimate, and models that swing at one frequency each. Their mean is returned, weighted in
/// each degree of freedom by how well they have predicted the recent samples (multiple-model
/// adaptive estimation, Magill 1965). StreamEstimate takes every sample, the others one every 8 ms.
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
  /// The state 'age' seconds after the last sample; a negative age looks back.
  State predict(double age) const;
  /// [s] by which the motion should be asked for late, for samples that are 'period' apart.
  static double late(double period);

 private:
  static constexpr int kSwings = 12;  ///< models of a hand that run beside the plain one
  void begin_swings(const Values& x);
  void compare(const Values& x, double h);
  void weigh(double period);

  StreamEstimate plain_;
  StreamEstimate then_;  ///< plain_ when the others were given a sample
  double since_ = 0;     ///< [s] since then
  std::array<SwingEstimate, kSwings> swings_;
  /// Recent sum of the squared innovations and weight of each model; the last one is plain_.
  std::array<Values, kSwings + 1> errors_{}, weights_{};
  bool swinging_ = false;  ///< the models that swing have followed the stream
};

}  // namespace surg
