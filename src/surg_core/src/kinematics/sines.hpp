// Sines and cosines of all joints at once: computed one by one they take half of the time of the
// kinematics.
#pragma once

#include <cmath>

#include "surg_core/types.hpp"

namespace surg {

template <int n>
using Angles = Eigen::Array<double, n, 1>;  ///< one number per joint; unused ones: zero

/// Sines s and cosines c of 'angle' [rad], to 3e-16 absolute. Each statement works on all joints,
/// in pairs that share a register.
template <int n>
void sines(const Angles<n>& angle, Angles<n>& s, Angles<n>& c) {
  if (!(angle.abs().maxCoeff() < 1e3)) {  // the reduction below is for small numbers; NaN too
    s = angle.sin();
    c = angle.cos();
    return;
  }
  // r = angle - turns pi, turns the nearest whole number: adding 1.5 * 2^52 rounds to it. Pi is a
  // sum whose first two terms have 33 bits, so that their products with it are exact.
  constexpr double kRound = 6755399441055744.0;
  const Angles<n> turns = (angle * (1 / M_PI) + kRound) - kRound;
  const Angles<n> r = ((angle - turns * 0x1.921fb544p+1) - turns * 0x1.0b4611a6p-33) -
                      turns * 0x1.3198a2e037073p-68;
  const Angles<n> odd = turns - 2 * ((turns * 0.5 + kRound) - kRound);  // 0 or +-1
  const Angles<n> sign = 1 - 2 * odd * odd;
  // Taylor's series for up to a quarter turn: what is left out is below 2e-18 and 1e-19.
  const Angles<n> z = r * r;
  Angles<n> p = z * (1.0 / 51090942171709440000.0) - 1.0 / 121645100408832000.0;  // 1/21!, 1/19!
  p = p * z + 1.0 / 355687428096000.0;
  p = p * z - 1.0 / 1307674368000.0;
  p = p * z + 1.0 / 6227020800.0;
  p = p * z - 1.0 / 39916800.0;
  p = p * z + 1.0 / 362880.0;
  p = p * z - 1.0 / 5040.0;
  p = p * z + 1.0 / 120.0;
  p = p * z - 1.0 / 6.0;
  s = sign * (r + r * z * p);
  p = z * (-1.0 / 1124000727777607680000.0) + 1.0 / 2432902008176640000.0;  // 1/22!, 1/20!
  p = p * z - 1.0 / 6402373705728000.0;
  p = p * z + 1.0 / 20922789888000.0;
  p = p * z - 1.0 / 87178291200.0;
  p = p * z + 1.0 / 479001600.0;
  p = p * z - 1.0 / 3628800.0;
  p = p * z + 1.0 / 40320.0;
  p = p * z - 1.0 / 720.0;
  p = p * z + 1.0 / 24.0;
  c = sign * (1 - 0.5 * z + z * z * p);
}

}  // namespace surg
