#include "surg_core/kinematics/ur_inverse.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace surg {
namespace {

constexpr double kStraight = 1e-9;     // [rad, m] how well the axes must be parallel or cross
constexpr double kAtSingular = 1e-12;  // below it the quotients are rounding noise

/// A joint axis as a line at q = 0, in B.
struct Axis {
  Vector3 p, a;
};

bool parallel(const Axis& x, const Axis& y) { return x.a.cross(y.a).norm() < kStraight; }
bool square(const Axis& x, const Axis& y) { return std::abs(x.a.dot(y.a)) < kStraight; }
/// For square lines: their distance.
bool crossing(const Axis& x, const Axis& y) {
  return std::abs((y.p - x.p).dot(x.a.cross(y.a))) < kStraight;
}
/// The point of x closest to y; both square.
Vector3 foot(const Axis& x, const Axis& y) { return x.p + x.a * x.a.dot(y.p - x.p); }

double near_turn(double angle, double reference) {
  return angle + 2 * M_PI * std::nearbyint((reference - angle) / (2 * M_PI));
}

std::array<Axis, 6> axes_at_zero(const Chain& chain) {
  std::array<Axis, 6> axes;
  Pose X = Pose::Identity();
  for (int i = 0; i < 6; ++i) {
    X = X * chain.joints()[i].X_PJ;
    axes[i] = {X.translation(), (X.linear() * chain.joints()[i].axis).normalized()};
  }
  return axes;
}

const char* refusal(const std::array<Axis, 6>& axes) {
  if (!square(axes[0], axes[1]) || !crossing(axes[0], axes[1])) {
    return "axes 1 and 2 do not cross at a right angle";
  }
  if (!parallel(axes[1], axes[2]) || !parallel(axes[1], axes[3])) {
    return "axes 2, 3 and 4 are not parallel";
  }
  if (!square(axes[3], axes[4]) || !crossing(axes[3], axes[4])) {
    return "axes 4 and 5 do not cross at a right angle";
  }
  if (!square(axes[4], axes[5]) || !crossing(axes[4], axes[5])) {
    return "axes 5 and 6 do not cross at a right angle";
  }
  return nullptr;
}

/// Angles of two links in a plane from the vertical, and the sine of the angle between them.
struct PlaneAngles {
  double first, second, sine;
};

/// Links of lengths 'upper' and 'fore' that reach (x, z); nothing where the point is out of reach.
std::optional<PlaneAngles> two_links(double upper, double fore, double x, double z, bool elbow) {
  const double distance2 = x * x + z * z;
  const double sum = upper + fore, difference = upper - fore;
  const double room = (sum * sum - distance2) * (distance2 - difference * difference);
  if (!(room >= 0)) return std::nullopt;
  const double scale = 1.0 / (2 * upper * fore);
  const double s3 = (elbow ? 1 : -1) * scale * std::sqrt(room);
  const double c3 = scale * (distance2 - upper * upper - fore * fore);
  const double along = upper + fore * c3, across = fore * s3;  // the wrist from the upper link
  const double first = std::atan2(x * along - z * across, z * along + x * across);
  return PlaneAngles{first, first + std::atan2(s3, c3), s3};
}

}  // namespace

std::optional<UrInverse> UrInverse::of(const Chain& chain, std::string* why) {
  const auto refuse = [&](const std::string& reason) {
    if (why != nullptr) *why = "no closed form of the UR family: " + reason;
    return std::nullopt;
  };
  if (chain.dof() != 6) {
    return refuse("the chain has " + std::to_string(chain.dof()) + " joints, not 6");
  }
  const std::array<Axis, 6> axes = axes_at_zero(chain);
  if (const char* reason = refusal(axes)) return refuse(reason);

  UrInverse inverse;
  const Vector3 p_BShoulder = foot(axes[0], axes[1]);
  Pose X_BK = Pose::Identity();
  X_BK.linear().col(2) = axes[0].a;
  X_BK.linear().col(1) = axes[1].a;
  X_BK.linear().col(0) = axes[1].a.cross(axes[0].a);
  X_BK.translation() = p_BShoulder;
  inverse.X_KB_ = X_BK.inverse();

  const Matrix3& R_KB = inverse.X_KB_.linear();
  const auto in_plane = [&](const Vector3& v_B) {
    const Vector3 v = R_KB * v_B;
    return std::complex<double>(v.z(), v.x());
  };
  const Vector3 p_BWrist4 = foot(axes[3], axes[4]);  // where axes 4 and 5 cross
  const Vector3 p_BWrist = foot(axes[4], axes[5]);   // where axes 5 and 6 cross
  const std::complex<double> upper = in_plane(axes[2].p - p_BShoulder);
  const std::complex<double> fore = in_plane(axes[3].p - axes[2].p);
  inverse.upper_ = std::abs(upper);
  inverse.fore_ = std::abs(fore);
  if (inverse.upper_ < 1e-3 || inverse.fore_ < 1e-3) {
    return refuse("axes 2, 3 and 4 are less than 1 mm apart");
  }
  inverse.phase2_ = std::arg(upper);
  inverse.phase3_ = std::arg(fore);
  inverse.width_ = (p_BWrist - p_BShoulder).dot(axes[1].a);
  inverse.d5_ = (p_BWrist - p_BWrist4).dot(axes[4].a);
  inverse.phase_a5_ = std::arg(in_plane(axes[4].a));
  inverse.phase5_ = std::atan2(axes[5].a.dot(axes[4].a.cross(axes[1].a)), axes[5].a.dot(axes[1].a));
  inverse.sign3_ = axes[2].a.dot(axes[1].a) > 0 ? 1 : -1;
  inverse.sign4_ = axes[3].a.dot(axes[1].a) > 0 ? 1 : -1;

  const Pose X_FB = chain.forward(JointVector::Zero(6)).inverse();
  inverse.p_FWrist_ = X_FB * p_BWrist;
  inverse.a6_F_ = X_FB.linear() * axes[5].a;
  inverse.a5_F_ = X_FB.linear() * axes[4].a;
  inverse.b_F_ = inverse.a6_F_.cross(inverse.a5_F_);
  return inverse;
}

