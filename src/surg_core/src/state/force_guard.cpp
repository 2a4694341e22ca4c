#include "surg_core/state/force_guard.hpp"

#include <cmath>

namespace surg {
namespace {

bool is_missing(const ForceSample& sample) {
  return !sample.valid && sample.f_B.array().isInf().any();
}

}  // namespace

ForceGuard::ForceGuard(const Limits& limits)
    : soft_(limits.tip_force_soft),
      hard_(limits.tip_force_hard),
      warn_(limits.trocar_force_warn),
      fault_(limits.trocar_force_fault) {}

ForceGuard::Verdict ForceGuard::judge(const ForceSample& tip, const ForceSample& trocar, double dt,
                                      int periods) {
  push_.setZero();
  warns_ = false;
  acceptable_ = false;
  if ((tip.valid && !tip.f_B.allFinite()) || (trocar.valid && !trocar.f_B.allFinite())) {
    return Verdict::kFade;
  }
  const double force = tip.valid ? tip.f_B.norm() : 0;
  const double load = trocar.valid ? trocar.f_B.norm() : 0;
  warns_ = load > warn_;
  if (force <= soft_) above_ = 0;
  if (force > hard_) return Verdict::kFade;
  if (load > fault_) return Verdict::kStop;
  if (is_missing(tip) || is_missing(trocar)) return Verdict::kPause;
  acceptable_ = true;
  if (force <= soft_) return Verdict::kFree;
  push_ = tip.f_B / force;
  above_ += periods;
  return above_ > std::lround(kPatience / dt) ? Verdict::kPause : Verdict::kYield;
}

}  // namespace surg
