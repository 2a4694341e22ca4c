// A stream on its way from its sender to the filters: time and estimate of the samples, notch,
// delay.
#pragma once

#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_clock.hpp"
#include "surg_core/motion/stream_estimate.hpp"
#include "surg_core/motion/tremor_notch.hpp"

namespace surg {

/// Samples of four degrees of freedom in, the target of the stream filters out. The target is late
/// by the mean transport delay, at slow rates by up to 5 ms more, and by notch and delay where they
/// are on.
class StreamInput {
 public:
  using Values = StreamEstimate::Values;
  using State = StreamEstimate::State;

  StreamInput() = default;
  /// delay [s]: see StreamDelay; tremor [Hz]: see TremorNotch. 0: off.
  StreamInput(double delay, double tremor);

  /// Starts a stream with its first sample, which arrived 'age' seconds ago with the stamp of
  /// its sender (0: none). 'from': the present state; notch and delay lead from there.
  void begin(const Values& x, const State& from, double age, std::int64_t stamp_ns);
  void add(const Values& x, double age, std::int64_t stamp_ns);
  /// Advances real time by T, one control period. heard: samples could arrive; otherwise the
  /// stream is not overdue for it.
  void elapse(double T, bool heard = true);
  /// Where the stream is 'ahead' seconds from now. After an overdue sample: at rest at the last
  /// one.
  State target(double ahead) const;
  const StreamClock& clock() const { return clock_; }

 private:
  bool overdue() const;
  State estimate(double ahead) const;

  StreamClock clock_;
  StreamEstimate estimate_;
  std::array<TremorNotch, StreamEstimate::kDof> notches_{};
  std::array<StreamDelay, StreamEstimate::kDof> delays_{};
  Values last_{};
  double now_ = 0;      ///< [s] real time from an arbitrary origin
  double arrival_ = 0;  ///< [s] of the last sample
  double unheard_ = 0;  ///< [s] since the last sample in which none could arrive
  double tick_ = 0;     ///< [s] the control period
};

}  // namespace surg
