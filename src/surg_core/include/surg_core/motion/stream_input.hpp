// A stream on its way from its sender to the filters: time and estimate of the samples, delay.
#pragma once

#include <optional>

#include "surg_core/estimators/hand_estimate.hpp"
#include "surg_core/estimators/tremor_estimate.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_clock.hpp"

namespace surg {

/// How late a stream is followed: at once as long as the hand is gentle, later as soon as it
/// accelerates harder than the arm can. The delay changes slowly, so a path is slowed down and
/// never jumps.
class StreamLateness {
 public:
  StreamLateness() = default;
  /// most [s]: the largest delay.
  explicit StreamLateness(double most);
  /// Back to the shortest delay.
  void reset();
  /// One tick of T seconds. demand: the hand's acceleration over what the arm can; period [s]: of
  /// the samples.
  void step(double demand, double period, double T);
  double delay() const { return delay_; }

 private:
  double most_ = 0, delay_ = 0;  ///< [s]
};

/// Samples of four degrees of freedom in, the target of the stream filters out. The target is late
/// by the mean transport delay and at slow rates by up to 5 ms more; by TremorEstimate::late
/// instead where a tremor is taken out; by the delay where there is one. Samples of a plan, 45 ms
/// apart or more, are not predicted: each is reached when the next one is due.
class StreamInput {
 public:
  using Values = StreamEstimate::Values;
  using State = StreamEstimate::State;

  StreamInput() = default;
  /// delay [s]: the largest one, see StreamLateness; tremor [Hz]: see TremorEstimate. 0: off.
  StreamInput(double delay, double tremor);

  /// Starts a stream with its first sample, which arrived 'age' seconds ago with the stamp of
  /// its sender (0: none). 'from': the present state, from which the delay leads.
  /// acceleration: what the arm can in each degree of freedom.
  void begin(const Values& x, const State& from, const Values& acceleration, double age,
             std::int64_t stamp_ns);
  void add(const Values& x, double age, std::int64_t stamp_ns);
  /// A control cycle begins, 'rest' seconds after the time that has elapsed. Samples that it adds
  /// have their age from then.
  void begin_cycle(double rest);
  /// Advances real time by T, one control period. heard: samples could arrive; otherwise the
  /// stream is not overdue for it. delay [s]: of the stream that this one belongs to; none: its
  /// own.
  void elapse(double T, bool heard = true, std::optional<double> delay = {});
  /// Where the stream is 'ahead' seconds from now. After an overdue sample: at rest at the last
  /// one.
  State target(double ahead) const;
  /// The same before the delay.
  State estimate(double ahead) const;
  bool delayed() const { return delays_[0].works(tick_); }
  const StreamClock& clock() const { return clock_; }
  double delay() const { return lateness_.delay(); }

 private:
  bool overdue() const;
  State way(double ahead) const;
  double demand(const State& stream) const;

  StreamClock clock_;
  HandEstimate estimate_;
  TremorEstimate steady_;  ///< instead of estimate_, where a tremor is to be taken out
  std::array<StreamDelay, StreamEstimate::kDof> delays_{};
  StreamLateness lateness_;
  Values acceleration_{};
  Values last_{};
  Values before_{};     ///< where the way to the last sample began
  double now_ = 0;      ///< [s] real time from an arbitrary origin
  double arrival_ = 0;  ///< [s] of the last sample
  double unheard_ = 0;  ///< [s] since the last sample in which none could arrive
  double tick_ = 0;     ///< [s] the control period
  double rest_ = 0;     ///< [s] from now_ to the present cycle
  int cycles_ = 0;      ///< since the last sample
};

}  // namespace surg
