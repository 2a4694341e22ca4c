// Measured joint states that cannot be, of an arm whose motion is known.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "support/test_arm.hpp"
#include "surg_core/state/state_check.hpp"

namespace surg {
namespace {

using Verdict = StateCheck::Verdict;
constexpr double kT = 0.002;  // [s]
constexpr double kTurn = 2 * M_PI;

/// Joints that swing, each at a frequency of its own.
struct Swing {
  JointVector q, qd;
  static Swing at(double t) {
    Swing out{JointVector(6), JointVector(6)};
    for (int i = 0; i < 6; ++i) {
      const double w = 1 + 0.3 * i;
      out.q[i] = 3 + 0.5 * std::sin(w * t);
      out.qd[i] = 0.5 * w * std::cos(w * t);
    }
    return out;
  }
};

Chain chain(bool continuous) {
  std::vector<Joint> joints = test::ur5e_chain().joints();
  joints[5].continuous = continuous;
  return Chain(joints, Pose::Identity());
}

StateCheck check(bool continuous = false) {
  return StateCheck(chain(continuous), Swing::at(0).q, JointVector::Constant(6, 15));
}

/// Cycles until a state that 'spoil' changes from 1 s on is not good; -1: never within a second.
int found_after(const std::function<void(Swing&, double)>& spoil, bool continuous = false) {
  StateCheck judge = check(continuous);
  for (int k = 0; k < 1000; ++k) {
    Swing now = Swing::at(k * kT);
    if (k >= 500) spoil(now, k * kT - 1);
    if (judge.judge(now.q, now.qd, 0, kT) != Verdict::kGood) return k - 500;
  }
  return -1;
}

TEST(StateCheck, AMotionWithItsOwnVelocityIsGood) {
  EXPECT_EQ(found_after([](Swing&, double) {}), -1);
}

TEST(StateCheck, FindsJointsThatWrapJumpDriftAndFreeze) {
  for (int i = 0; i < 6; ++i) {
    EXPECT_EQ(found_after([&](Swing& now, double) { now.q[i] -= kTurn; }), 0);
    EXPECT_EQ(found_after([&](Swing& now, double) { now.q[i] += 0.1; }), 0);
    const int drifting = found_after([&](Swing& now, double t) { now.q[i] += 0.5 * t; });
    EXPECT_GE(drifting, 0);
    EXPECT_LT(drifting, 50);
    const double there = Swing::at(1).q[i];
    if (std::abs(Swing::at(1).qd[i]) < 0.2) continue;
    const int frozen = found_after([&](Swing& now, double) { now.q[i] = there; });
    EXPECT_GE(frozen, 0) << i;
    EXPECT_LT(frozen, 50) << i;
  }
}

TEST(StateCheck, OneStateIsPassedOverAndTheFifthIsLost) {
  StateCheck judge = check();
  Swing now = Swing::at(0);
  EXPECT_EQ(judge.judge(now.q, now.qd, 0, kT), Verdict::kGood);
  for (int k = 1; k < 200; ++k) {
    now = Swing::at(k * kT);
    const Swing truth = now;
    const bool bad = k % 7 == 0;
    if (bad) now.q[k % 6] += 1;
    EXPECT_EQ(judge.judge(now.q, now.qd, 0, kT), bad ? Verdict::kImplausible : Verdict::kGood);
    EXPECT_LT((now.q - truth.q).norm(), 1e-4) << "moved on from the last good one";
  }
  for (int k = 200; k < 205; ++k) {
    now = Swing::at(k * kT);
    now.q[2] += 1;
    EXPECT_EQ(judge.judge(now.q, now.qd, 0, kT), k < 204 ? Verdict::kImplausible : Verdict::kLost);
  }
  now = Swing::at(205 * kT);
  now.q[2] += 1;
  EXPECT_EQ(judge.judge(now.q, now.qd, 0, kT), Verdict::kGood) << "begins anew where it is";
}

TEST(StateCheck, OnlyContinuousJointsAreUnwrapped) {
  const auto wrap = [](Swing& now, double) { now.q[5] -= kTurn * std::round(now.q[5] / kTurn); };
  EXPECT_GE(found_after([&](Swing& now, double) { now.q[5] -= kTurn; }), 0);
  EXPECT_EQ(found_after([&](Swing& now, double) { now.q[5] -= kTurn; }, true), -1);
  StateCheck judge = check(true);
  for (int k = 0; k < 1000; ++k) {
    const Swing truth = Swing::at(k * kT);
    Swing now = truth;
    wrap(now, 0);
    ASSERT_EQ(judge.judge(now.q, now.qd, 0, kT), Verdict::kGood);
    ASSERT_NEAR(now.q[5], truth.q[5], 1e-12);
  }
}

/// A simulator at half the pace, states that come in bursts, and a clock that stood still.
TEST(StateCheck, TheTimeIsWhatAllJointsSay) {
  StateCheck slow = check(), bursts = check();
  double age = 0;
  for (int k = 0; k < 1000; ++k) {
    Swing now = Swing::at(0.5 * k * kT);
    ASSERT_EQ(slow.judge(now.q, now.qd, 0, kT), Verdict::kGood) << k;
    const int sent = k - k % 20;
    now = Swing::at(sent * kT);
    age = kT * (k - sent);
    ASSERT_EQ(bursts.judge(now.q, now.qd, age, kT), Verdict::kGood) << k;
  }
  StateCheck stood = check();
  for (int k = 0; k < 1000; ++k) {
    Swing now = Swing::at((k < 500 ? k : k - 20) * kT);
    if (k >= 500 && k < 520) continue;
    ASSERT_EQ(stood.judge(now.q, now.qd, 0, k == 520 ? 21 * kT : kT), Verdict::kGood) << k;
  }
}

}  // namespace
}  // namespace surg
