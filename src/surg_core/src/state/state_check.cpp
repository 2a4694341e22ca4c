#include "surg_core/state/state_check.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/state/cycle_clock.hpp"

namespace surg {

StateCheck::StateCheck(const Chain& chain, const JointVector& home, const JointVector& acceleration)
    : acceleration_(acceleration), q_(home) {
  for (int i = 0; i < chain.dof(); ++i) continuous_[i] = chain.joints()[i].continuous;
  qd_ = drift_ = JointVector::Zero(chain.dof());
}

void StateCheck::unwrap(JointVector& q) const {
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    if (continuous_[i]) q[i] += 2 * M_PI * std::round((q_[i] - q[i]) / (2 * M_PI));
  }
}

void StateCheck::take(const JointVector& q, const JointVector& qd, double age) {
  q_ = q;
  qd_ = qd;
  age_ = age;
  since_ = 0;
  bad_ = 0;
}

StateCheck::Verdict StateCheck::judge(JointVector& q, JointVector& qd, double age, double elapsed) {
  unwrap(q);
  since_ += elapsed;
  if (!started_) {
    started_ = true;
    drift_.setZero();
    take(q, qd, age);
    return Verdict::kGood;
  }
  const double span = std::max(since_ + age_ - age, 0.0);  // between the two states
  const JointVector moved = q - q_, v = 0.5 * (qd + qd_);
  // The time that has passed at the robot, as all joints say together.
  const double square = v.squaredNorm();
  const double passed = std::clamp(square > 0 ? moved.dot(v) / square : span, 0.0, span + kJitter);
  const double keep = std::exp(-span / CycleClock::kMemory);
  const JointVector drift = keep * drift_ + moved - passed * v;
  const double longest = std::max(span, passed);
  const JointVector uncertain =
      kFilter * qd.cwiseAbs().cwiseMax(qd_.cwiseAbs()) + 0.5 * longest * longest * acceleration_;
  if ((drift.array().abs() <= kSlack + uncertain.array()).all()) {
    drift_ = drift;
    // What happened inside a gap is not known to that accuracy.
    if (longest > kGap) drift_.setZero();
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
