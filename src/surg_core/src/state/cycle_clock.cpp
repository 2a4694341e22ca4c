#include "surg_core/state/cycle_clock.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kPeriodRounding = 1e-9;  // [periods]
constexpr double kEarly = 0.5;            // [periods] a cycle that comes earlier is none

}  // namespace

void CycleClock::advance(double elapsed) {
  const double longest = kMostPeriods * period_;
  elapsed_ = elapsed == 0 ? period_ : elapsed;
  if (!(elapsed_ <= longest)) elapsed_ = longest;  // also where it is not a number
  elapsed_ = std::max(elapsed_, 0.0);

  const double length = elapsed_ / period_;
  // A cycle that comes a little late or early is one period. Only a whole one more is made up for,
  // and only half a one less is no period.
  rest_ += elapsed_ - period_;
  const int missed = static_cast<int>(std::floor(rest_ / period_ + kPeriodRounding));
  periods_ = rest_ < -kEarly * period_ ? 0 : 1 + std::max(missed, 0);
  rest_ -= (periods_ - 1) * period_;

  const bool late = length > kLate + kPeriodRounding;
  n_late_ += static_cast<int>(late) - late_[at_];
  late_[at_] = late;
  at_ = (at_ + 1) % kWindow;
  gaps_ = length > kLong + kPeriodRounding ? gaps_ + elapsed_ : 0;
  const double share = std::min(elapsed_ / kMemory, 1.0);
  excess_ += share * (elapsed_ - period_ - excess_);
}

bool CycleClock::starved() const { return gaps_ / period_ > kCatchUp + kPeriodRounding; }

}  // namespace surg
