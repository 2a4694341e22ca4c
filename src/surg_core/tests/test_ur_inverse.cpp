// The closed form of the UR family against forward kinematics, on chains written in any frames.
#include <algorithm>
#include <chrono>

#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/kinematics/ur_inverse.hpp"
#include "surg_core/law/exact.hpp"

namespace surg {
namespace {

using test::Random;

Vector3 random_unit(Random& random) {
  return Vector3(random.normal(), random.normal(), random.normal()).normalized();
}

Pose random_pose(Random& random) {
  Pose X = Pose::Identity();
  X.linear() = Eigen::AngleAxisd(random.uniform(-3, 3), random_unit(random)).toRotationMatrix();
  X.translation() = 0.3 * random_unit(random);
  return X;
}

/// A UR of random size with a random base, flange, zero positions and axis directions: the same
/// mechanism as its description might have it.
Chain random_ur(Random& random) {
  const Chain plain = test::ur5e_chain();
  const double size = random.uniform(0.6, 1.6);
  std::vector<Joint> joints = plain.joints();
  Pose X_LF = random_pose(random);
  for (Joint& joint : joints) joint.X_PJ.translation() *= size * random.uniform(0.8, 1.2);
  joints[0].X_PJ = random_pose(random) * joints[0].X_PJ;
  Pose C = Pose::Identity();  // of the previous joint's own frame
  for (Joint& joint : joints) {
    // Zero position moved, and the joint's frame turned by any rotation and shifted along its axis.
    const Vector3 axis = random.integer(0, 1) ? Vector3::UnitZ() : Vector3(-Vector3::UnitZ());
    Pose change = Pose::Identity();
    change.linear() = (Eigen::AngleAxisd(random.uniform(-3, 3), Vector3::UnitZ()) *
                       Eigen::AngleAxisd(random.uniform(-3, 3), random_unit(random)))
                          .toRotationMatrix();
    change.translation() = random.uniform(-0.1, 0.1) * Vector3::UnitZ();
    joint.X_PJ = C.inverse() * joint.X_PJ * change;
    joint.axis = (change.linear().transpose() * axis).normalized();
    C = change;
  }
  return Chain(joints, C.inverse() * X_LF);
}

JointVector random_joints(Random& random) {
  JointVector q(6);
  for (int i = 0; i < 6; ++i) q[i] = random.uniform(-6.2, 6.2);
  return q;
}

TEST(UrInverse, EverySolutionReachesThePoseAndOneIsWhereItCameFrom) {
  Random random(1);
  const int n = test::family(2000, 200000);
  double worst = 0, worst_return = 0;
  std::array<int, 9> counts{};
  for (int k = 0; k < n; ++k) {
    const Chain chain = k % 2 == 0 ? test::ur5e_chain() : random_ur(random);
    std::string why;
    const auto inverse = UrInverse::of(chain, &why);
    ASSERT_TRUE(inverse.has_value()) << why;
    const JointVector q = random_joints(random);
    const Pose X_BF = chain.forward(q);
    const UrSolutions found = inverse->solve_all(X_BF, q);
    ASSERT_GE(found.count, 1);
    ++counts[found.count];
    double nearest = 1e9;
    for (int i = 0; i < found.count; ++i) {
      const UrSolution& one = found.all[i];
      // At a singularity joints have no definite value; the pose is met all the same.
      const double miss = (chain.forward(one.q).matrix() - X_BF.matrix()).cwiseAbs().maxCoeff();
      worst = std::max(worst, miss);
      EXPECT_LE((one.q - q).cwiseAbs().maxCoeff(), M_PI + 1e-9);
      nearest = std::min(nearest, (one.q - q).cwiseAbs().maxCoeff());
    }
    const UrSolution same = inverse->solve(X_BF, inverse->branch(q), q);
    const double distance =
        std::min({std::abs(same.shoulder) / 0.3, std::abs(same.elbow), std::abs(same.wrist)});
    if (distance < 1e-3) continue;
    ASSERT_EQ(same.unreachable, nullptr);
    worst_return = std::max(worst_return, (same.q - q).cwiseAbs().maxCoeff());
    EXPECT_LT(nearest, 1e-9);
  }
  std::printf("pose met to %.1e, joints found again to %.1e rad; solutions 1-8:", worst,
              worst_return);
  for (int i = 1; i < 9; ++i) std::printf(" %d", counts[i]);
  std::printf("\n");
  EXPECT_LT(worst, 1e-12);
  EXPECT_LT(worst_return, 1e-8);  // a thousandth from a singularity
  EXPECT_GT(counts[8], n / 4);
  test::report("random arms and postures", n);
}

TEST(UrInverse, TheBranchesAreDifferentPostures) {
  const Chain chain = test::ur5e_chain();
  const auto inverse = UrInverse::of(chain);
  const UrSolutions found = inverse->solve_all(chain.forward(test::ur5e_home()), test::ur5e_home());
  ASSERT_EQ(found.count, 8);
  for (int i = 0; i < 8; ++i) {
    for (int k = 0; k < i; ++k) {
      EXPECT_GT((found.all[i].q - found.all[k].q).cwiseAbs().maxCoeff(), 0.05);
    }
  }
}

TEST(UrInverse, SaysWhatKeepsAPoseOutOfReach) {
  const Chain chain = test::ur5e_chain();
  const auto inverse = UrInverse::of(chain);
  const JointVector q = test::ur5e_home();
  const UrBranch branch = inverse->branch(q);
  Pose X_BF = chain.forward(q);
  X_BF.translation().x() += 2;
  EXPECT_STREQ(inverse->solve(X_BF, branch, q).unreachable, "elbow");
  // The wrist centre inside the cylinder round the base axis that the arm's width leaves out.
  X_BF = chain.forward(q);
  const Vector3 p_FWrist(0, 0, -0.0996);
  X_BF.translation() += Vector3(0.1, 0.05, 0.5) - X_BF * p_FWrist;
  EXPECT_STREQ(inverse->solve(X_BF, branch, q).unreachable, "shoulder");
  JointVector straight = q;
  straight[4] = 0;
  EXPECT_STREQ(inverse->solve(chain.forward(straight), branch, q).unreachable, "wrist");
  X_BF.translation().x() = std::nan("");
  EXPECT_NE(inverse->solve(X_BF, branch, q).unreachable, nullptr);
  EXPECT_EQ(inverse->solve_all(X_BF, q).count, 0);
}

TEST(UrInverse, RefusesOtherArmsWithAReason) {
  std::string why;
  EXPECT_FALSE(UrInverse::of(test::panda_chain(), &why));
  EXPECT_NE(why.find("7 joints"), std::string::npos);
  const struct {
    int joint;
    const char* reason;
  } cases[] = {
      {1, "axes 1 and 2"}, {2, "axes 2, 3 and 4"}, {4, "axes 4 and 5"}, {5, "axes 5 and 6"}};
  for (const auto& [joint, reason] : cases) {
    // Bent by a hundredth of a degree, as a calibrated arm is.
    std::vector<Joint> joints = test::ur5e_chain().joints();
    joints[joint].X_PJ.linear() =
        joints[joint].X_PJ.linear() *
        Eigen::AngleAxisd(1.7e-4, Vector3(1, 1, 0).normalized()).toRotationMatrix();
    const Chain bent(joints, test::ur5e_chain().X_LF());
    EXPECT_FALSE(UrInverse::of(bent, &why));
    EXPECT_NE(why.find(reason), std::string::npos) << why;
  }
  std::vector<Joint> joints = test::ur5e_chain().joints();
  joints[5].X_PJ.translation().x() += 1e-4;  // axis 6 passes axis 5
  joints[5].X_PJ.translation().y() += 1e-4;
  EXPECT_FALSE(UrInverse::of(Chain(joints, test::ur5e_chain().X_LF()), &why));
}

TEST(UrInverse, IsFasterThanTheTwoStages) {
  // The closed form is there for its speed; where it is not faster it has no business. Both in
  // turns, the quickest of many rounds, so that a loaded machine does not decide.
  const NextPose closed(test::ur5e_chain()), stages(test::ur5e_chain(), false);
  ASSERT_TRUE(closed.closed_form());
  ASSERT_FALSE(stages.closed_form());
  const JointVector q = test::ur5e_home(), none = JointVector::Zero(6);
  Pose X_goal = test::ur5e_chain().forward(q);
  double quickest[2] = {1e9, 1e9}, sum = 0;
  for (int round = 0; round < 40; ++round) {
    for (int way = 0; way < 2; ++way) {
      const NextPose& next = way == 0 ? closed : stages;
      const auto start = std::chrono::steady_clock::now();
      for (int i = 0; i < 500; ++i) {
        X_goal.translation().x() += 1e-9;
        sum += next.step(q, X_goal, none).dq[0];
      }
      const std::chrono::duration<double, std::nano> spent =
          std::chrono::steady_clock::now() - start;
      quickest[way] = std::min(quickest[way], spent.count() / 500);
    }
  }
  std::printf("joints for a pose: closed form %.0f ns, two stages %.0f ns: %.1f times\n",
              quickest[0], quickest[1], quickest[1] / quickest[0]);
  EXPECT_TRUE(std::isfinite(sum));
  EXPECT_GT(quickest[1] / quickest[0], 1.2);
}

TEST(UrInverse, LeavesTheHeapAlone) {
  if (!SURG_HEAP_IS_WATCHED) GTEST_SKIP();
  const Chain chain = test::ur5e_chain();
  const auto inverse = UrInverse::of(chain);
  const JointVector q = test::ur5e_home();
  const Pose X_BF = chain.forward(q);
  test::HeapWatch heap;
  const UrSolutions found = inverse->solve_all(X_BF, q);
  const UrSolution same = inverse->solve(X_BF, inverse->branch(q), q);
  const long calls = heap.calls();
  EXPECT_EQ(calls, 0);
  EXPECT_EQ(found.count, 8);
  EXPECT_LT((same.q - q).norm(), 1e-12);
}

}  // namespace
}  // namespace surg
