// The pivot point: taught once, or tracked while it moves (rcm/track).
#pragma once

#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A sample of a moving trocar, in B.
struct TrackSample {
  bool valid = false;           ///< one has been received
  double age = 0;               ///< [s] since it was taken
  Vector3 p = Vector3::Zero();  ///< [m]
  Vector3 v = Vector3::Zero();  ///< [m/s]
};

/// Position and velocity of the trocar. A tracked trocar may move within a small range around the
/// taught point; if its track falls silent, the pivot stays where it was.
class Trocar {
 public:
  static constexpr double kRange = 0.010;  ///< [m] from the taught point
  static constexpr double kSpeed = 0.020;  ///< [m/s]
  static constexpr double kStale = 0.1;    ///< [s]

  void teach(const Vector3& p_B);
  /// Takes the newest sample. kNone: taken; kTrackStale: silent, the pivot stays; kRcmError: out of
  /// bounds (F23); kNotFinite. dt: time since the last call [s].
  Reason track(const TrackSample& sample, double dt);

  bool taught() const { return taught_; }
  const Vector3& p_BTaught() const { return p_taught_; }
  /// Now.
  const Vector3& p_B() const { return p_; }
  const Vector3& v_B() const { return v_; }

 private:
  bool taught_ = false;
  Vector3 p_taught_ = Vector3::Zero();
  Vector3 p_ = Vector3::Zero();
  Vector3 v_ = Vector3::Zero();
  // Acceleration: a stale velocity alone would leave its error over the feedback's gain, 12 um for
  // a breathing trocar and samples 20 ms old.
  double since_ = 0;  // [s] from the last sample to the present one
  double age_ = 0;
  bool seen_ = false;
  Vector3 v_sample_ = Vector3::Zero();
  Vector3 a_ = Vector3::Zero();
};

}  // namespace surg
