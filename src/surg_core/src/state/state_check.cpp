#include "surg_core/state/state_check.hpp"

#include <algorithm>
#include <cmath>

namespace surg {

StateCheck::StateCheck(const Chain& chain, const JointVector& home, const JointVector& acceleration)
    : acceleration_(acceleration), q_(home) {
  for (int i = 0; i < chain.dof(); ++i) continuous_[i] = chain.joints()[i].continuous;
  qd_ = drift_ = JointVector::Zero(chain.dof());
}

void StateCheck::unwrap(JointVector& q) const {
  constexpr double kTurn = 2 * M_PI;
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    if (continuous_[i]) q[i] += kTurn * std::round((q_[i] - q[i]) / kTurn);
  }
}

void StateCheck::take(const JointVector& q, const JointVector& qd, double age) {
  q_ = q;
  qd_ = qd;
  age_ = age;
  since_ = 0;
  bad_ = 0;
}

StateCheck::Verdict StateCheck::judge(JointVector& q, JointVector& qd, double age, double elapsed,
                                      double delay) {
  unwrap(q);
  since_ += elapsed;
  if (!started_) {
    started_ = true;
    drift_.setZero();
    take(q, qd, age);
    return Verdict::kGood;
  }
  const double span = since_ + age_ - age;  // between the two states
  const double keep = std::exp(-std::abs(span) / kMemory);
  JointVector drift = keep * drift_ + (q - q_) - 0.5 * span * (qd + qd_);
  const JointVector speed = qd.cwiseAbs().cwiseMax(qd_.cwiseAbs());
  const JointVector uncertain =
      (0.5 * std::abs(span) + delay) * speed + 0.5 * span * span * acceleration_;
  if ((drift.array().abs() <= kSlack + uncertain.array()).all()) {
    drift_ = drift;
    // What happened inside a gap is not known to that accuracy.
    if (std::abs(span) > kGap) drift_.setZero();
    take(q, qd, age);
    return Verdict::kGood;
  }
  if (++bad_ >= kLost) {
    drift_.setZero();
    take(q, qd, age);
    return Verdict::kLost;
  }
  q = q_ + span * qd_;
  qd = qd_;
  return Verdict::kImplausible;
}

}  // namespace surg
