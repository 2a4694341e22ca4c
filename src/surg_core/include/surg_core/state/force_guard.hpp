// Guards the measured force at the tip and the load on the trocar (F25).
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A measured force. 'valid' is false for arms without a sensor; nothing is guarded then. Not valid
/// and infinite: the cell requires a force, and nobody knows it.
struct ForceSample {
  bool valid = false;
  Vector3 f_B = Vector3::Zero();  ///< of the environment on the instrument [N], in B
};

class ForceGuard {
 public:
  static constexpr double kPatience = 0.1;  ///< [s] above the soft limit, then PAUSED

  enum class Verdict { kFree, kYield, kPause, kStop, kFade };

  ForceGuard() = default;
  explicit ForceGuard(const Limits& limits);

  /// Call it once per cycle, 'periods' of dt [s] after the last time. kYield: above the soft limit;
  /// kPause: above it for kPatience, or missing; kStop: trocar load; kFade: above the hard limit,
  /// or not finite (contact geometry unknown).
  Verdict judge(const ForceSample& tip, const ForceSample& trocar, double dt, int periods = 1);
  /// Restarts the time above the soft limit, so that an arm in contact can move away.
  void restart() { above_ = 0; }
  /// Whether the measured forces are below their fault levels.
  bool acceptable() const { return acceptable_; }
  /// Whether the trocar load is above its warning level.
  bool warns() const { return warns_; }
  /// Unit direction of the force on the tip while the guard yields, in B; zero otherwise. Motion
  /// against it raises the force.
  const Vector3& push() const { return push_; }

 private:
  double soft_ = 0, hard_ = 0, warn_ = 0, fault_ = 0;
  int above_ = 0;                   // periods since the soft limit was passed
  Vector3 push_ = Vector3::Zero();  // unit direction of the force on the tip; zero: free
  bool warns_ = false;
  bool acceptable_ = true;
};

}  // namespace surg
