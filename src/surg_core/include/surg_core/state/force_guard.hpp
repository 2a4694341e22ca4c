// What the measured force at the tip and the load of the trocar allow (F25).
#pragma once

#include "surg_core/config.hpp"
#include "surg_core/state/operating_state.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A measured force. Not every arm has a sensor: 'valid' is false then, and nothing is guarded.
struct ForceSample {
  bool valid = false;
  Vector3 f_B = Vector3::Zero();  ///< of the environment on the instrument [N], in B
};

class ForceGuard {
 public:
  static constexpr double kPatience = 0.1;  ///< [s] above the soft limit, then PAUSED

  enum class Verdict { kFree, kYield, kPause, kStop, kHalt };

  ForceGuard() = default;
  explicit ForceGuard(const Limits& limits);

  /// Once a cycle. kYield: above the soft limit; kPause: for kPatience; kStop: the trocar's load;
  /// kHalt: above the hard limit, or not finite (the geometry of the contact is unknown).
  Verdict judge(const ForceSample& tip, const ForceSample& trocar, double dt);
  /// The arm starts anew: patience as well, or it could never move away from a contact.
  void restart() { above_ = 0; }
  /// Below the levels of FAULT, as far as is measured.
  bool acceptable() const { return acceptable_; }
  /// Above the warning level of the trocar's load.
  bool warns() const { return warns_; }
  /// Unit direction of the force on the tip while the guard yields, in B; zero: free. Motion
  /// against it raises the force.
  const Vector3& push() const { return push_; }

 private:
  double soft_ = 0, hard_ = 0, warn_ = 0, fault_ = 0;
  int above_ = 0;                   // cycles since the soft limit was passed
  Vector3 push_ = Vector3::Zero();  // unit direction of the force on the tip; zero: free
  bool warns_ = false;
  bool acceptable_ = true;
};

}  // namespace surg
