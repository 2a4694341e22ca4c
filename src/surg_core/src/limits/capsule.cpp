#include "surg_core/limits/capsule.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kTouching = 1e-9;  // [m] between axes: the direction from one to the other is lost

Vector3 at(const Capsule& capsule, double t) { return capsule.a + t * (capsule.b - capsule.a); }

double nearest(const Capsule& capsule, const Vector3& p) {
  return nearest_share(capsule.a, capsule.b - capsule.a, p);
}

Gap gap(const Vector3& p, const Vector3& p_other, double radii) {
  Gap gap{p, p_other, Vector3::UnitZ(), 0};
  const Vector3 apart = p - p_other;
  const double length = apart.norm();
  if (length > kTouching) gap.away = apart / length;
  gap.distance = length - radii;
  return gap;
}

/// The closest points of two segments (Ericson, Real-Time Collision Detection, 5.1.9).
Gap closest(const Capsule& first, const Capsule& second, double radii) {
  const Vector3 u = first.b - first.a, v = second.b - second.a, w = first.a - second.a;
  const double uu = u.squaredNorm(), vv = v.squaredNorm(), uv = u.dot(v);
  const double uw = u.dot(w), vw = v.dot(w);
  const double sine = uu * vv - uv * uv;
  double s = sine > 1e-12 * uu * vv ? std::clamp((uv * vw - uw * vv) / sine, 0.0, 1.0) : 0.0;
  const double t = nearest(second, at(first, s));
  s = nearest(first, at(second, t));
  return gap(at(first, s), at(second, t), radii);
}

}  // namespace

std::array<Gap, 5> gaps(const Capsule& first, const Capsule& second) {
  const double radii = first.radius + second.radius;
  return {closest(first, second, radii), gap(first.a, at(second, nearest(second, first.a)), radii),
          gap(first.b, at(second, nearest(second, first.b)), radii),
          gap(at(first, nearest(first, second.a)), second.a, radii),
          gap(at(first, nearest(first, second.b)), second.b, radii)};
}

std::array<Gap, 2> gaps(const Capsule& capsule, const HalfSpace& space) {
  const auto end = [&](const Vector3& p) {
    const double height = space.normal.dot(p - space.point);
    return Gap{p, p - height * space.normal, space.normal, height - capsule.radius};
  };
  return {end(capsule.a), end(capsule.b)};
}

double distance(const Capsule& first, const Capsule& second) {
  double least = INFINITY;
  for (const Gap& gap : gaps(first, second)) least = std::min(least, gap.distance);
  return least;
}

double distance(const Capsule& capsule, const HalfSpace& space) {
  const std::array<Gap, 2> ends = gaps(capsule, space);
  return std::min(ends[0].distance, ends[1].distance);
}

double distance_at_least(const Capsule& first, const Capsule& second) {
  const Vector3 apart = 0.5 * (first.a + first.b - second.a - second.b);
  return apart.norm() - 0.5 * ((first.b - first.a).norm() + (second.b - second.a).norm()) -
         first.radius - second.radius;
}

}  // namespace surg
