// The pivot point: taught once, or tracked while it moves (rcm/track).
#pragma once

#include <cstdint>

#include "surg_core/estimators/track_filter.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// What is wrong with rcm/track; the arm goes on.
enum class TrackWarning : std::uint8_t {
  kNone,
  kOutlier,  // a sample was not used
  kDropout,  // samples are missing
  kNoisy,    // noisier than stated
};
/// The short name, and one sentence for people.
const char* name(TrackWarning warning);
const char* sentence(TrackWarning warning);

/// A sample of a moving trocar, in B.
struct TrackSample {
  bool valid = false;           ///< one has been received
  double age = 0;               ///< [s] since it was taken
  Vector3 p = Vector3::Zero();  ///< [m]
  Vector3 v = Vector3::Zero();  ///< [m/s]; zeros where the tracker has none
};

/// Position and velocity of the trocar. A tracked trocar may move within a small range around the
/// taught point. Its samples pass a filter (track_filter.hpp); what a sample changes fades in, so
/// that the pivot never jumps. If the track is lost, the pivot stays where it was.
class Trocar {
 public:
  static constexpr double kRange = 0.010;  ///< [m] of a track from the taught point (F23)
  static constexpr double kSpeed = 0.020;  ///< [m/s] of a track (F23)

  struct Options {
    double noise = 3e-4;    ///< [m] rms per axis that the tracker states
    double jerk = 0.02;     ///< [m/s^3] of the trocar
    double timeout = 0.25;  ///< [s] without a usable sample; then the track is lost
  };
  explicit Trocar(const Options& options);

  void teach(const Vector3& p_B);
  /// Takes the newest sample. kNone: taken, or the filter bridges a gap; kTrackStale: lost, the
  /// pivot stays; kRcmError: out of bounds, or it jumped (F23); kNotFinite. dt: time since the last
  /// call [s].
  Reason track(const TrackSample& sample, double dt);
  /// Of the last call.
  TrackWarning warning() const { return warning_; }

  bool taught() const { return taught_; }
  const Vector3& p_BTaught() const { return p_taught_; }
  /// Now.
  const Vector3& p_B() const { return p_; }
  const Vector3& v_B() const { return v_; }

 private:
  Reason lose(Reason reason);
  void join(double age);
  void take(const TrackSample& sample, double since);
  void count_outlier(const Vector3& p, double since);
  bool jumped() const;
  void fade(double dt);

  Options options_;
  bool taught_ = false;
  Vector3 p_taught_ = Vector3::Zero();
  Vector3 p_ = Vector3::Zero();
  Vector3 v_ = Vector3::Zero();

  TrackFilter filter_;
  TrackWarning warning_ = TrackWarning::kNone;
  bool seen_ = false;
  double age_ = 0;       // [s] of the last sample, usable or not
  double since_ = 0;     // [s] from the last sample to the newest one
  double filtered_ = 0;  // [s] since the filter's last prediction
  double usable_ = 0;    // [s] since the last usable sample was taken
  double spacing_ = 0;   // [s] usual time between samples; 0: unknown
  Vector3 p_outlier_ = Vector3::Zero();
  int outliers_ = 0;  // in a row, each near the one before
  // What p_ and v_ still differ from the filter; it decays, critically damped.
  Vector3 lead_ = Vector3::Zero(), lead_rate_ = Vector3::Zero();
};

}  // namespace surg
