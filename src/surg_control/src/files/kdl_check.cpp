#include "surg_control/files/kdl_check.hpp"

#include <algorithm>
#include <cmath>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainjnttojacsolver.hpp>
#include <random>
#include <stdexcept>
#include <string>

namespace surg_control {
namespace {

constexpr double kAgreement = 1e-9;  // [m, rad]
constexpr int kPostures = 100;

KDL::Vector to_kdl(const surg::Vector3& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

KDL::Chain to_kdl(const std::vector<surg::UrdfJoint>& joints) {
  KDL::Chain chain;
  for (const surg::UrdfJoint& joint : joints) {
    const KDL::Frame origin(KDL::Rotation::RPY(joint.rpy.x(), joint.rpy.y(), joint.rpy.z()),
                            to_kdl(joint.xyz));
    const KDL::Joint moves =
        joint.turning()
            ? KDL::Joint(joint.name, origin.p, origin.M * to_kdl(joint.axis), KDL::Joint::RotAxis)
            : KDL::Joint(joint.name, KDL::Joint::None);
    chain.addSegment(KDL::Segment(joint.child, moves, origin));
  }
  return chain;
}

double difference_to_kdl(const surg::Chain& chain, const KDL::Chain& kdl,
                         const surg::RobotConfig& robot) {
  if (static_cast<int>(kdl.getNrOfJoints()) != chain.dof()) return HUGE_VAL;
  KDL::ChainFkSolverPos_recursive fk(kdl);
  KDL::ChainJntToJacSolver jacobian(kdl);
  KDL::JntArray q_kdl(kdl.getNrOfJoints());
  KDL::Jacobian J_kdl(kdl.getNrOfJoints());
  KDL::Frame frame;

  std::mt19937 random(20240501);  // seeded: the same postures at every start
  double worst = 0;
  surg::JointVector q(chain.dof());
  for (int k = 0; k < kPostures; ++k) {
    for (int i = 0; i < chain.dof(); ++i) {
      q[i] = std::uniform_real_distribution<>(robot.position_min[i], robot.position_max[i])(random);
      q_kdl(i) = q[i];
    }
    surg::Pose X_BF;
    surg::Jacobian J;
    chain.forward(q, X_BF, J);
    if (fk.JntToCart(q_kdl, frame) < 0 || jacobian.JntToJac(q_kdl, J_kdl) < 0) return HUGE_VAL;
    for (int row = 0; row < 3; ++row) {
      worst = std::max(worst, std::abs(X_BF.translation()[row] - frame.p[row]));
      for (int column = 0; column < 3; ++column) {
        worst = std::max(worst, std::abs(X_BF.linear()(row, column) - frame.M(row, column)));
      }
    }
    const double difference = (J - J_kdl.data).cwiseAbs().maxCoeff();
    // Written so that a NaN on either side counts as the worst and not as agreement.
    if (!(difference <= worst)) worst = difference;
    if (!X_BF.matrix().allFinite() || !J.allFinite()) return HUGE_VAL;
  }
  return worst;
}

void check_against_kdl(const surg::RobotConfig& robot) {
  const surg::Model model = surg::load_model(robot);  // as drawn: KDL gets the drawing, too
  const double difference = difference_to_kdl(model.chain, to_kdl(model.joints), robot);
  if (difference <= kAgreement) return;
  throw std::runtime_error(surg::urdf_of(robot) + ": our chain and KDL's differ by " +
                           std::to_string(difference) +
                           " (allowed: 1e-9): an error of this program; please report the file");
}

}  // namespace surg_control
