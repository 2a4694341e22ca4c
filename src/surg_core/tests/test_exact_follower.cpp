// The follower joint by joint: what a measured lag is worth, what it bears, what it keeps.
#include <algorithm>
#include <cmath>
#include <utility>

#include "support/lagging_arm.hpp"
#include "support/measured_follower.hpp"
#include "support/test_arm.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using test::LaggingArm;
using test::MeasuredFollower;
using test::Random;

constexpr double kT = 0.002;

/// Six joints that all have one lag [s].
JointVector alike(double lag) { return JointVector::Constant(6, lag); }

/// Six joints swinging at paces of their own.
JointVector swing(double t, double size) {
  JointVector q(6);
  for (int i = 0; i < 6; ++i) q[i] = size * (1 - std::cos((1.0 + 0.4 * i) * t));
  return q;
}

/// Follows the swing; returns the largest distance to the reference in the last third.
double follow(MeasuredFollower& follower, LaggingArm& arm, double seconds, double size) {
  double worst = 0;
  const long end = std::lround(seconds / kT);
  for (long i = 0; i < end; ++i) {
    const JointVector dq = swing((i + 1) * kT, size) - swing(i * kT, size);
    arm.obey(follower.advance(dq, arm.measured()));
    if (i > end * 2 / 3) worst = std::max(worst, follower.tracking_error(arm.truth()));
  }
  return worst;
}

TEST(ExactFollower, GoesWithAnIdealArmWithoutACorrection) {
  MeasuredFollower follower(6, {{}, 50, kT});
  JointVector q = swing(0, 0.1);
  follower.reset(q);
  for (int i = 0; i < 1000; ++i) {
    const JointVector dq = swing((i + 1) * kT, 0.1) - swing(i * kT, 0.1);
    const JointVector qd = follower.advance(dq, q);
    EXPECT_LT((qd - dq / kT).cwiseAbs().maxCoeff(), 1e-9);
    q += kT * qd;
    EXPECT_LT(follower.tracking_error(q), 1e-12);
  }
  EXPECT_LT(follower.lag().maxCoeff(), 1e-6);
}

TEST(ExactFollower, FollowsAtTheLagThatIsMeasured) {
  Random random(1);
  const int n = test::family(5, 100);
  double worst = 0, worst_gain = 1e9;
  for (int k = 0; k < n; ++k) {
    LaggingArm arm(swing(0, 0.2), random), twin = arm;
    const ExactFollower::Options stated{alike(random.uniform(0.008, 0.018)), 50, kT};
    MeasuredFollower measuring(6, stated), stubborn(6, stated, false);
    measuring.reset(arm.measured());
    stubborn.reset(arm.measured());
    const double left = follow(measuring, arm, 10, 0.2), before = follow(stubborn, twin, 10, 0.2);
    for (int i = 0; i < 6; ++i) {  // 2 ms of delay belong to it
      worst = std::max(worst, std::abs(measuring.lag()[i] - (arm.tau()[i] + 0.002)));
    }
    EXPECT_EQ(stubborn.lag(), stated.servo);
    worst_gain = std::min(worst_gain, before / left);
  }
  std::printf("lags measured to %.2f ms; what is left shrinks at least %.1f times\n", 1e3 * worst,
              worst_gain);
  EXPECT_LT(worst, 0.0003);
  EXPECT_GT(worst_gain, 2.5);
  test::report("random arms", n);
}

/// A link that stands for 40 ms, then goes on by as much later.
TEST(ExactFollower, AnArmThatIsLateOnItsWayIsNotPulledOffIt) {
  ExactFollower follower(6, {alike(0.0), 50, kT});
  JointVector q = swing(0, 0.2);
  follower.reset(q);
  double behind = 0, aside = 0, least = 1;
  for (int i = 0; i < 1000; ++i) {
    const bool stands = i >= 300 && i < 320;
    const JointVector way = swing(i * kT, 0.2) - q;
    const JointVector rate = swing((i + 1) * kT, 0.2) - swing(i * kT, 0.2);
    const JointVector qd = follower.advance(rate, q);
    if (i > 330 && i < 380) {  // what the correction does besides hurrying along the way
      const JointVector pull = qd - rate / kT;
      aside = std::max(aside, (pull - rate * (pull.dot(rate) / rate.squaredNorm())).norm());
    }
    behind = std::max(behind, way.norm() / (rate.norm() / kT));
    least = std::min(least, follower.flange_share());
    if (!stands) q += kT * qd;
  }
  std::printf("late by %.0f ms, pulled aside by %.3f rad/s, flange %.2f\n", 1e3 * behind, aside,
              least);
  EXPECT_GT(behind, 0.03);
  EXPECT_LT(aside, 0.1);
  EXPECT_NEAR(least, 0.6, 0.01);  // meanwhile the flange is slow
  EXPECT_LT((follower.expected() - q).norm(), 1e-3);
}

