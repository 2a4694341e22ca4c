// The serial chain from base to flange: forward kinematics, geometric Jacobian, inverse velocity.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "surg_core/types.hpp"

namespace surg {

/// Whether a matrix is a rotation, to 1e-6; false for NaN.
bool is_rotation(const Matrix3& R);

/// A revolute joint: pose of the joint frame in the previous one at q = 0, and its unit axis.
struct Joint {
  std::string name;
  Pose X_PJ = Pose::Identity();
  Vector3 axis = Vector3::UnitZ();
  bool continuous = false;  ///< without stops; its driver may wrap the position by full turns
};

/// A serial chain of revolute joints with a fixed flange behind the last one.
class Chain {
 public:
  Chain() = default;
  /// Throws std::invalid_argument for 0 or more than kMaxJoints joints, non-unit axes or non-finite
  /// poses.
  Chain(std::vector<Joint> joints, const Pose& X_LF);

  int dof() const { return static_cast<int>(joints_.size()); }
  const std::vector<Joint>& joints() const { return joints_; }
  const Pose& X_LF() const { return X_LF_; }

  /// X_BF at joint positions q [rad].
  Pose forward(const JointVector& q) const;
  /// X_BF and the geometric Jacobian of the flange origin, rows v then omega, in B.
  void forward(const JointVector& q, Pose& X_BF, Jacobian& J) const;
  /// The same as values.
  struct Flange {
    Pose X_BF;
    Jacobian J;
  };
  Flange flange(const JointVector& q) const {
    Flange out;
    forward(q, out.X_BF, out.J);
    return out;
  }

 private:
  struct Frames;
  Pose walk(const JointVector& q, Frames& frames) const;

  std::vector<Joint> joints_;
  Pose X_LF_ = Pose::Identity();
  /// The same chain, prepared for the control loop. Each joint rotates about z of a frame whose x
  /// axis is chosen so that the next joint follows by a rotation about z (combined with the joint's
  /// own), a translation and a tilt about x. This takes a third fewer products than general poses.
  /// Unlike Denavit-Hartenberg parameters it is well conditioned for nearly parallel axes.
  struct Link {
    double turn = 0;                  // [rad] about z, before the shift
    Vector3 shift = Vector3::Zero();  // to the next joint, after the turn
    double cos_tilt = 1, sin_tilt = 0;
  };
  Pose start_ = Pose::Identity();       ///< first joint's frame
  std::array<Link, kMaxJoints> links_;  ///< from joint i to i + 1
  Pose end_ = Pose::Identity();         ///< from the last joint to the flange
};

/// J_dot qd: the flange's acceleration, linear then angular, at constant joint velocities qd.
Vector6 bias_acceleration(const Jacobian& J, const JointVector& qd);

/// Pivots of an elimination of J (six joints), or of J J^T without pivoting (more).
struct Pivots {
  Vector6 value = Vector6::Zero();
  std::array<int, 6> row{0, 1, 2, 3, 4, 5};  ///< of the pivot in each column
  bool squares = false;                      ///< of J J^T, which has the squares

  /// J's smallest over its largest magnitude; 0: singular, or not finite.
  double ratio() const;
  /// The same with the determinant's sign, for six joints.
  double signed_ratio() const;
};

/// Joint velocities that give a flange twist: J^-1 for six joints; for more, the pseudo-inverse
/// plus 'posture' [rad/s] projected into the null space. For fewer than six joints: not supported.
struct InverseVelocity {
  JointVector qd;
  double conditioning = 0;  ///< smallest pivot ratio seen, 0: singular; qd is zero then
};
InverseVelocity inverse_velocity(const Jacobian& J, const Vector6& twist,
                                 const JointVector& posture);

}  // namespace surg
