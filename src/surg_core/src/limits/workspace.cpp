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

bool aside_near_trocar(const Vector3& p_RTip, const Vector3& s_R, double depth) {
  return p_RTip.norm() < depth && (p_RTip - s_R * s_R.dot(p_RTip)).norm() > kAside;
}

double lateral_fade(const Limits& limits, double depth) {
  return std::clamp((depth - limits.depth_min) / (limits.depth_slow - limits.depth_min), 0.0, 1.0);
}

}  // namespace surg
