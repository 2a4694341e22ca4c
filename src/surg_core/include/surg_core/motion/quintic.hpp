// One-degree-of-freedom quintic: coefficients, evaluation, exact extremes. Paper, "Velocity
// Profiler".
#pragma once

namespace surg {

struct Kinematic {
  double x = 0, v = 0, a = 0;
};

struct DofLimits {
  double velocity, acceleration, jerk;
};

/// x(t) = sum c_i (t/d)^i on [0, d] with given states at both ends. A duration that is not positive
/// gives the constant end state.
class Quintic {
 public:
  Quintic() = default;
  Quintic(const Kinematic& from, const Kinematic& to, double duration);
  double duration() const { return d_; }
  Kinematic at(double t) const;     ///< clamped to [0, d]; from d on exactly the end state
  double position(double t) const;  ///< at(t).x
  double max_velocity() const;      ///< max |v| on [0, d], exact
  double max_acceleration() const;  ///< max |a|, exact
  double max_jerk() const;          ///< max |j|, exact

 private:
  double c_[6] = {0, 0, 0, 0, 0, 0};  // normalised time: well scaled for any duration
  double d_ = 0;
  Kinematic to_{};
};

}  // namespace surg
