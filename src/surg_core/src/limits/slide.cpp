#include "surg_core/limits/slide.hpp"

#include <algorithm>
#include <cmath>

#include "limits/joint_box.hpp"

namespace surg {
namespace {

constexpr double kWallGain = 30;         // [1/s] speed towards a wall over the distance left
constexpr double kShortestLever = 0.02;  // below it no motion of the tip takes the shaft away
constexpr double kRounding = 1e-12;      // [m, m/s] beyond a wall
constexpr int kLinearisations = 3;       // of linearisation on curved walls
constexpr int kTargetPasses = 8;         // of projection onto one wall after the other

using Walls = std::array<Wall, Fixtures::kMost>;
using Spaces = std::array<Constraint, Fixtures::kMost>;

bool holds(const Constraint& space, const Vector3& x) {
  return space.n.dot(x) >= space.least - kRounding;
}

/// On the line in which two planes meet, inside the half-spaces before them.
bool nearest_on_line(const Constraint* spaces, int i, int j, const Vector3& x0, Vector3& x) {
  const Constraint &one = spaces[i], &other = spaces[j];
  const Vector3 u = one.n.cross(other.n);
  const double squared = u.squaredNorm(), both = one.n.dot(other.n);
  if (squared < 1e-10) return false;
  const double a = one.least - one.n.dot(x0), b = other.least - other.n.dot(x0);
  const Vector3 on = x0 + ((a - both * b) * one.n + (b - both * a) * other.n) / squared;
  double from = -INFINITY, to = INFINITY;
  for (int k = 0; k < j; ++k) {
    const double rate = spaces[k].n.dot(u), rest = spaces[k].least - spaces[k].n.dot(on);
    if (std::abs(rate) < 1e-9) {
      if (rest > kRounding) return false;
    } else if (rate > 0) {
      from = std::max(from, rest / rate);
    } else {
      to = std::min(to, rest / rate);
    }
  }
  if (!(from <= to + kRounding)) return false;
  x = on + std::clamp(0.0, std::min(from, to), to) * u;
  return true;
}

bool nearest_on_plane(const Constraint* spaces, int i, const Vector3& x0, Vector3& x) {
  const Constraint& plane = spaces[i];
  x = x0 + (plane.least - plane.n.dot(x0)) * plane.n;
  for (int j = 0; j < i; ++j) {
    if (!holds(spaces[j], x) && !nearest_on_line(spaces, i, j, x0, x)) return false;
  }
  return true;
}

}  // namespace

bool nearest_in(const Constraint* spaces, int count, const Vector3& x0, Vector3& x) {
  Vector3 best = x0;
  for (int i = 0; i < count; ++i) {
    if (!holds(spaces[i], best) && !nearest_on_plane(spaces, i, x0, best)) return false;
  }
  x = best;
  return true;
}

Slide::Slide(const Fixtures& fixtures, const Vector3& p_Tip, const Vector3& v, double approach,
             double brake, double held)
    : fixtures_(fixtures), p_(p_Tip), v_(v), approach_(approach), brake_(brake), held_(held) {
  for (int i = 0; i < fixtures.size(); ++i) here_[i] = wall_at(fixtures[i], p_Tip);
}

/// Speed at which a wall may be approached from a distance: one from which 'approach_' still stops
/// there, also after 'held_'.
double Slide::approach_speed(double distance) const {
  if (!(distance > 0)) return 0;
  const double a = approach_, near = a / (kWallGain * kWallGain);
  const double led =
      distance <= near ? kWallGain * distance : std::sqrt(2 * a * (distance - near / 2));
  return held_ > 0 ? std::min(led, surg::approach_speed(distance, a, 0, held_)) : led;
}

/// Speed towards a wall that is allowed after dt: never less than hard braking leaves of it.
double Slide::fastest(const Wall& wall, double dt) const {
  const double now = -wall.lever * wall.away.dot(v_);
  return std::max(approach_speed(wall.distance), now - brake_ * dt);
}

/// Along a hollow wall the tip must turn with it, so it goes no faster than the deceleration can
/// turn it.
Vector3 Slide::slowed_on_curves(const Walls& walls, const Vector3& wished, double dt) const {
  Vector3 v = wished;
  for (int i = 0; i < fixtures_.size(); ++i) {
    const Wall& wall = walls[i];
    if (!std::isfinite(wall.hollow)) continue;
    const auto curved = [&wall](const Vector3& x) {
      return Vector3(x - wall.away * wall.away.dot(x) - wall.along * wall.along.dot(x));
    };
    const double room = 2 * approach_ * std::max(wall.distance, 0.0);
    const double turning = std::sqrt(approach_ * wall.hollow) + std::sqrt(room);
    const double most = std::max(turning, curved(v_).norm() - brake_ * dt);
    const Vector3 part = curved(v);
    const double speed = part.norm();
    if (speed > most) v -= (1 - most / speed) * part;
  }
  return v;
}

Vector3 Slide::step(const Vector3& wished, double dt) const {
  const int n = fixtures_.size();
  std::array<double, Fixtures::kMost> least;  // distance after the step
  bool allowed = true, hollow = false;
  for (int i = 0; i < n; ++i) {
    least[i] = here_[i].distance - fastest(here_[i], dt) * dt;
    allowed &= wall_at(fixtures_[i], p_ + wished).distance >= least[i];
    hollow |= std::isfinite(here_[i].hollow);
  }
  Vector3 slow = wished;
  if (hollow) {
    const Vector3 rate = wished / dt, slower = slowed_on_curves(here_, rate, dt);
    if (slower != rate) slow = dt * slower;
  }
  if (allowed && slow == wished) return wished;
  Vector3 step = slow;
  for (int pass = 0; pass < kLinearisations; ++pass) {
    Spaces spaces;
    int used = 0;
    for (int i = 0; i < n; ++i) {
      const Wall wall = pass == 0 ? here_[i] : wall_at(fixtures_[i], p_ + step);
      if (wall.lever < kShortestLever) continue;
      const double at = pass == 0 ? 0.0 : wall.away.dot(step);
      spaces[used++] = {wall.away, at + (least[i] - wall.distance) / wall.lever};
    }
    if (!nearest_in(spaces.data(), used, slow, step) && pass == 0) return Vector3::Zero();
  }
  return step;
}

Vector3 Slide::velocity(const Vector3& wished, const Vector3& step, double dt) const {
  const int n = fixtures_.size();
  Walls there;
  Spaces spaces;
  int used = 0;
  for (int i = 0; i < n; ++i) {
    const Wall& wall = there[i] = wall_at(fixtures_[i], p_ + step);
    if (wall.lever < kShortestLever) continue;
    spaces[used++] = {wall.away, -std::max(fastest(wall, dt), 0.0) / wall.lever};
  }
  const Vector3 slow = slowed_on_curves(there, wished, dt);
  Vector3 v = Vector3::Zero();
  nearest_in(spaces.data(), used, slow, v);
  return v;
}

Vector3 Slide::acceleration(const Vector3& wished, const Vector3& step, const Vector3& v) const {
  Vector3 a = wished;
  for (const Fixture& fixture : fixtures_) {
    const Wall wall = wall_at(fixture, p_ + step);
    const double in = -wall.lever * wall.away.dot(v);
    const bool held = in >= approach_speed(wall.distance) - 1e-9;
    if (held) a -= std::min(wall.away.dot(a), 0.0) * wall.away;
  }
  return a;
}

Slide::Target Slide::target(const Target& wished) const {
  Target out = wished;
  for (int pass = 0; pass < kTargetPasses; ++pass) {
    bool moved = false;
    for (int i = 0; i < fixtures_.size(); ++i) {
      const Wall &tip = here_[i], there = wall_at(fixtures_[i], out.p);
      const double level = std::min(tip.distance, 0.0);
      if (there.distance >= level - kRounding) continue;
      // A hollow wall takes the target back to its nearest point. Any other wall is flat as the tip
      // sees it: the nearest point could be on its far side.
      const bool convex = std::isfinite(there.hollow);
      const Wall& wall = convex ? there : tip;
      if (wall.lever < kShortestLever) continue;
      const double gap = convex ? there.distance - level
                                : tip.distance - level + tip.lever * tip.away.dot(out.p - p_);
      if (gap >= 0) continue;
      out.p -= gap / wall.lever * wall.away;
      out.v -= wall.away.dot(out.v) * wall.away;
      moved = true;
    }
    if (!moved) break;
  }
  return out;
}

double Slide::clearance(const Vector3& p) const {
  double least = INFINITY;
  for (int i = 0; i < fixtures_.size(); ++i) {
    const double level = std::min(here_[i].distance, 0.0);
    least = std::min(least, wall_at(fixtures_[i], p).distance - level);
  }
  return least;
}

}  // namespace surg
