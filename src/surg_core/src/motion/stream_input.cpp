#include "surg_core/motion/stream_input.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr int kDof = StreamEstimate::kDof;
constexpr double kLongestSpacing = 0.06;  // [s] the longest one: 1.5 times a burst every 40 ms
constexpr double kSlow = 0.045;           // [s] spacing of samples that no hand sends: a plan's
constexpr double kShortest = 0.008;       // [s] delay of a gentle hand, where there is any
constexpr double kGentle = 0.8;           // of the arm's acceleration: demands no more delay
constexpr double kHard = 1.5;             // of the arm's acceleration: demands the largest delay
constexpr double kUnseen = 30;            // [1/s] per period, of a demand that slow samples hide
constexpr double kGrowth = 0.5;           // [s/s] rate at which the delay grows
constexpr double kRelease = 0.02;         // [s/s] rate at which the delay shrinks

}  // namespace

StreamLateness::StreamLateness(double most) : most_(most) { reset(); }

void StreamLateness::reset() { delay_ = std::min(kShortest, most_); }

void StreamLateness::step(double demand, double period, double T) {
  const double asked = (1 + kUnseen * period) * demand;
  const double share = std::clamp((asked - kGentle) / (kHard - kGentle), 0.0, 1.0);
  const double least = std::min(kShortest, most_), wanted = least + share * (most_ - least);
  delay_ = std::clamp(wanted, delay_ - kRelease * T, delay_ + kGrowth * T);
}

StreamInput::StreamInput(double delay, double tremor) : steady_(tremor), lateness_(delay) {}

void StreamInput::begin(const Values& x, const State& from, const Values& acceleration, double age,
                        std::int64_t stamp_ns) {
  lateness_.reset();
  for (int i = 0; i < kDof; ++i) {
    delays_[i].set(lateness_.delay());
    delays_[i].reset(from[i]);
  }
  acceleration_ = acceleration;
  last_ = before_ = x;
  arrival_ = now_ + rest_ - age;
  unheard_ = 0;
  cycles_ = 0;
  clock_.reset({arrival_, stamp_ns, now_ + rest_});
  estimate_.reset(x);
  if (steady_.works()) steady_.reset(x);
}

void StreamInput::add(const Values& x, double age, std::int64_t stamp_ns) {
  const double arrival = std::max(arrival_, now_ + rest_ - age);
  const State there = way(arrival - now_);
  for (int i = 0; i < kDof; ++i) before_[i] = there[i].x;
  last_ = x;
  arrival_ = arrival;
  unheard_ = 0;
  const double elapsed = clock_.advance({arrival_, stamp_ns, now_ + rest_, cycles_});
  cycles_ = 0;
  if (steady_.works()) {
    steady_.update(x, elapsed);
  } else {
    estimate_.update(x, elapsed, clock_.period());
  }
}

void StreamInput::begin_cycle(double rest) {
  rest_ = rest;
  ++cycles_;
}

void StreamInput::elapse(double T, bool heard, std::optional<double> delay) {
  now_ += T;
  if (!heard) unheard_ += T;
  tick_ = T;
  if (!delays_[0].works(T)) return;
  const State stream = estimate(0);
  lateness_.step(demand(stream), clock_.period(), T);
  for (int i = 0; i < kDof; ++i) {
    delays_[i].set(delay.value_or(lateness_.delay()));
    delays_[i].step(stream[i].x, T);
  }
}

/// Largest acceleration of a stream over what the arm can. All degrees of freedom are delayed
/// alike, or the path would bend.
double StreamInput::demand(const State& stream) const {
  double most = 0;
  for (int i = 0; i < kDof; ++i) {
    if (acceleration_[i] > 0) most = std::max(most, std::abs(stream[i].a) / acceleration_[i]);
  }
  return most;
}

StreamInput::State StreamInput::target(double ahead) const {
  if (!delayed()) return estimate(ahead);
  State out{};
  for (int i = 0; i < kDof; ++i) out[i] = delays_[i].predict(ahead);
  return out;
}

StreamInput::State StreamInput::estimate(double ahead) const {
  if (clock_.period() > kSlow) return way(ahead);
  if (overdue()) {
    State rest{};
    for (int i = 0; i < kDof; ++i) rest[i].x = last_[i];
    return rest;
  }
  if (steady_.works()) {
    const double late = TremorEstimate::late(clock_.period());
    return steady_.predict(now_ + ahead - late - clock_.time());
  }
  const double late = HandEstimate::late(clock_.period());
  return estimate_.predict(now_ + ahead - late - clock_.time());
}

/// The straight way to the last sample, in one spacing of samples: such a sample says where to be
/// when the next one is due. One tick later, if there is none, the arm is to rest.
StreamInput::State StreamInput::way(double ahead) const {
  const double spacing = clock_.period(), since = now_ + ahead - arrival_;
  State out{};
  for (int i = 0; i < kDof; ++i) {
    out[i].x = last_[i];
    if (!(spacing > 0) || since > spacing + tick_) continue;
    out[i].v = (last_[i] - before_[i]) / spacing;
    out[i].x -= std::max(spacing - since, 0.0) * out[i].v;
  }
  return out;
}

bool StreamInput::overdue() const {
  const double gap = 1.5 * std::max(clock_.wait(), clock_.period());
  // A gap of two ticks is always bridged.
  return now_ - arrival_ - unheard_ > std::clamp(gap, 2 * tick_, kLongestSpacing);
}

}  // namespace surg
