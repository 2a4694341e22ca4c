#include "surg_core/motion/braking.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

Kinematic with_jerk(const Kinematic& from, double jerk, double t) {
  return {from.x + t * (from.v + t * (from.a / 2 + t * jerk / 6)),
          from.v + t * (from.a + t * jerk / 2), from.a + t * jerk};
}

}  // namespace

Braking Braking::stop(const Kinematic& from, const DofLimits& limits) {
  const double A = limits.acceleration, J = limits.jerk;
  Braking braking;
  braking.from_ = from;
  // The velocity that is left when a is brought to zero at once says on which side to brake. Seen
  // from there (v, a times 'side') it is positive: a falls to -peak, stays there, and returns.
  const double side = std::copysign(1.0, from.v + 0.5 * from.a * std::abs(from.a) / J);
  const double v = side * from.v, a = side * from.a;
  if (a < -A) {  // comes up to -A first
    braking.pieces_[0] = {(-A - a) / J, side * J};
    braking.pieces_[1] = {std::max(0.0, v - 0.5 * a * a / J) / A, 0};
    braking.pieces_[2] = {A / J, side * J};
  } else {
    const double peak = std::sqrt(std::max(J * v + 0.5 * a * a, 0.0));
    const double deepest = std::min(peak, A);
    braking.pieces_[0] = {std::max(0.0, a + deepest) / J, -side * J};
    if (peak > A) braking.pieces_[1] = {(v + (0.5 * a * a - A * A) / J) / A, 0};
    braking.pieces_[2] = {deepest / J, side * J};
  }
  braking.finish(0);
  return braking;
}

Braking Braking::ease(const Kinematic& from, const DofLimits& limits) {
  Braking braking;
  braking.from_ = from;
  braking.pieces_[0] = {std::abs(from.a) / limits.jerk, -std::copysign(limits.jerk, from.a)};
  braking.finish(from.v + 0.5 * from.a * std::abs(from.a) / limits.jerk);
  return braking;
}

/// The end, free of the rounding that the pieces leave in velocity and acceleration.
void Braking::finish(double v_end) {
  Kinematic state = from_;
  for (const Piece& piece : pieces_) state = with_jerk(state, piece.jerk, piece.duration);
  end_ = {state.x, v_end, 0};
}

double Braking::duration() const {
  return pieces_[0].duration + pieces_[1].duration + pieces_[2].duration;
}

Kinematic Braking::at(double t) const {
  Kinematic state = from_;
  if (!(t > 0)) return state;
  const double over = t - duration();
  if (over >= 0) return {end_.x + over * end_.v, end_.v, 0};
  for (const Piece& piece : pieces_) {
    if (t < piece.duration) return with_jerk(state, piece.jerk, t);
    state = with_jerk(state, piece.jerk, piece.duration);
    t -= piece.duration;
  }
  return end_;
}

}  // namespace surg
