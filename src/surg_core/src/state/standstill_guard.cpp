#include "surg_core/state/standstill_guard.hpp"

#include <cmath>

namespace surg {
namespace {

double length(const Vector6& displacement) {
  return std::hypot(displacement.head<3>().norm(),
                    StandstillGuard::kLever * displacement.tail<3>().norm());
}

}  // namespace

bool StandstillGuard::stands_still(const JointVector& qd, const JointVector& q, const Jacobian& J,
                                   double dt) {
  if (!started_) {
    started_ = true;
    lasted_ = 0;
    commanded_.setZero();
    measured_.setZero();
    q_last_ = q;
    return false;
  }
  const double kept = std::exp(-dt / kMemory);
  commanded_ = kept * commanded_ + J * (dt * qd);
  measured_ = kept * measured_ + J * (q - q_last_);
  q_last_ = q;
  const double commanded = length(commanded_);
  const bool still = commanded > kCommanded && length(measured_) < kShare * commanded;
  lasted_ = still ? lasted_ + dt : 0;
  return lasted_ > patience_;
}

}  // namespace surg
