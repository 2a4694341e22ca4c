#include "surg_core/kinematics/trocar.hpp"

#include <cmath>

namespace surg {
namespace {

constexpr double kSmoothing = 0.05;  // [s] of the acceleration: breathing and heart are slower

}  // namespace

void Trocar::teach(const Vector3& p_B) {
  taught_ = true;
  p_taught_ = p_ = p_B;
  v_.setZero();
  seen_ = false;
}

Reason Trocar::track(const TrackSample& sample, double dt) {
  if (!sample.valid) return Reason::kNone;
  if (!sample.p.allFinite() || !sample.v.allFinite() || !(sample.age >= 0)) {
    v_.setZero();
    return Reason::kNotFinite;
  }
  if (!(sample.age <= kStale)) {
    v_.setZero();
    seen_ = false;
    return Reason::kTrackStale;
  }
  if (!(sample.v.norm() <= kSpeed)) {  // before it gets into the acceleration, and stays there
    v_.setZero();
    seen_ = false;
    return Reason::kRcmError;
  }
  since_ += dt + age_ - sample.age;  // by how much the time of the sample has moved on
  age_ = sample.age;
  if (!seen_) {
    a_.setZero();
    v_sample_ = sample.v;
    since_ = 0;
    seen_ = true;
  } else if (since_ > 0.5 * dt) {
    a_ += (1 - std::exp(-since_ / kSmoothing)) * ((sample.v - v_sample_) / since_ - a_);
    v_sample_ = sample.v;
    since_ = 0;
  }
  const Vector3 p = sample.p + sample.age * (sample.v + 0.5 * sample.age * a_);
  if (!((p - p_taught_).norm() <= kRange)) {
    v_.setZero();
    return Reason::kRcmError;
  }
  p_ = p;
  v_ = sample.v + sample.age * a_;
  return Reason::kNone;
}

}  // namespace surg
