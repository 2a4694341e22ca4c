// The laws as a limited step sees them: how alpha moves the joints. Three laws: exact form,
// velocity form, and the recorded trace backwards.
#pragma once

#include <algorithm>

#include "kinematics/jacobian_inverse.hpp"
#include "surg_core/limits/barrier.hpp"
#include "surg_core/limits/limited_step.hpp"

namespace surg {

constexpr double kTwistSpacing = 1e-4;     ///< [s] of the clock, for a path's direction
constexpr double kPlanAcceleration = 0.8;  ///< of the limits: the step keeps reserves to follow
constexpr double kOnPivot = 1e-12;         ///< [m]
constexpr double kFirstArc = 0.002;        ///< [rad] to the first node, and beside a guess, at most

inline double largest(const Joints& v) { return v.cwiseAbs().maxCoeff(); }
/// [1/s] hardest braking of the clock that a plan has, where its full rate moves the joints by qd.
template <typename Velocities>
double clock_braking(const Velocities& qd, const JointVector& acceleration) {
  double braking = INFINITY;
  for (Eigen::Index i = 0; i < acceleration.size(); ++i) {
    const double speed = std::max(std::abs(qd[i]), 1e-9);
    braking = std::min(braking, kPlanAcceleration * acceleration[i] / speed);
  }
  return braking;
}

/// Where the arm is at the beginning of the cycle.
struct LimitedStep::Here {
  Eigen::Index n;  ///< joints
  Joints q, qd_last;
  Pose X_BF;
  Jacobian J;
  ShaftState shaft;
  double flange_velocity = 0;    ///< [m/s] what there is of the limit
  Joints room = Joints::Zero();  ///< [rad/s] that the follower's correction wants to change by
};

/// q_dot(alpha) to first order. 'back' is the part of the correction that may be delayed.
struct LimitedStep::Affine {
  Joints qd0, qd1;
  Joints tangent;  ///< d q / d clock at the beginning
  Joints back;
  Vector6 twist;  ///< of the flange, by qd1
  Vector6 bias;   ///< flange's acceleration at constant joint velocities qd1 (J_dot qd1)
  Joints qdd = Joints::Zero();   ///< J^-1 bias, exact form only; zero next to a singularity
  SingularityMeasures measures;  ///< here, where the barrier applies
  double secant = 0;             ///< [s] of the clock that qd1 spans; 0: tells no bend
  bool returning = false;        ///< 'back' is not zero
  bool moves = false;            ///< the path is not at rest
  bool regular = true;           ///< J could be inverted

  /// Clock rate expected from the arm's momentum. qd1 is the secant of the path over that part of
  /// the cycle: the secant over the whole cycle would miss a curved path by more than the joints
  /// can brake.
  double expected(const Joints& qd_last, double T) const;
};

/// A point of the path ahead.
struct LimitedStep::Node {
  Joints q, direction;  ///< direction: d q / d clock
  SingularityMeasures measures;
  double flange = 0;  ///< [m/s] speed of its origin at full clock
};

/// The largest allowed alpha, and the limit that sets it.
struct LimitedStep::Cap {
  double alpha = 1;
  const char* by = "";

  void limit(double lower, const char* reason) {
    if (!(lower < alpha)) return;
    alpha = std::max(lower, 0.0);
    by = reason;
  }
};

/// A law at the beginning of a cycle.
class LimitedStep::Law {
 public:
  Law(const LimitedStep& self, const Here& here) : self_(self), here_(here) {}
  virtual ~Law() = default;

  virtual Affine affine() const = 0;
  /// The step without linearisation, near the linear one qd. beta: share of the way back to the
  /// path.
  virtual Joints finish(const Affine& affine, double alpha, double beta,
                        const Joints& qd) const = 0;
  /// Rows of the pivot at the end of a cycle with qd: J qd' = J qd + e puts it on the trocar.
  virtual RcmRows rows(const Joints& qd) const = 0;
  virtual Vector3 p_BRcm() const = 0;
  /// [s] of the clock to look ahead; 0: none.
  virtual double horizon() const = 0;
  /// The path at t [s] of the clock, near the joints 'guess', 'arc' [rad] from the node before;
  /// false where it cannot be followed.
  virtual bool node(double t, const Joints& guess, double arc, Node& node) const = 0;
  /// Whether the singularity barrier applies.
  virtual bool has_barrier() const { return true; }

