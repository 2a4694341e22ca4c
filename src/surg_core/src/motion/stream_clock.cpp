#include "surg_core/motion/stream_clock.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kMemory = 1.0;       // [s] over which stamps and arrivals are judged
constexpr double kStart = 0.2;        // [s] until the rate of arrivals counts as a period
constexpr double kPause = 0.5;        // [s] without a sample; the stream starts anew
constexpr double kFarOff = 0.15;      // [s] no transport delays one sample by so much more
constexpr double kMaxBias = 0.01;     // [s] reached by clocks that differ by 1 % in rate
constexpr double kRoughness = 0.001;  // [s] by which good stamps may be rougher than the arrivals
constexpr double kRoughest = 0.05;    // [s] a single jump counts for no more
constexpr double kMissing = 0.6;      // of a period: a sample is missing
constexpr double kRegular = 0.1;      // of a period: less jitter shows missing samples
constexpr double kAlone = 0.9;        // of the samples: each was the only one of its cycle
constexpr double kUneven = 1e-4;      // [s] by which cycles differ that are no period
constexpr double kKeepsTo = 0.5;      // of the arrivals' roughness, of what answers cycles

double share_of(double time) { return std::min(time / kMemory, 1.0); }

}  // namespace

void StreamClock::reset(const SampleTime& first) {
  *this = StreamClock{};
  time_ = stamp_time_ = arrival_ = first.arrival;
  stamp_ns_ = first.stamp_ns;
  cycle_ = first.cycle;
}

double StreamClock::advance(const SampleTime& sample) {
  const double since = std::max(sample.arrival - arrival_, 0.0);
  if (since > kPause) {
    reset(sample);
    return since;
  }
  const bool stamped = sample.stamp_ns > 0 && stamp_ns_ > 0;
  const double ran = stamped ? 1e-9 * static_cast<double>(sample.stamp_ns - stamp_ns_) : 0.0;
  arrival_ += since;
  stamp_ns_ = sample.stamp_ns;
  span_ += since;
  count_ += 1;
  wait_ = std::max(since, wait_ - share_of(since) * wait_);
  compare_cycles(sample, since);
  const bool trusted = trusted_ || count_ == 1;
  trusted_ = judge(ran, since);
  if (trusted_) {
    period_ += std::max(1 / count_, 0.02) * (ran - period_);
    time_ = stamp_time_;
    return ran;
  }
  if (trusted) time_ = arrival_ - period_;  // where the stamps have led may be far off
  return follow_arrivals(since);
}

/// Follows the stamps, in use or not. Returns whether they are usable.
bool StreamClock::judge(double ran, double since) {
  const double share = share_of(since);
  const auto roughness = [&](double spacing) {
    return std::min(std::abs(spacing - period_), kRoughest);
  };
  rough_stamps_ += share * (roughness(ran) - rough_stamps_);
  rough_arrivals_ += share * (roughness(since) - rough_arrivals_);
  stamp_time_ += ran;
  const double late = arrival_ - stamp_time_;
  const bool credible = ran > 0 && std::abs(late) < kFarOff;
  if (credible) {
    stamp_count_ += 1;
    stamp_time_ += std::max(1 / (stamp_count_ + 1), share_of(ran)) * late;
    if (span_ > kMemory) bias_ += share_of(ran) * (late - bias_);
  } else {
    stamp_time_ = arrival_;
    stamp_count_ = 0;
  }
  const bool usable =
      credible && std::abs(bias_) < kMaxBias && rough_stamps_ < rough_arrivals_ + kRoughness;
  clean_ = usable ? clean_ + since : 0.0;
  failed_ = !usable || (failed_ && clean_ < kMemory);
  return !failed_;
}

/// Follows how well the arrivals keep to the cycles.
void StreamClock::compare_cycles(const SampleTime& sample, double since) {
  const double off = std::abs(since - (sample.cycle - cycle_));
  cycle_ = sample.cycle;
  rough_cycles_ += share_of(since) * (std::min(off, kRoughest) - rough_cycles_);
  alone_ += std::max(1 / count_, 0.02) * ((sample.cycles == 1 ? 1.0 : 0.0) - alone_);
}

bool StreamClock::overtaken(std::int64_t stamp_ns) const {
  const double before = 1e-9 * static_cast<double>(stamp_ns_ - stamp_ns);
  return trusted_ && stamp_ns > 0 && before > 0 && before < kFarOff;
}

bool StreamClock::answers() const {
  return alone_ > kAlone && rough_arrivals_ > kUneven && rough_cycles_ < kKeepsTo * rough_arrivals_;
}

/// Takes the samples as equally spaced, or as answers to the cycles. Returns the time [s] since
/// the last one.
double StreamClock::follow_arrivals(double since) {
  if (span_ < kStart) {
    period_ = span_ / count_;
    time_ = arrival_;
    return since;
  }
  const bool answer = answers();
  double ran = answer ? since : period_, late = arrival_ - time_ - ran;
  if (std::abs(late) > kFarOff) {
    time_ = arrival_;
    return since;
  }
  if (!answer && jitter_ < kRegular * period_ && late > kMissing * period_) {
    ran += period_ * std::round(late / period_);
    late = arrival_ - time_ - ran;
  }
  // A second-order loop, critically damped.
  const double gain = std::min(period_ / std::min(span_, kMemory), 0.5);
  jitter_ += gain * (std::abs(late) - jitter_);
  time_ += ran + 2 * gain * late;
  period_ += answer ? gain * (ran - period_) : gain * gain * late;
  period_ = std::max(period_, 1e-5);
  return ran;
}

}  // namespace surg
