#include "surg_core/motion/joint_trace.hpp"

#include <algorithm>
#include <cmath>

namespace surg {

void JointTrace::clear() {
  n_ = 0;
  spacing_ = kSpacing;
  ahead_ = 0;
}

void JointTrace::record(const JointVector& q) {
  if (n_ > 0 && points_[0].size() != q.size()) clear();
  if (n_ == 0) {
    points_[0] = newest_ = q;
    arc_[0] = 0;
    n_ = 1;
    return;
  }
  newest_ = q;
  ahead_ = (q - points_[n_ - 1]).cwiseAbs().maxCoeff();
  if (ahead_ < spacing_) return;
  if (cut_loop(q)) return;
  if (n_ == kCapacity) thin();
  ahead_ = (q - points_[n_ - 1]).cwiseAbs().maxCoeff();
  points_[n_] = q;
  arc_[n_] = arc_[n_ - 1] + ahead_;
  ++n_;
  ahead_ = 0;
}

void JointTrace::shorten(double s) {
  if (n_ == 0 || !(s > 0)) return;
  newest_ = at(s);
  const double left = std::max(length() - s, 0.0);
  while (n_ > 1 && arc_[n_ - 1] > left) --n_;
  ahead_ = (newest_ - points_[n_ - 1]).cwiseAbs().maxCoeff();
}

/// Back where it has been before: what lies between is no part of the way out. Whole working
/// sessions in one place so keep a short, fine trace.
bool JointTrace::cut_loop(const JointVector& q) {
  constexpr double kRounding = 1e-9;  // [rad] of a sum of lengths
  for (int i = 0; i + 1 < n_;) {
    const double distance = (points_[i] - q).cwiseAbs().maxCoeff();
    if (distance < spacing_) {
      n_ = i + 1;
      ahead_ = distance;
      return true;
    }
    // No point can be near before the trace has gone at least the distance that is missing.
    const double near = arc_[i] + distance - spacing_ - kRounding;
    for (++i; i + 1 < n_ && arc_[i] <= near;) ++i;
  }
  return false;
}

void JointTrace::thin() {
  const int kept = (n_ + 1) / 2;
  for (int i = 1; i < kept; ++i) {
    points_[i] = points_[2 * i];
    arc_[i] = arc_[i - 1] + (points_[i] - points_[i - 1]).cwiseAbs().maxCoeff();
  }
  n_ = kept;
  spacing_ *= 2;
}

JointVector JointTrace::at(double s) const {
  const int last = ahead_ > 0 ? n_ : n_ - 1;  // index of the newest point
  const double from_start = std::clamp(length() - s, 0.0, length());
  if (last <= 0) return points_[0];
  const auto end = arc_.begin() + n_;
  int i = static_cast<int>(std::upper_bound(arc_.begin(), end, from_start) - arc_.begin()) - 1;
  i = std::clamp(i, 0, last - 1);
  // Cubic Hermite between point i and i + 1, slopes from the neighbours on either side.
  const auto slope = [&](int k) {
    const int a = std::max(k - 1, 0), b = std::min(k + 1, last);
    return JointVector((point(b) - point(a)) / std::max(arc(b) - arc(a), 1e-12));
  };
  const double h = arc(i + 1) - arc(i);
  const double x = h > 0 ? (from_start - arc(i)) / h : 0.0;
  const JointVector m0 = h * slope(i), m1 = h * slope(i + 1);
  const JointVector p0 = point(i), p1 = point(i + 1);
  return p0 + x * (m0 + x * ((3 * (p1 - p0) - 2 * m0 - m1) + x * (2 * (p0 - p1) + m0 + m1)));
}

}  // namespace surg
