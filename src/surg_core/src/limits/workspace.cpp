#include "surg_core/limits/workspace.hpp"

#include <algorithm>
#include <cmath>

namespace surg {
namespace {

constexpr double kAside = 0.002;  // [m] off the shaft is still along it

}  // namespace

double outside_workspace(const Limits& limits, const Vector3& p_RTip) {
  const double depth = p_RTip.norm();
  return std::max({limits.depth_min - depth, depth - limits.depth_max,
                   depth * std::cos(limits.cone) - p_RTip.z()});
}

bool inside_workspace(const Limits& limits, const Vector3& p_RTip) {
  return p_RTip.allFinite() && outside_workspace(limits, p_RTip) <= 0;
}

Vector3 nearest_inside(const Limits& limits, const Vector3& p_RTip, double margin) {
  const double least = limits.depth_min + margin, greatest = limits.depth_max - margin;
  const double aside = std::hypot(p_RTip.x(), p_RTip.y());
  const double axial = p_RTip.z() * std::cos(limits.cone), depth = p_RTip.norm();
  // Distance from the cone's wall, positive inside.
  const double inside = p_RTip.z() * std::sin(limits.cone) - aside * std::cos(limits.cone);
  if (inside >= margin && depth > 0) return p_RTip * (std::clamp(depth, least, greatest) / depth);
  // On the cone: along the line in which its wall meets the plane of p and the axis.
  const double along = std::clamp(axial + aside * std::sin(limits.cone), least, greatest);
  const double angle = limits.cone - std::asin(margin / along);
  const Eigen::Vector2d away =
      aside > 0 ? Eigen::Vector2d(p_RTip.head<2>() / aside) : Eigen::Vector2d(1, 0);
  Vector3 p;
  p << along * std::sin(angle) * away, along * std::cos(angle);
  return p;
}

bool aside_near_trocar(const Vector3& p_RTip, const Vector3& s_R, double depth) {
  return p_RTip.norm() < depth && (p_RTip - s_R * s_R.dot(p_RTip)).norm() > kAside;
}

double lateral_fade(const Limits& limits, double depth) {
  return std::clamp((depth - limits.depth_min) / (limits.depth_slow - limits.depth_min), 0.0, 1.0);
}

}  // namespace surg