UrBranch UrInverse::branch(const JointVector& q) const {
  const double turn2 = q[1], turn3 = turn2 + sign3_ * q[2], turn4 = turn3 + sign4_ * q[3];
  const double reach = upper_ * std::sin(phase2_ + turn2) + fore_ * std::sin(phase3_ + turn3) +
                       d5_ * std::sin(phase_a5_ + turn4);
  return {reach >= 0, std::sin(sign3_ * q[2] + phase3_ - phase2_) >= 0,
          std::sin(q[4] + phase5_) >= 0};
}

UrSolution UrInverse::solve(const Pose& X_BF, const UrBranch& branch,
                            const JointVector& near) const {
  UrSolution solution;
  solution.q.setZero(6);
  const Vector3 w = X_KB_ * (X_BF * p_FWrist_);
  const Vector3 a6_B = X_BF.linear() * a6_F_;
  const Vector3 a6 = X_KB_.linear() * a6_B;

  // Joint 1 turns the plane of the links until the wrist centre is 'width' beside the base axis.
  const double radius2 = w.x() * w.x() + w.y() * w.y();
  const double reach2 = radius2 - width_ * width_;
  if (!(reach2 >= 0) || radius2 < kAtSingular) {  // NaN comes here too
    solution.unreachable = "shoulder";
    return solution;
  }
  const double reach = branch.shoulder ? std::sqrt(reach2) : -std::sqrt(reach2);
  const double c1 = (w.x() * reach + w.y() * width_) / radius2;
  const double s1 = (w.y() * reach - w.x() * width_) / radius2;
  solution.shoulder = reach;

  // Joint 5 from the angle between axis 6 and axis 2; x, y, z: axis 6 seen from the turned plane.
  const double x = c1 * a6.x() + s1 * a6.y(), y = c1 * a6.y() - s1 * a6.x(), z = a6.z();
  const double sine5 = std::sqrt(x * x + z * z);
  if (!(sine5 > kAtSingular)) {
    solution.unreachable = "wrist";
    return solution;
  }
  const double s5 = branch.wrist ? sine5 : -sine5;
  solution.wrist = s5;
  // Axis 5 is square to axis 2 and to axis 6: (axis 2 x axis 6) / s5.
  const double a5_x = z / s5, a5_z = -x / s5;
  const Vector3 a5_B = X_KB_.linear().transpose() * Vector3(c1 * a5_x, s1 * a5_x, a5_z);
  const Vector3 a5_F = X_BF.linear().transpose() * a5_B;

  const std::optional<PlaneAngles> plane =
      two_links(upper_, fore_, reach - d5_ * a5_x, w.z() - d5_ * a5_z, branch.elbow);
  if (!plane) {
    solution.unreachable = "elbow";
    return solution;
  }
  solution.elbow = plane->sine;
  const double turn2 = plane->first - phase2_;
  const double turn3 = plane->second - phase3_;
  const double turn4 = std::atan2(a5_x, a5_z) - phase_a5_;

  const JointVector& r = near;
  solution.q[0] = near_turn(std::atan2(s1, c1), r[0]);
  solution.q[1] = near_turn(turn2, r[1]);
  solution.q[2] = near_turn(sign3_ * (turn3 - turn2), r[2]);
  solution.q[3] = near_turn(sign4_ * (turn4 - turn3), r[3]);
  solution.q[4] = near_turn(std::atan2(s5, y) - phase5_, r[4]);
  solution.q[5] = near_turn(std::atan2(-a5_F.dot(b_F_), a5_F.dot(a5_F_)), r[5]);
  return solution;
}

UrSolutions UrInverse::solve_all(const Pose& X_BF, const JointVector& near) const {
  UrSolutions solutions;
  for (int i = 0; i < 8; ++i) {
    UrSolution& slot = solutions.all[solutions.count];
    slot = solve(X_BF, {(i & 1) == 0, (i & 2) == 0, (i & 4) == 0}, near);
    if (slot.unreachable == nullptr) ++solutions.count;
  }
  return solutions;
}

}  // namespace surg
