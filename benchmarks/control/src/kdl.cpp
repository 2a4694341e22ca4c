// Orocos KDL: iterative inverse kinematics for the pose on the constraint, and its own velocity
// solver for our twist. KDL's chain is built from ours; start is the present posture.
#include <kdl/chain.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainiksolverpos_lma.hpp>
#include <kdl/chainiksolverpos_nr.hpp>
#include <kdl/chainiksolvervel_pinv.hpp>

#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;

KDL::Frame frame(const surg::Pose& X) {
  KDL::Frame F;
  for (int r = 0; r < 3; ++r) {
    F.p[r] = X.translation()[r];
    for (int c = 0; c < 3; ++c) F.M(r, c) = X.linear()(r, c);
  }
  return F;
}

/// KDL's segment moves first and is fixed behind: our fixed part comes first.
KDL::Chain kdl_chain(const surg::Chain& chain) {
  KDL::Chain result;
  const auto& joints = chain.joints();
  result.addSegment(KDL::Segment(KDL::Joint(KDL::Joint::Fixed), frame(joints[0].X_PJ)));
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const surg::Vector3& a = joints[i].axis;
    const surg::Pose& next = i + 1 < joints.size() ? joints[i + 1].X_PJ : chain.X_LF();
    const KDL::Joint joint(KDL::Vector::Zero(), KDL::Vector(a[0], a[1], a[2]), KDL::Joint::RotAxis);
    result.addSegment(KDL::Segment(joint, frame(next)));
  }
  return result;
}

struct Kdl : Law {
  explicit Kdl(const Scene& scene)
      : chain(kdl_chain(scene.chain)), now(chain.getNrOfJoints()), next(chain.getNrOfJoints()) {}
  KDL::Frame goal_frame(const Goal& goal) const {
    const Scene& scene = *goal.scene;
    return frame(surg::pose_on_pivot(
        scene.home, scene.tool, surg::tip_goal(scene.p_BRcm, goal.p_next, 0.0, scene.home.s_B)));
  }
  KDL::Chain chain;
  KDL::JntArray now, next;
};

struct Newton : Kdl {
  explicit Newton(const Scene& scene)
      : Kdl(scene), forward(chain), velocity(chain), solver(chain, forward, velocity) {
    name = "kdl_nr";
    what = "KDL, ChainIkSolverPos_NR (100 iterations, 1e-6)";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    now.data = q;
    if (solver.CartToJnt(now, goal_frame(goal), next) < 0) ++failures;
    return (next.data - q) / T;
  }
  KDL::ChainFkSolverPos_recursive forward;
  KDL::ChainIkSolverVel_pinv velocity;
  KDL::ChainIkSolverPos_NR solver;
};

struct Levenberg : Kdl {
  explicit Levenberg(const Scene& scene) : Kdl(scene), solver(chain, 1e-9) {
    name = "kdl_lma";
    what = "KDL, ChainIkSolverPos_LMA (500 iterations, 1e-9)";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    now.data = q;
    if (solver.CartToJnt(now, goal_frame(goal), next) < 0) ++failures;
    return (next.data - q) / T;
  }
  KDL::ChainIkSolverPos_LMA solver;
};

struct PseudoInverse : Kdl {
  explicit PseudoInverse(const Scene& scene) : Kdl(scene), solver(chain) {
    name = "kdl_velocity";
    what = "KDL, ChainIkSolverVel_pinv for the twist of our velocity form";
  }
  JointVector step(const JointVector& q, const JointVector&, const Goal& goal) override {
    const Task task = task_at(*goal.scene, q, goal);
    const surg::Vector6 twist = surg::rcm_twist(task.shaft, task.v_tip, task.roll_rate,
                                                surg::Vector3::Zero(), kRcmGain, 0.02);
    now.data = q;
    const KDL::Twist t(KDL::Vector(twist[0], twist[1], twist[2]),
                       KDL::Vector(twist[3], twist[4], twist[5]));
    if (solver.CartToJnt(now, t, next) < 0) ++failures;
    return next.data;
  }
  KDL::ChainIkSolverVel_pinv solver;
};

}  // namespace

void add_kdl(Laws& laws, const Scene& scene) {
  laws.push_back(std::make_unique<Newton>(scene));
  laws.push_back(std::make_unique<Levenberg>(scene));
  laws.push_back(std::make_unique<PseudoInverse>(scene));
}

}  // namespace bench
