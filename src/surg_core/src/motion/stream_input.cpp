#include "surg_core/motion/stream_input.hpp"

#include <algorithm>

namespace surg {
namespace {

constexpr int kDof = StreamEstimate::kDof;
constexpr double kShortestGap = 0.004;  // [s] a gap that is always bridged
constexpr double kLongestGap = 0.06;    // [s] the longest one: 1.5 times a burst every 40 ms
constexpr double kLateBy = 0.28;        // of a period: less to predict, and a smoother path
constexpr double kLatestBy = 0.005;     // [s]

}  // namespace

StreamInput::StreamInput(double delay, double tremor) {
  notches_.fill(TremorNotch(tremor));
  delays_.fill(StreamDelay(delay));
}

void StreamInput::begin(const Values& x, const State& from, double age, std::int64_t stamp_ns) {
  for (int i = 0; i < kDof; ++i) {
    notches_[i].reset(from[i]);
    delays_[i].reset(from[i]);
  }
  last_ = x;
  arrival_ = now_ - age;
  unheard_ = 0;
  clock_.reset({arrival_, stamp_ns});
  estimate_.reset(x);
}

void StreamInput::add(const Values& x, double age, std::int64_t stamp_ns) {
  last_ = x;
  arrival_ = std::max(arrival_, now_ - age);
  unheard_ = 0;
  const double elapsed = clock_.advance({arrival_, stamp_ns});
  estimate_.update(x, elapsed, clock_.period());
}

void StreamInput::elapse(double T, bool heard) {
  now_ += T;
  if (!heard) unheard_ += T;
  tick_ = T;
  if (!notches_[0].works() && !delays_[0].works(T)) return;
  const State stream = estimate(0);
  for (int i = 0; i < kDof; ++i) {
    notches_[i].step(stream[i], T);
    delays_[i].step(notches_[i].works() ? notches_[i].predict(0).x : stream[i].x, T);
  }
}

StreamInput::State StreamInput::target(double ahead) const {
  const bool delayed = delays_[0].works(tick_);
  if (!delayed && !notches_[0].works()) return estimate(ahead);
  State out{};
  for (int i = 0; i < kDof; ++i) {
    out[i] = delayed ? delays_[i].predict(ahead) : notches_[i].predict(ahead);
  }
  return out;
}

/// Before notch and delay.
StreamInput::State StreamInput::estimate(double ahead) const {
  if (overdue()) {
    State rest{};
    for (int i = 0; i < kDof; ++i) rest[i].x = last_[i];
    return rest;
  }
  const double late = std::min(kLateBy * clock_.period(), kLatestBy);
  return estimate_.predict(now_ + ahead - late - clock_.time());
}

bool StreamInput::overdue() const {
  const double gap = 1.5 * std::max(clock_.wait(), clock_.period());
  return now_ - arrival_ - unheard_ > std::clamp(gap, kShortestGap, kLongestGap);
}

}  // namespace surg
