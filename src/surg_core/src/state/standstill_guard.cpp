#include "surg_core/state/standstill_guard.hpp"

#include <cmath>

namespace surg {

bool StandstillGuard::stands_still(const JointVector& qd, const JointVector& q, double dt) {
  if (!started_) {
    started_ = true;
    lasted_ = 0;
    commanded_ = measured_ = JointVector::Zero(q.size());
    q_last_ = q;
    return false;
  }
  const double kept = std::exp(-dt / kMemory);
  commanded_ = kept * commanded_ + dt * qd;
  measured_ = kept * measured_ + q - q_last_;
  q_last_ = q;
  const double commanded = commanded_.norm();
  const bool still = commanded > kCommanded && measured_.norm() < kShare * commanded;
  lasted_ = still ? lasted_ + dt : 0;
  return lasted_ > patience_;
}

}  // namespace surg