 protected:
  /// A node by its flange pose, and the pose kTwistSpacing later.
  bool pose_node(const Joints& guess, const Pose& pose, const Pose& later, double arc,
                 Node& node) const;
  /// Rows of the pivot's point on the shaft after qd, in velocities.
  RcmRows rows_after(const Joints& qd, const Vector3& p_BRcm) const;
  Joints gentle(const JointVector& posture) const;

  const LimitedStep& self_;
  const Here& here_;
};

/// The exact form: joints of a pose that is on the constraint by construction.
class LimitedStep::ExactLaw : public Law {
 public:
  ExactLaw(const LimitedStep& self, const Here& here, const Home& home, const StepRequest& request);

  Affine affine() const override;
  Joints finish(const Affine& affine, double alpha, double beta, const Joints& qd) const override;
  RcmRows rows(const Joints& qd) const override { return rows_after(qd, p_BRcm()); }
  Vector3 p_BRcm() const override { return p_BRcm_; }
  double horizon() const override { return request_.path ? request_.horizon : 0.0; }
  bool node(double t, const Joints& guess, double arc, Node& node) const override;

 private:
  void measure_displacement(const ShaftGoal& goal);
  Pose pose(double t, double keep) const;

  const Home& home_;
  const StepRequest& request_;
  Inverse inverse_;  ///< of the Jacobian here
  Vector3 p_BRcm_;
  Vector6 to_0_;  ///< flange's displacement to the path now, of which 'keep_' is left
  /// The tip's displacement off its path: of the shaft, as rotation vector; of depth and roll.
  Vector3 off_swing_ = Vector3::Zero();
  double off_depth_ = 0, off_roll_ = 0;
  double keep_ = 0;  ///< share of it that is left after this cycle
  bool returning_ = false;
  mutable double end_at_ = -1;  ///< [s] of the clock, where 'affine' expects the cycle to end
  mutable Pose end_;            ///< and the path is then
};

/// The velocity form: a twist, linear in alpha.
class LimitedStep::VelocityLaw : public Law {
 public:
  VelocityLaw(const LimitedStep& self, const Here& here, const Home& home,
              const StepRequest& request)
      : Law(self, here), home_(home), request_(request), rows_(rcm_rows(here.J, here.shaft)) {}

  Affine affine() const override;
  Joints finish(const Affine&, double, double, const Joints& qd) const override { return qd; }
  RcmRows rows(const Joints& qd) const override;
  Vector3 p_BRcm() const override { return here_.shaft.p_BNear + here_.shaft.e; }
  double horizon() const override { return request_.path ? request_.horizon : 0.0; }
  bool node(double t, const Joints& guess, double arc, Node& node) const override;

 private:
  Vector3 feedback_at_pivot() const;

  const Home& home_;
  const StepRequest& request_;
  RcmRows rows_;
};

/// The recorded joint path backwards, put back on the pivot by its own rows alone: no inverse of J,
/// so no singularity can stop it.
class LimitedStep::RetraceLaw : public Law {
 public:
  RetraceLaw(const LimitedStep& self, const Here& here, const JointTrace& trace, double back,
             double rate, const Vector3& p_BRcm);

  Affine affine() const override;
  Joints finish(const Affine&, double alpha, double beta, const Joints&) const override;
  RcmRows rows(const Joints& qd) const override { return rows_after(qd, p_BRcm_); }
  Vector3 p_BRcm() const override { return p_BRcm_; }
  double horizon() const override { return kHorizon; }
  bool node(double t, const Joints&, double, Node& node) const override;
  bool has_barrier() const override { return false; }

 private:
  Joints on_pivot(Joints q) const;

  const JointTrace& trace_;
  double back_, rate_;
  Vector3 p_BRcm_;
  Joints at_0_, off_;
  double keep_ = 0;
};

}  // namespace surg