TEST(ExactFollower, OneStuckJointDoesNotHoldTheOthersBack) {
  const JointVector velocity = JointVector::Constant(6, 0.5);
  const JointVector acceleration = JointVector::Constant(6, 3);
  ExactFollower follower(6, {alike(0.012), 50, kT, velocity, acceleration});
  JointVector q = JointVector::Zero(6);
  q[1] = 0.001;
  follower.reset(JointVector::Zero(6));
  for (int i = 0; i < 3000; ++i) {
    q[0] = 0.05;  // a joint that does not move
    q += kT * follower.advance(JointVector::Zero(6), q);
  }
  EXPECT_LT(std::abs(q[1]), 1e-5);
}

TEST(ExactFollower, JointsFarFromTheReferenceReturnByOneFactor) {
  // Each at its own fastest they would leave the straight way back, and with it the pivot.
  const JointVector acceleration = (JointVector(6) << 40, 7.5, 10, 3, 20, 15).finished();
  const JointVector velocity = JointVector::Constant(6, 3);
  const JointVector off = (JointVector(6) << 0.02, -0.03, 0.01, 0.02, -0.01, 0.04).finished();
  ExactFollower follower(6, {alike(0.012), 50, kT, velocity, acceleration});
  follower.reset(JointVector::Zero(6));
  JointVector q = off;
  double aside = 0;
  for (int i = 0; i < 1000; ++i) {
    q += kT * follower.advance(JointVector::Zero(6), q);
    aside = std::max(aside, (q - off * (q.dot(off) / off.squaredNorm())).norm());
  }
  EXPECT_LT(aside, 1e-9);
  EXPECT_LT(q.norm(), 1e-6);
}

TEST(ExactFollower, FeedbackThatDoesNotFitIsScaledForAllJointsAlike) {
  // The first joint's reference leaves 1 % of its limit.
  const JointVector acceleration = (JointVector(6) << 40, 7.5, 10, 3, 20, 15).finished();
  const JointVector used = (JointVector(6) << 0.99, 0.5, -0.4, 0.3, -0.6, 0.2).finished();
  ExactFollower follower(6, {alike(0.012), 50, kT, JointVector::Constant(6, 3), acceleration});
  follower.reset(JointVector::Zero(6));
  const JointVector v = kT * used.cwiseProduct(acceleration), behind = alike(-5e-5);
  const JointVector pulled = follower.advance(kT * v, behind) - v;
  EXPECT_NEAR(pulled[0], 0.01 * kT * acceleration[0], 1e-8);
  EXPECT_LT((pulled - alike(pulled[0])).cwiseAbs().maxCoeff(), 1e-9);
}

/// Joints left behind, such as by a link that stood still, are pulled back: that adds to a
/// reference near the flange's limit.
TEST(ExactFollower, APullBackKeepsTheFlangesSpeedAndTheJointsAcceleration) {
  Random random(9);
  const Chain chain = test::ur5e_chain();
  const int n = test::family(200, 20000);
  constexpr double kLimit = 0.25;
  long at_limit = 0;
  for (int run = 0; run < n; ++run) {
    JointVector q(6), way(6);
    for (int i = 0; i < 6; ++i) q[i] = random.uniform(-2, 2), way[i] = random.uniform(-1, 1);
    const auto [X, J] = chain.flange(q);
    way *= random.uniform(0, 0.97) * kLimit / (J * way).head<3>().norm();
    const JointVector most = JointVector::Constant(6, 15.0);
    ExactFollower follower(6, {alike(0.012), 50, kT, JointVector::Constant(6, 3.0), most, kLimit});
    if (way.cwiseAbs().maxCoeff() > 3) continue;
    follower.reset(q + 0.1 * way, way);
    JointVector last = way;
    for (int k = 0; k < 40; ++k) {  // the arm stays where it is
      const JointVector qd = follower.advance(kT * way, q, J);
      ASSERT_LE((J * qd).head<3>().norm(), kLimit * (1 + 1e-9)) << "run " << run << " cycle " << k;
      ASSERT_LE((qd - last).cwiseAbs().maxCoeff(), 15.0 * kT * (1 + 1e-9));
      at_limit += (J * qd).head<3>().norm() > (1 - 1e-9) * kLimit;
      last = qd;
    }
  }
  EXPECT_GT(at_limit, n);
  test::report("cycles at the limit", at_limit);
}

