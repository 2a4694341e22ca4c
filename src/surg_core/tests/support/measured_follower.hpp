// A follower that is told the lag that is measured behind it, as the controller does it.
#pragma once

#include "surg_core/law/exact_follower.hpp"
#include "surg_core/state/lag_meter.hpp"

namespace surg::test {

class MeasuredFollower : public ExactFollower {
 public:
  /// measures: false leaves the stated lags as they are.
  MeasuredFollower(int joints, const Options& options, bool measures = true)
      : ExactFollower(joints, options),
        measures_(measures),
        T_(options.T),
        meter_(link().servo),
        sent_(JointVector::Zero(joints)) {}

  JointVector advance(const JointVector& dq, const JointVector& q, const RcmRows* pivot = nullptr) {
    meter_.step(sent_, q, 0, T_);
    if (measures_) set_link(meter_.link());
    return sent_ = ExactFollower::advance(dq, q, {}, 1, 0, nullptr, pivot);
  }
  /// [rad] Largest distance of a joint from where it is expected after the last advance.
  double tracking_error(const JointVector& q) const {
    return (expected() - q).cwiseAbs().maxCoeff();
  }
  /// [s] of each joint, as it is in use.
  JointVector lag() const { return link().dead_time + link().servo.array(); }

 private:
  bool measures_;
  double T_;
  LagMeter meter_;
  JointVector sent_;
};

}  // namespace surg::test
