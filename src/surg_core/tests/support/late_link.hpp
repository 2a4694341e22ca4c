// A link on a starved machine: for some tens of milliseconds it obeys later than stated.
#pragma once

#include <cmath>
#include <deque>

#include "surg_core/types.hpp"

namespace surg::test {

/// How a link is late.
enum class Late {
  kServo,  ///< its servo is slower: a longer first-order lag
  kQueue,  ///< commands arrive later, none is lost: the arm waits, then makes all of them
  kBunch,  ///< commands arrive together, and the newest counts: the arm waits, then skips some
};

/// Joints behind one first-order lag and a dead time, 'stated' [s] in all. At drawn moments the sum
/// grows for a while. Measured in steps of 1e-5 rad.
class LateLink {
 public:
  static constexpr double kTick = 0.002;  ///< [s]

  LateLink(const JointVector& q, double stated, Late kind)
      : q_(q), servo_(stated - kTick), kind_(kind) {
    qd_ = JointVector::Zero(q.size());
    sent_.assign(kKept, qd_);
  }

  /// One tick with this command. more [s]: how much later than stated the link obeys now.
  void obey(const JointVector& command, double more) {
    sent_.push_front(command);
    sent_.pop_back();
    const double servo = servo_ + (kind_ == Late::kServo ? more : 0.0);
    const int dead = 1 + (kind_ == Late::kServo ? 0 : static_cast<int>(std::lround(more / kTick)));
    // A link that stops repeats its last command. A queue works off two per tick when the delay
    // ends.
    const int next = kind_ == Late::kQueue ? std::max(dead, behind_ - 1) : dead;
    behind_ = std::min(next, behind_ + 1);
    const JointVector& u = sent_[behind_];
    const double keep = std::exp(-kTick / servo);
    q_ += kTick * u + servo * (1 - keep) * (qd_ - u);
    qd_ = u + keep * (qd_ - u);
  }

  const JointVector& truth() const { return q_; }
  const JointVector& velocity() const { return qd_; }
  JointVector measured() const { return (q_ / kStep).array().round().matrix() * kStep; }

 private:
  static constexpr double kStep = 1e-5;     // [rad]
  static constexpr std::size_t kKept = 64;  // commands
  JointVector q_, qd_;
  double servo_;
  Late kind_;
  std::deque<JointVector> sent_;  // the newest first
  int behind_ = 1;                // [ticks] of the command that is obeyed
};

}  // namespace surg::test