TEST(ExactFollower, TheCommandKeepsTheLimitsWhateverIsMeasured) {
  const double most_v = 3, most_a = 15;
  Random random(3);
  const int n = test::family(20000, 2000000);
  ExactFollower follower(6, {alike(0.012), 50, kT, JointVector::Constant(6, most_v),
                             JointVector::Constant(6, most_a)});
  JointVector v = JointVector::Zero(6), last = v, q = v;
  follower.reset(q);
  double fastest = 0, steepest = 0;
  JointVector wild = JointVector::Zero(6);
  for (int k = 0; k < n; ++k) {
    if (k % 300 == 0) {  // long enough for the correction to meet its bound
      for (int i = 0; i < 6; ++i) wild[i] = random.uniform(-0.1, 0.1);
    }
    if (k % 1000 == 999) {  // taken over anew: the command starts from rest
      follower.reset(q);
      v.setZero();
      last.setZero();
    }
    for (int i = 0; i < 6; ++i) {
      const double jump = 0.8 * most_a * kT * random.uniform(-1, 1);
      v[i] = std::clamp(v[i] + jump, -0.8 * most_v, 0.8 * most_v);
      q[i] = follower.reference()[i] + wild[i] + random.uniform(-0.01, 0.01);
    }
    const JointVector qd = follower.advance(kT * v, q);
    fastest = std::max(fastest, qd.cwiseAbs().maxCoeff());
    steepest = std::max(steepest, (qd - last).cwiseAbs().maxCoeff() / kT);
    last = qd;
  }
  EXPECT_LE(fastest, most_v * (1 + 1e-12));
  EXPECT_LE(steepest, most_a * (1 + 1e-9));
  EXPECT_GT(steepest, 0.9 * most_a);  // the bounds were needed
  test::report("cycles", n);
}

TEST(ExactFollower, IsStableWithTwiceTheLagItWasTold) {
  Random random(2);
  const int n = test::family(5, 100);
  for (int k = 0; k < n; ++k) {
    for (const bool measures : {false, true}) {
      LaggingArm arm(swing(0, 0), random, 0.016, 0.024);
      MeasuredFollower follower(6, {alike(0.012), 50, kT}, measures);
      follower.reset(JointVector::Constant(6, 0.01));  // a step of 10 mrad to make up
      for (int i = 0; i < 1000; ++i) {
        arm.obey(follower.advance(JointVector::Zero(6), arm.measured()));
      }
      EXPECT_LT(follower.tracking_error(arm.truth()), 2e-5);
    }
  }
  test::report("slow arms", n);
}

/// Lags of six joints [s]: each random, its servo's time constant and 2 ms of delay.
JointVector random_lags(Random& random) {
  JointVector lags(6);
  for (int i = 0; i < 6; ++i) lags[i] = 0.002 + random.uniform(0.004, 0.010);
  return lags;
}

TEST(ExactFollower, JointsOfMeasuredLagsMoveInStep) {
  // The same hand-like motion for every joint: what differs between them moves the pivot.
  Random random(4);
  const int n = test::family(10, 200);
  double worst = 0, worst_gain = 1e9;
  for (int k = 0; k < n; ++k) {
    const JointVector lags = random_lags(random);
    const JointVector tau = lags.array() - 0.002;
    double spread[2] = {0, 0};
    for (const bool measures : {false, true}) {
      MeasuredFollower follower(6, {alike(lags.maxCoeff()), 50, kT}, measures);
      LaggingArm arm(JointVector::Zero(6), tau);
      follower.reset(arm.measured());
      double q_ref = 0;
      for (int i = 0; i < 4000; ++i) {
        const double t = (i + 1) * kT;
        const double next = 0.05 * (1 - std::cos(3 * t)) + 0.03 * std::sin(t) * std::sin(17 * t);
        arm.obey(follower.advance(JointVector::Constant(6, next - q_ref), arm.measured()));
        q_ref = next;
        const JointVector& q = arm.truth();
        if (i < 2000) continue;
        spread[measures] = std::max(spread[measures], q.maxCoeff() - q.minCoeff());
      }
    }
    worst = std::max(worst, spread[1]);
    worst_gain = std::min(worst_gain, spread[0] / spread[1]);
  }
  std::printf("joints are apart by %.1f urad at most, %.1f times less than with one lag\n",
              1e6 * worst, worst_gain);
  EXPECT_LT(worst, 60e-6);
  EXPECT_GT(worst_gain, 8);
  test::report("random arms", n);
}

TEST(ExactFollower, KnownLagsNeverAskForMoreThanTheReference) {
  Random random(5);
  const int n = test::family(20000, 1000000);
  ExactFollower follower(6, {random_lags(random), 0, kT});  // the feed-forward alone
  JointVector v = JointVector::Zero(6), last = v;
  follower.reset(v);
  double fastest = 0, steepest = 0;
  for (int k = 0; k < n; ++k) {
    for (int i = 0; i < 6; ++i) {
      v[i] = std::clamp(v[i] + 0.03 * random.uniform(-1, 1), -0.5, 0.5);
    }
    const JointVector qd = follower.advance(kT * v, v);
    fastest = std::max(fastest, qd.cwiseAbs().maxCoeff());
    steepest = std::max(steepest, (qd - last).cwiseAbs().maxCoeff());
    last = qd;
  }
  EXPECT_LE(fastest, 0.5 * (1 + 1e-12));
  EXPECT_LE(steepest, 0.03 * (1 + 1e-12));
  test::report("cycles", n);
}

}  // namespace
}  // namespace surg
