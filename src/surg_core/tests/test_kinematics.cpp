#include <Eigen/SVD>
#include <stdexcept>
#include <vector>

#include "support/test_support.hpp"
#include "surg_core/kinematics/kinematics.hpp"

namespace surg {
namespace {

using test::Random;

Vector3 random_unit(Random& random) {
  Vector3 v(random.normal(), random.normal(), random.normal());
  return v.normalized();
}

Pose random_pose(Random& random) {
  Pose X = Pose::Identity();
  X.linear() = Eigen::AngleAxisd(random.uniform(-3.1, 3.1), random_unit(random)).toRotationMatrix();
  X.translation() = 0.4 * Vector3(random.normal(), random.normal(), random.normal());
  return X;
}

Chain random_chain(Random& random, int n) {
  std::vector<Joint> joints;
  for (int i = 0; i < n; ++i) {
    joints.push_back({"j" + std::to_string(i), random_pose(random), random_unit(random)});
  }
  return Chain(joints, random_pose(random));
}

JointVector random_joints(Random& random, int n) {
  JointVector q(n);
  for (int i = 0; i < n; ++i) q[i] = random.uniform(-3.1, 3.1);
  return q;
}

// Oracle: homogeneous matrices and Rodrigues' formula written out.
Eigen::Matrix4d product_of_matrices(const Chain& chain, const JointVector& q) {
  Eigen::Matrix4d X = Eigen::Matrix4d::Identity();
  for (int i = 0; i < chain.dof(); ++i) {
    const Joint& joint = chain.joints()[i];
    Matrix3 K;
    K << 0, -joint.axis.z(), joint.axis.y(), joint.axis.z(), 0, -joint.axis.x(), -joint.axis.y(),
        joint.axis.x(), 0;
    Eigen::Matrix4d turn = Eigen::Matrix4d::Identity();
    turn.topLeftCorner<3, 3>() =
        Matrix3::Identity() + std::sin(q[i]) * K + (1 - std::cos(q[i])) * K * K;
    X = X * joint.X_PJ.matrix() * turn;
  }
  return X * chain.X_LF().matrix();
}

// Rotation vector of a small rotation.
Vector3 small_rotation(const Matrix3& R) {
  return 0.5 * Vector3(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
}

TEST(Chain, ForwardIsTheProductOfTheMatrices) {
  Random random(1);
  const int count = test::family(500, 20000);
  double worst = 0;
  for (int k = 0; k < count; ++k) {
    const Chain chain = random_chain(random, random.integer(1, kMaxJoints));
    const JointVector q = random_joints(random, chain.dof());
    const Pose X = chain.forward(q);
    worst = std::max(worst, (X.matrix() - product_of_matrices(chain, q)).cwiseAbs().maxCoeff());
    const auto [X_also, J] = chain.flange(q);
    ASSERT_EQ(X.matrix(), X_also.matrix());
    ASSERT_EQ(J.cols(), chain.dof());
  }
  EXPECT_LT(worst, 1e-12);
  test::report("random chains", count);
}

TEST(Chain, TurnsByAnyAngleToRounding) {
  // The joints' sines are the chain's own: against the library's, at every size of angle, close to
  // the quarter turns too, and where nothing can be said.
  Random random(5);
  std::vector<Joint> joints(1);
  const Chain chain(joints, Pose::Identity());
  const int n = test::family(2000, 200000);
  double worst = 0;
  for (double range : {1e-9, 0.1, 3.2, 7.0, 900.0, 1e6}) {
    for (int i = 0; i < n; ++i) {
      JointVector q(1);
      q[0] = random.uniform(-range, range);
      if (i % 3 == 0) q[0] = std::round(q[0] / (M_PI / 2)) * (M_PI / 2) + 1e-9 * random.normal();
      const Matrix3 R = chain.forward(q).linear();
      worst = std::max({worst, std::abs(R(0, 0) - std::cos(q[0])), std::abs(R(1, 1) - R(0, 0)),
                        std::abs(R(1, 0) - std::sin(q[0])), std::abs(R(0, 1) + R(1, 0))});
    }
  }
  test::report("turns", 6L * n);
  EXPECT_LT(worst, 1e-15);
  for (const double bad : {double{NAN}, double{INFINITY}, -double{INFINITY}}) {
    JointVector q(1);
    q[0] = bad;
    EXPECT_FALSE(chain.forward(q).matrix().allFinite());
  }
}

TEST(Chain, JacobianIsTheDerivativeOfForward) {
  Random random(2);
  const int count = test::family(300, 10000);
  const double h = 1e-6;
  double worst = 0;
  for (int k = 0; k < count; ++k) {
    const Chain chain = random_chain(random, random.integer(6, kMaxJoints));
    const JointVector q = random_joints(random, chain.dof());
    const auto [X, J] = chain.flange(q);
    for (int i = 0; i < chain.dof(); ++i) {
      JointVector below = q, above = q;
      below[i] -= h;
      above[i] += h;
      const Pose X_below = chain.forward(below), X_above = chain.forward(above);
      Vector6 column;
      column.head<3>() = (X_above.translation() - X_below.translation()) / (2 * h);
      column.tail<3>() = small_rotation(X_above.linear() * X_below.linear().transpose()) / (2 * h);
      worst = std::max(worst, (column - J.col(i)).cwiseAbs().maxCoeff());
    }
  }
  EXPECT_LT(worst, 1e-8);
  test::report("random postures", count);
}

// Oracle: central differences of the Jacobian along the joint motion.
TEST(Chain, BiasAccelerationIsTheDerivativeOfTheTwist) {
  Random random(8);
  for (int trial = 0; trial < 200; ++trial) {
    const int n = random.integer(1, kMaxJoints);
    const Chain chain = random_chain(random, n);
    const JointVector q = random_joints(random, n), qd = random_joints(random, n);
    Pose X;
    Jacobian J, before, after;
    chain.forward(q, X, J);
    const double h = 1e-5;
    chain.forward(q - h * qd, X, before);
    chain.forward(q + h * qd, X, after);
    const Vector6 change = (after - before) * qd / (2 * h);
    EXPECT_LT((bias_acceleration(J, qd) - change).norm(), 1e-6 * (1 + change.norm()));
  }
}

TEST(Chain, RefusesWhatIsNoChain) {
  const Pose I = Pose::Identity();
  EXPECT_THROW(Chain({}, I), std::invalid_argument);
  EXPECT_THROW(Chain(std::vector<Joint>(kMaxJoints + 1), I), std::invalid_argument);
  EXPECT_NO_THROW(Chain(std::vector<Joint>(kMaxJoints), I));
  EXPECT_THROW(Chain({{"long axis", I, Vector3(0, 0, 2)}}, I), std::invalid_argument);
  EXPECT_THROW(Chain({{"no axis", I, Vector3(0, 0, NAN)}}, I), std::invalid_argument);
  Pose broken = I;
  broken.translation().x() = NAN;
  EXPECT_THROW(Chain({{"nan", broken, Vector3::UnitZ()}}, I), std::invalid_argument);
  EXPECT_THROW(Chain({{"fine", I, Vector3::UnitZ()}}, broken), std::invalid_argument);
  Pose mirror = I;
  mirror.linear()(0, 0) = -1;
  EXPECT_THROW(Chain({{"mirror", mirror, Vector3::UnitZ()}}, I), std::invalid_argument);
}

TEST(InverseVelocity, GivesTheTwistAndTheLeastMotionTowardsThePosture) {
  Random random(3);
  const int count = test::family(1000, 30000);
  double worst_twist = 0, worst_posture = 0;
  for (int k = 0; k < count; ++k) {
    const int n = random.integer(6, kMaxJoints);
    const Chain chain = random_chain(random, n);
    const auto [X, J] = chain.flange(random_joints(random, n));
    const Eigen::MatrixXd full = J;
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(full, Eigen::ComputeThinU | Eigen::ComputeThinV);
    const Eigen::VectorXd sigma = svd.singularValues();
    if (sigma[5] < 0.01 * sigma[0]) continue;
    Vector6 twist;
    for (int i = 0; i < 6; ++i) twist[i] = random.normal();
    const JointVector posture = random_joints(random, n);
    const InverseVelocity inverse = inverse_velocity(J, twist, posture);
    ASSERT_EQ(inverse.qd.size(), n);
    EXPECT_GT(inverse.conditioning, 1e-5);
    EXPECT_LE(inverse.conditioning, 1.0);
    worst_twist = std::max(worst_twist, (full * inverse.qd - twist).norm());
    // Oracle: pseudo-inverse from the singular values.
    const Eigen::MatrixXd pseudo =
        svd.matrixV() * sigma.cwiseInverse().asDiagonal() * svd.matrixU().transpose();
    const Eigen::VectorXd expected =
        pseudo * twist + (Eigen::MatrixXd::Identity(n, n) - pseudo * full) * posture;
    worst_posture = std::max(worst_posture, (inverse.qd - expected).norm());
  }
  EXPECT_LT(worst_twist, 1e-9);
  EXPECT_LT(worst_posture, 1e-8);
  test::report("random Jacobians", count);
}

TEST(InverseVelocity, StandsStillWhereTheJacobianIsSingular) {
  for (int n : {6, 7, 8}) {
    Jacobian J = Jacobian::Zero(6, n);
    for (int i = 0; i < 5; ++i) J(i, i) = 1;  // nothing moves along the last row
    const JointVector posture = JointVector::Ones(n);
    const InverseVelocity inverse = inverse_velocity(J, Vector6::Ones(), posture);
    EXPECT_EQ(inverse.conditioning, 0);
    EXPECT_EQ(inverse.qd, JointVector::Zero(n));
  }
}

TEST(InverseVelocity, StandsStillForWhatIsNotFiniteOrNotSupported) {
  Jacobian J = Jacobian::Zero(6, 6);
  J.setIdentity();
  const JointVector rest = JointVector::Zero(6);
  Vector6 twist = Vector6::Ones();
  twist[3] = NAN;
  EXPECT_EQ(inverse_velocity(J, twist, rest).qd, rest);
  EXPECT_EQ(inverse_velocity(J, twist, rest).conditioning, 0);
  J(2, 2) = NAN;
  EXPECT_EQ(inverse_velocity(J, Vector6::Ones(), rest).qd, rest);
  const Jacobian few = Jacobian::Ones(6, 5);
  EXPECT_EQ(inverse_velocity(few, Vector6::Ones(), JointVector::Zero(5)).qd, JointVector::Zero(5));
}

TEST(Kinematics, TheHeapWatchSeesTheHeap) {
  if (!SURG_HEAP_IS_WATCHED) GTEST_SKIP() << "the heap cannot be watched in this build";
  test::HeapWatch heap;
  Eigen::VectorXd* vector = new Eigen::VectorXd(100);
  EXPECT_GE(heap.calls(), 2);
  delete vector;
}

}  // namespace
}  // namespace surg
