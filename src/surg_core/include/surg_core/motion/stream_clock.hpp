// Time of the samples of a stream. Arrival alone does not tell when a sample was taken: messages
// come in bursts, and with delays that change.
#pragma once

#include <cstdint>

namespace surg {

/// What is known about the time of a sample.
struct SampleTime {
  double arrival = 0;         ///< [s] on the receiver's clock; never decreases
  std::int64_t stamp_ns = 0;  ///< on the sender's clock, whatever its offset; 0: none
  double cycle = 0;           ///< [s] of the cycle that takes it, on the receiver's clock
  int cycles = 0;             ///< since the cycle that took the last one; 0: the same cycle
};

/// Puts the samples of one sender on the receiver's clock: the time at which a sample was taken,
/// plus the mean transport delay. Both clocks need not agree.
///
/// Usable stamps give the spacing of the samples, and the mean of arrival minus stamp gives the
/// offset of the clocks. Stamps are unusable if they are missing, repeated, go back, jump, or run
/// more than about 1 % too fast or too slow. Then the samples are taken as equally spaced, and a
/// phase-locked loop follows phase and period of their arrivals. A sender that answers each cycle
/// is no clock of its own: where cycles are irregular and its samples keep to them, each was taken
/// when it arrived.
class StreamClock {
 public:
  /// Starts with the first sample of a stream.
  void reset(const SampleTime& first);
  /// Takes the next sample. Returns the time [s] that passed at the sender since the last one, >=
  /// 0.
  double advance(const SampleTime& sample);
  /// Time [s] of the last sample on the receiver's clock.
  double time() const { return time_; }
  /// Mean spacing [s] of the samples at the sender; 0 before the second sample.
  double period() const { return period_; }
  /// Longest recent wait [s] for a message. Forgotten over a second.
  double wait() const { return wait_; }
  /// Whether the stamps are in use.
  bool stamped() const { return trusted_; }
  /// Whether a sample with this stamp was made before the last one, by stamps that are in use.
  bool overtaken(std::int64_t stamp_ns) const;
  /// Whether the sender answers the cycles.
  bool answers() const;

 private:
  bool judge(double ran, double since);
  void compare_cycles(const SampleTime& sample, double since);
  double follow_arrivals(double since);

  double time_ = 0, period_ = 0, wait_ = 0;
  double arrival_ = 0;
  std::int64_t stamp_ns_ = 0;
  double span_ = 0;                               ///< [s] since the first sample
  double count_ = 0;                              ///< samples since the first one
  double stamp_time_ = 0;                         ///< [s] of the last sample, by its stamp
  double stamp_count_ = 0;                        ///< stamps that it is the mean of
  double bias_ = 0;                               ///< [s] recent mean of arrival minus that time
  double jitter_ = 0;                             ///< [s] recent mean of its magnitude
  double rough_stamps_ = 0, rough_arrivals_ = 0;  ///< [s] recent mean deviation from the period
  double rough_cycles_ = 0;                       ///< [s] of the arrivals from the cycles
  double alone_ = 0;  ///< recent share of cycles with exactly one sample
  double cycle_ = 0;  ///< [s] of the cycle that took the last sample
  double clean_ = 0;  ///< [s] since stamps were unusable
  bool trusted_ = false;
  bool failed_ = false;  ///< stamps have been unusable; they are on probation
};

}  // namespace surg
