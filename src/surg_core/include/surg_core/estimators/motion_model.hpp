#pragma once

/// What the estimators of a sender's motion have in common: a random jerk moves the hand.
namespace surg::motion_model {

// In units of a sample's variance. Tuned on a synthetic and a recorded hand motion
// (docs/results/stream.md).
inline constexpr double kJerkDensity = 5e11;     // [1/s^5] spectral density of the jerk
inline constexpr double kFirstVelocity = 2.5e7;  // [1/s^2] variance of the velocity at the start
inline constexpr double kLongestGap = 0.2;       // [s] beyond it the motion before says nothing

}  // namespace surg::motion_model
