// Notch against the tremor of a hand.
#pragma once

#include "surg_core/motion/quintic.hpp"

namespace surg {

/// Takes a band around one frequency out of a stream, one axis. A hand's tremor lies at 8 to 12 Hz;
/// at 10 Hz the notch leaves half of it or less. Slower motion comes 19 ms later.
class TremorNotch {
 public:
  TremorNotch() = default;
  /// centre [Hz]; 0: off.
  explicit TremorNotch(double centre);
  void reset(const Kinematic& state);
  bool works() const { return omega_ > 0; }
  /// Advances T seconds to an input.
  void step(const Kinematic& input, double T);
  /// The output 'ahead' seconds after the last step.
  Kinematic predict(double ahead) const;

 private:
  double omega_ = 0;  ///< [rad/s]
  Kinematic out_{};
  double z_ = 0, z_rate_ = 0;  ///< of the band that is taken out: its integral and itself
};

}  // namespace surg
