#include "surg_core/kinematics/kinematics.hpp"

#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "kinematics/sines.hpp"

namespace surg {

bool is_rotation(const Matrix3& R) {
  return (R * R.transpose() - Matrix3::Identity()).cwiseAbs().maxCoeff() < 1e-6 &&
         R.determinant() > 0;
}

namespace {

void check_pose(const Pose& X, const std::string& what) {
  if (!X.matrix().allFinite()) throw std::invalid_argument(what + ": the pose is not finite");
  if (!is_rotation(X.linear())) {
    throw std::invalid_argument(what + ": the pose's rotation part is not a rotation matrix");
  }
}

}  // namespace

Chain::Chain(std::vector<Joint> joints, const Pose& X_LF)
    : joints_(std::move(joints)), X_LF_(X_LF) {
  if (joints_.empty() || joints_.size() > static_cast<std::size_t>(kMaxJoints)) {
    throw std::invalid_argument("a chain has 1 to " + std::to_string(kMaxJoints) + " joints, not " +
                                std::to_string(joints_.size()));
  }
  for (const Joint& joint : joints_) {
    check_pose(joint.X_PJ, "joint '" + joint.name + "'");
    // Written so that a NaN fails as well.
    if (!(std::abs(joint.axis.norm() - 1.0) < 1e-9)) {
      throw std::invalid_argument("joint '" + joint.name + "': the axis is not a unit vector");
    }
  }
  check_pose(X_LF_, "flange");
  Matrix3 Z;  // of the present joint: from the loop's frame to the joint's own, z onto the axis
  Z.col(0) = joints_[0].axis.unitOrthogonal();
  Z.col(1) = joints_[0].axis.cross(Vector3(Z.col(0)));
  Z.col(2) = joints_[0].axis;
  start_ = joints_[0].X_PJ * Pose(Z);
  for (int i = 0; i + 1 < dof(); ++i) {
    const Pose X = Pose(Z.transpose()) * joints_[i + 1].X_PJ;
    const Vector3 axis = X.linear() * joints_[i + 1].axis;
    const double sine = std::hypot(axis.x(), axis.y());
    Link& link = links_[i];
    // Any turn will do for parallel axes.
    link.turn = sine > 0 ? std::atan2(axis.x(), -axis.y()) : 0.0;
    const double norm = std::hypot(sine, axis.z());
    link.cos_tilt = axis.z() / norm;
    link.sin_tilt = sine / norm;
    const Matrix3 turn = Eigen::AngleAxisd(link.turn, Vector3::UnitZ()).toRotationMatrix();
    Matrix3 tilt;
    tilt << 1, 0, 0, 0, link.cos_tilt, -link.sin_tilt, 0, link.sin_tilt, link.cos_tilt;
    link.shift = turn.transpose() * X.translation();
    Z = X.linear().transpose() * turn * tilt;
  }
  end_ = Pose(Z.transpose()) * X_LF_;
}

/// Origin and z of every joint, and the flange, in B. Homogeneous, as four numbers fill two
/// registers where three take three.
struct Chain::Frames {
  std::array<Vector4, kMaxJoints> origin, axis;
  Vector4 x, y, z, p;  ///< of the present frame, at last the flange: axes, origin

  explicit Frames(const Pose& start)
      : x(start.matrix().col(0)),
        y(start.matrix().col(1)),
        z(start.matrix().col(2)),
        p(start.matrix().col(3)) {}
  void turn(double c, double s) {
    const Vector4 x_new = x * c + y * s;
    y = y * c - x * s;
    x = x_new;
  }
  void shift(const Vector3& t) { p += x * t[0] + y * t[1] + z * t[2]; }
  void tilt(double c, double s) {
    const Vector4 y_new = y * c + z * s;
    z = z * c - y * s;
    y = y_new;
  }
  Pose move(const Pose& X) const {
    const Eigen::Matrix4d& A = X.matrix();
    Pose moved;
    for (int i = 0; i < 3; ++i) moved.matrix().col(i) = x * A(0, i) + y * A(1, i) + z * A(2, i);
    moved.matrix().col(3) = p + x * A(0, 3) + y * A(1, 3) + z * A(2, 3);
    return moved;
  }
};

Pose Chain::walk(const JointVector& q, Frames& frames) const {
  const int n = dof();
  Angles<kMaxJoints> angle = Angles<kMaxJoints>::Zero(), s, c;
  for (int i = 0; i < n; ++i) angle[i] = q[i] + links_[i].turn;
  if (n <= 6) {
    Angles<6> s6, c6;
    sines<6>(angle.head<6>(), s6, c6);
    s.head<6>() = s6;
    c.head<6>() = c6;
  } else {
    sines(angle, s, c);
  }
  for (int i = 0; i < n; ++i) {
    frames.origin[i] = frames.p;
    frames.axis[i] = frames.z;
    frames.turn(c[i], s[i]);
    if (i + 1 == n) break;
    frames.shift(links_[i].shift);
    frames.tilt(links_[i].cos_tilt, links_[i].sin_tilt);
  }
  return frames.move(end_);
}

Pose Chain::forward(const JointVector& q) const {
  if (joints_.empty()) return X_LF_;
  Frames frames(start_);
  return walk(q, frames);
}

void Chain::forward(const JointVector& q, Pose& X_BF, Jacobian& J) const {
  Frames frames(start_);
  X_BF = walk(q, frames);
  const Vector4 p = X_BF.matrix().col(3);
  const int n = dof();
  J.resize(6, n);
  for (int i = 0; i < n; ++i) {
    const Vector4& z = frames.axis[i];
    const Vector4 r = p - frames.origin[i];
    double* column = J.data() + 6 * i;
    column[0] = z[1] * r[2] - z[2] * r[1];
    column[1] = z[2] * r[0] - z[0] * r[2];
    column[2] = z[0] * r[1] - z[1] * r[0];
    column[3] = z[0];
    column[4] = z[1];
    column[5] = z[2];
  }
}

Vector6 bias_acceleration(const Jacobian& J, const JointVector& qd) {
  Vector3 linear = Vector3::Zero(), angular = Vector3::Zero();
  Vector3 omega = Vector3::Zero();  // of the link before the joint
  for (Eigen::Index i = 0; i < J.cols(); ++i) {
    const Vector3 v = qd[i] * J.col(i).head<3>(), turn = qd[i] * J.col(i).tail<3>();
    linear += Vector3(2 * omega + turn).cross(v);
    angular += omega.cross(turn);
    omega += turn;
  }
  Vector6 acceleration;
  acceleration << linear, angular;
  return acceleration;
}

}  // namespace surg
