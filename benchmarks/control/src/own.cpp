// The forms of surg_core.
#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;
using surg::Vector3;

surg::ShaftGoal goal_at(const Scene& scene, const Vector3& p_BTip) {
  return surg::tip_goal(scene.p_BRcm, p_BTip, 0.0, scene.home.s_B);
}

/// One step of Newton's method to a pose a few milliradians away [rad].
JointVector newton(const Scene& scene, const JointVector& q, const surg::Pose& X_goal,
                   const JointVector& posture) {
  surg::Pose X_BF;
  surg::Jacobian J;
  scene.chain.forward(q, X_BF, J);
  Vector3 turn = Vector3::Zero();  // twice the sine of the angle
  for (int i = 0; i < 3; ++i) {
    turn += Vector3(X_BF.linear().col(i)).cross(Vector3(X_goal.linear().col(i)));
  }
  surg::Vector6 twist;
  twist << X_goal.translation() - X_BF.translation(), 0.5 * turn;
  return surg::inverse_velocity(J, twist, posture).qd;
}

/// The exact form without limits, a prediction and a correction: surg_core/law/exact.hpp.
struct Exact : Law {
  Exact() {
    name = "exact";
    what = "surg_core, exact form: next pose on the constraint, two Newton stages";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    const Scene& scene = *goal.scene;
    const surg::Pose X_BF =
        surg::pose_on_pivot(scene.home, scene.tool, goal_at(scene, goal.p_next));
    const JointVector none = JointVector::Zero(q.size());
    JointVector posture = none;
    if (q.size() > 6) posture = kPostureGain * T * (scene.q_home - q);
    const JointVector dq = newton(scene, q, X_BF, posture);
    return (dq + newton(scene, q + dq, X_BF, none)) / T;
  }
};

/// Flange twist with lateral feedback, then the inverse: surg_core/rcm.hpp.
struct Velocity : Law {
  Velocity() {
    name = "velocity";
    what = "surg_core, velocity form with lateral feedback";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    const Task task = task_at(*goal.scene, q, goal);
    const surg::Vector6 twist =
        surg::rcm_twist(task.shaft, task.v_tip, task.roll_rate, Vector3::Zero(), kRcmGain, 0.02);
    return surg::inverse_velocity(task.J, twist, task.posture).qd;
  }
};

/// Equations (1)-(7) as printed: no feedback at all.
struct Paper : Law {
  Paper() {
    name = "paper";
    what = "surg_core, the paper's Cartesian law as printed, open loop";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    const Scene& scene = *goal.scene;
    surg::Pose X_BF;
    surg::Jacobian J;
    scene.chain.forward(q, X_BF, J);
    const surg::Vector6 twist =
        surg::paper_cartesian_twist(X_BF.translation(), X_BF * scene.tool.p_FTip, scene.p_BRcm,
                                    (goal.p_next - goal.p_now) / T, 0.0);
    return surg::inverse_velocity(J, twist, JointVector::Zero(q.size())).qd;
  }
};

/// The exact form inside every joint limit: surg_core/limited_step.hpp.
struct Limited : Law {
  Limited(const Scene& scene, double horizon)
      : limited(scene.chain, scene.tool, scene.limits, T), horizon(horizon) {
    name = horizon > 0 ? "limited_preview" : "limited";
    what = horizon > 0 ? "surg_core, the same with preview of the path"
                       : "surg_core, exact form inside every limit";
  }
  JointVector step(const JointVector& q, const JointVector& qd_last, const Goal& goal) override {
    const Scene& scene = *goal.scene;
    const auto path = [&](double t) { return goal_at(scene, scene.tip((clock + t / T) * T)); };
    surg::StepRequest request;
    request.path = surg::PathView(path);
    request.horizon = horizon;
    request.posture = JointVector::Zero(q.size());
    if (q.size() > 6) request.posture = kPostureGain * (scene.q_home - q);
    const surg::Step result = limited.exact(q, qd_last, scene.home, request);
    if (result.alpha < 1) ++failures;
    clock += result.alpha;
    return result.qd;
  }
  surg::LimitedStep limited;
  double horizon;
  double clock = 0;  // [cycles] of the path: limits slow it down
};

}  // namespace

void add_own(Laws& laws, const Scene& scene) {
  laws.push_back(std::make_unique<Exact>());
  laws.push_back(std::make_unique<Velocity>());
  laws.push_back(std::make_unique<Paper>());
  laws.push_back(std::make_unique<Limited>(scene, 0.0));
  laws.push_back(std::make_unique<Limited>(scene, 0.45));
}

}  // namespace bench
