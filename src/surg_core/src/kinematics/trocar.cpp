#include "surg_core/kinematics/trocar.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kFade = 40;     // [1/s] pole with which a sample's correction fades in
constexpr double kHuge = 1e3;    // [m, m/s] F01: larger values overflow when squared
constexpr double kUneven = 0.3;  // share of the spacing by which samples may come early or late
constexpr double kGap = 1.8;     // times the spacing: samples are missing
constexpr double kSpacingShare = 0.1;  // of a new spacing in the usual one
constexpr double kDeviations = 3;      // of the estimated velocity that may be noise
constexpr double kNoisy = 1.5;         // times the stated noise; above it a tracker is noisy
constexpr double kNear = 2e-3;         // [m] of the first sample; farther away it counts at once
constexpr int kJump = 3;               // outliers in a row that see the same point

bool usable(const Vector3& v) { return v.norm() <= kHuge; }  // false for NaN

/// Of each TrackWarning, in order: its name, what is wrong and what to do.
constexpr const char* kWarnings[][2] = {
    {"none", ""},
    {"track_outlier",
     "a sample on rcm/track is far from the trocar's motion and was not used: check the "
     "tracker's line of sight and its markers"},
    {"track_dropout",
     "samples on rcm/track are missing; the controller bridged the gap: check the "
     "tracker's line of sight and the network"},
    {"track_noisy",
     "the positions on rcm/track are noisier than tuning.track_noise, and the pivot less "
     "accurate than stated: check the tracker's distance and its markers"},
};

}  // namespace

const char* name(TrackWarning warning) { return kWarnings[static_cast<int>(warning)][0]; }
const char* sentence(TrackWarning warning) { return kWarnings[static_cast<int>(warning)][1]; }

Trocar::Trocar(const Options& options)
    : options_(options), filter_(options.noise, options.jerk, kSpeed) {}

void Trocar::teach(const Vector3& p_B) {
  taught_ = true;
  p_taught_ = p_ = p_B;
  v_.setZero();
  seen_ = false;
}

Reason Trocar::lose(Reason reason) {
  v_.setZero();
  seen_ = false;
  return reason;
}

Reason Trocar::track(const TrackSample& sample, double dt) {
  warning_ = TrackWarning::kNone;
  if (!sample.valid) return Reason::kNone;
  if (!usable(sample.p) || !usable(sample.v) || !(sample.age >= 0)) return lose(Reason::kNotFinite);
  if (!(sample.age <= options_.timeout)) return lose(Reason::kTrackStale);
  const bool in_range = (sample.p - p_taught_).norm() <= kRange;
  const double since = since_ + dt + age_ - sample.age;  // by how much the sample's time moved on
  filtered_ += dt;
  usable_ += dt;
  if (!seen_) {
    if (!in_range) return lose(Reason::kRcmError);
    seen_ = true;
    filter_.start(sample.p, sample.v);
    filtered_ = usable_ = sample.age;
    join(sample.age);
    since_ = spacing_ = 0;
    outliers_ = 0;
  } else if (since > 0.5 * dt) {
    take(sample, since);
    since_ = 0;
  } else {
    since_ = since;
  }
  age_ = sample.age;
  if (jumped()) return lose(Reason::kRcmError);
  if (usable_ > options_.timeout) return lose(in_range ? Reason::kTrackStale : Reason::kRcmError);
  fade(dt);
  const double fastest = kSpeed + kDeviations * filter_.velocity_deviation();
  const bool within =
      (filter_.p(filtered_) - p_taught_).norm() <= kRange && filter_.v(filtered_).norm() <= fastest;
  return within ? Reason::kNone : lose(Reason::kRcmError);
}

/// The first sample has its noise: the trocar goes there from where it was, as at any correction. A
/// step would ask of the joints what they cannot do, and throw the tip off its path.
void Trocar::join(double age) {
  const Vector3 off = p_ - filter_.p(age);
  const bool near = off.norm() <= kNear;
  lead_ = near ? off : Vector3(Vector3::Zero());
  lead_rate_ = near ? Vector3(v_ - filter_.v(age)) : Vector3(Vector3::Zero());
}

void Trocar::take(const TrackSample& sample, double since) {
  const Vector3 p = filter_.p(filtered_), v = filter_.v(filtered_);
  const bool known = spacing_ > 0;
  const bool evenly = known && std::abs(since - spacing_) < kUneven * spacing_;
  if (known && since > kGap * spacing_) warning_ = TrackWarning::kDropout;
  if (filter_.noise() > kNoisy * options_.noise) warning_ = TrackWarning::kNoisy;
  if (filter_.add(sample.p, sample.v, filtered_ - sample.age, evenly)) {
    usable_ = sample.age;
    outliers_ = 0;
  } else {
    warning_ = TrackWarning::kOutlier;
    count_outlier(sample.p, since);
  }
  filtered_ = sample.age;
  spacing_ = known ? spacing_ + kSpacingShare * (since - spacing_) : since;
  lead_ += p - filter_.p(filtered_);
  lead_rate_ += v - filter_.v(filtered_);
}

void Trocar::count_outlier(const Vector3& p, double since) {
  const double near = TrackFilter::gate(filter_.noise()) + kSpeed * since;
  const bool agrees = outliers_ > 0 && (p - p_outlier_).norm() <= near;
  outliers_ = agrees ? outliers_ + 1 : 1;
  p_outlier_ = p;
}

/// Outliers that agree with one another are none: the trocar, or its marker, is elsewhere.
bool Trocar::jumped() const { return outliers_ >= kJump; }

void Trocar::fade(double dt) {
  const Vector3 slope = lead_rate_ + kFade * lead_;
  const double left = std::exp(-kFade * dt);
  lead_ = left * (lead_ + dt * slope);
  lead_rate_ = left * (lead_rate_ - kFade * dt * slope);
  p_ = filter_.p(filtered_) + lead_;
  v_ = filter_.v(filtered_) + lead_rate_;
}

}  // namespace surg
