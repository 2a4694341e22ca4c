// The flange's speed: inside its limit in every command, whatever is asked, whatever the plant, and
// on the way back along the trace; and the look ahead that knows the margin before a joint's limit.
#include "support/controller_bench.hpp"
#include "support/lagging_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/flange_cap.hpp"
#include "surg_core/limits/limited_step.hpp"

namespace surg {
namespace {

using namespace test;

JointVector any(Random& random, double size) {
  JointVector q(6);
  for (int i = 0; i < 6; ++i) q[i] = random.uniform(-size, size);
  return q;
}

TEST(Flange, AMixtureKeepsTheSpeedAndEveryJointLimitOfBoth) {
  Random random(31);
  const int n = family(2000, 200000);
  const Chain chain = ur5e_chain();
  long mixed = 0;
  for (int i = 0; i < n; ++i) {
    const JointVector last = any(random, 1.5), a = JointVector::Constant(6, 15.0);
    const JointVector slow = braked_together(last, a, kT);
    JointVector fast = last;
    for (int j = 0; j < 6; ++j) fast[j] += random.uniform(-1, 1) * a[j] * kT;
    for (int j = 0; j < 6; ++j) {
      ASSERT_LE(std::abs(slow[j] - last[j]), a[j] * kT * (1 + 1e-12));
      ASSERT_LE(std::abs(slow[j]), std::abs(last[j]));
    }
    const Jacobian J = chain.flange(any(random, 3)).J;
    const auto speed = [&](const JointVector& qd) { return (J * qd).head<3>().norm(); };
    const double limit = random.uniform(0.9, 1.1) * speed(slow);
    const JointVector qd = slowed_flange(J, limit, fast, slow);
    if (speed(fast) <= limit) {
      ASSERT_EQ(qd, fast);
    } else if (speed(slow) < limit) {
      ++mixed;
      ASSERT_NEAR(speed(qd), limit, 1e-12);
    } else {
      ASSERT_EQ(qd, slow);
    }
    for (int j = 0; j < 6; ++j) {
      ASSERT_LE(std::abs(qd[j] - last[j]), a[j] * kT * (1 + 1e-12));
    }
  }
  EXPECT_GT(mixed, n / 20);
  EXPECT_EQ(braked_together(JointVector::Zero(6), JointVector::Constant(6, 15.0), kT),
            JointVector::Zero(6));
  report("mixtures", mixed);
}

/// A joint that is too fast for its position limit leaves no way to stay on the pivot: the joints
/// brake one by one, and without the others one of them would lead the flange on.
TEST(Flange, JointsThatBrakeOneByOneDoNotSpeedItUp) {
  Random random(36);
  const int runs = family(300, 20000);
  const Chain chain = ur5e_chain();
  const RobotConfig robot = Bench::robot_with_lag(0);
  const ToolCalibration tool = offset_tool();
  int braked = 0;
  double fastest = 0;
  for (int run = 0; run < runs; ++run) {
    JointLimits limits = joint_limits(robot, robot.limits);
    JointVector q = robot.home;
    const Pose X_BF = chain.forward(q);
    const Vector3 s = X_BF.linear() * tool.s_F, p_BRcm = X_BF * tool.p_FTip - 0.12 * s;
    const Home home{s, X_BF.linear()};
    const Vector3 v(random.uniform(-0.25, 0.25), random.uniform(-0.25, 0.25),
                    random.uniform(-0.25, 0.25));
    auto [X, J] = chain.flange(q);
    const Vector6 twist = rcm_twist(shaft_state(X, {tool.s_F, tool.p_FTip}, p_BRcm), v,
                                    random.uniform(-1, 1), Vector3::Zero(), 0, 0.02);
    StepRequest request;
    request.forward = twist;
    JointVector qd = inverse_velocity(J, twist, JointVector::Zero(6)).qd;
    if (!((J * qd).head<3>().norm() < 0.9 * limits.flange_velocity)) continue;
    const int joint = random.integer(0, 5);
    const double room = random.uniform(0.2, 0.9) * qd[joint] * qd[joint] / 30;
    (qd[joint] > 0 ? limits.position_max : limits.position_min)[joint] =
        q[joint] + std::copysign(room, qd[joint]);
    limits.position_margin = 0;
    const LimitedStep limited(chain, {tool.s_F, tool.p_FTip}, limits, kT);
    for (int k = 0; k < 30; ++k) {
      const Step step = limited.velocity(q, qd, home, p_BRcm, request);
      chain.forward(q, X, J);
      const double speed = (J * step.qd).head<3>().norm();
      braked += step.tier == 2;
      fastest = std::max(fastest, speed / limits.flange_velocity);
      qd = step.qd;
      q += kT * qd;
    }
  }
  std::printf("[   count  ] %d cycles of braking one by one, flange %.3f of its limit\n", braked,
              fastest);
  EXPECT_GT(braked, runs / 10);
  EXPECT_LE(fastest, 1.15);  // the joint at its position limit comes first
}

/// Speed of the flange that the last command asks for, at the joints it was made for.
double commanded(const Bench& bench, const JointVector& q) {
  return (bench.chain().flange(q).J * bench.out().qd_command).head<3>().norm();
}

struct Plant {
  const char* name;
  int delay;
  double tau, link_lag;
};
constexpr Plant kPlants[] = {
    {"ideal", 0, 0, 0}, {"lag known", 1, 0.01, 0.012}, {"lag not known", 1, 0.01, 0}};

TEST(Flange, EveryCommandKeepsItsSpeedAndTheJointsAccelerationWhoeverAnswers) {
  Random random(32);
  const int runs = family(1, 20);
  long total_at_limit = 0;
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const Plant& plant : kPlants) {
      long at_limit = 0;
      double worst_pivot = 0;
      for (int run = 0; run < runs; ++run) {
        Bench bench({law}, plant.delay, plant.tau, plant.link_lag);
        const double limit = bench.robot().limits.flange_velocity;
        MotionCommand command;
        command.source = kMe;
        JointVector last = bench.out().qd_command;
        for (int k = 0; k < 3000; ++k) {
          // Sideways as fast as the tip may; a shallow tip moves the flange faster than itself.
          if (k % 150 == 0) {
            command.motion = random.integer(0, 2) ? Motion::kServoCv : Motion::kMoveCp;
            const Vector3 p(random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05),
                            random.uniform(0.05, 0.12));
            command.p = command.motion == Motion::kMoveCp ? p : 5 * (p - bench.tip_in_R());
            command.rotation = bench.controller().tool_orientation(
                bench.controller().X_BR().linear() * p.normalized(), 0);
            command.roll_rate = random.uniform(-3, 3);
          }
          if (command.motion == Motion::kServoCv || k % 150 == 0) bench.send(command);
          const JointVector q = bench.in().q;
          bench.tick();
          const double speed = commanded(bench, q);
          ASSERT_LE(speed, limit * (1 + 1e-9)) << plant.name << " run " << run << " cycle " << k;
          at_limit += speed > 0.96 * limit;
          for (int j = 0; j < 6; ++j) {
            const double change = std::abs(bench.out().qd_command[j] - last[j]);
            ASSERT_LE(change, bench.robot().acceleration[j] * kT * (1 + 1e-9));
          }
          last = bench.out().qd_command;
          worst_pivot = std::max(worst_pivot, bench.out().rcm_error);
          // An arm of unknown lag that is driven like this may leave the pivot or its set-point;
          // it is seen, and stopped.
          if (bench.out().state != State::kEnabled && plant.tau > 0 && plant.link_lag == 0) break;
          ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
        }
      }
      total_at_limit += at_limit;
      // Beyond the fault level the stop goes on along the pivot as well as it may.
      EXPECT_LT(worst_pivot, plant.tau == 0       ? 1e-4
                             : plant.link_lag > 0 ? 3e-4
                                                  : 3e-3)
          << plant.name;
    }
  }
  EXPECT_GT(total_at_limit, 1000 * runs);
  report("cycles at the limit", total_at_limit);
}

/// F24: driven to the trocar the tip comes close to the pivot, and the flange at the other end
/// moves many times as fast. The command keeps the limit; joints that answer late, each by another
/// lag, may add a little of their own.
TEST(Flange, F24DrivenToTheTrocarTheCommandKeepsIt) {
  Random random(35);
  const int runs = family(4, 100);
  double commanded_most = 0, moved_most = 0;
  for (int run = 0; run < runs; ++run) {
    RobotConfig robot = Bench::robot_with_lag(0.012);  // the bundled UR5e's figures
    robot.home = (JointVector(6) << -0.294, -1.234, 1.511, -1.29, -1.63, -2.134).finished();
    robot.acceleration.setConstant(40);
    robot.tuning.rcm_gain = 50;
    robot.limits.tip_jerk = 100;
    Bench bench({}, 0, 0, 0.012, &robot);  // its own plant is not used
    LaggingArm arm(bench.in().q, random);
    const double limit = bench.robot().limits.flange_velocity;
    const double around = random.uniform(0, 2 * M_PI), up = random.uniform(0.06, 0.25),
                 aside = random.uniform(0, 0.1);
    MotionCommand command = test::command(Motion::kServoCv);
    for (int k = 0; k < 1200; ++k) {
      const Vector3 s = bench.tip_in_R().normalized();
      const Vector3 u(std::cos(around), std::sin(around), 0);
      command.p = -up * s + aside * std::sin(0.01 * k) * u;
      bench.send(command);
      const JointVector q = bench.in().q, before = arm.truth();
      bench.tick();
      ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
      arm.obey(bench.out().qd_command);
      bench.in().q = arm.measured();
      bench.in().qd = (arm.truth() - before) / kT;
      commanded_most = std::max(commanded_most, commanded(bench, q));
      const Vector3 moved = bench.chain().forward(arm.truth()).translation() -
                            bench.chain().forward(before).translation();
      moved_most = std::max(moved_most, moved.norm() / kT);
    }
    ASSERT_LE(commanded_most, limit * (1 + 1e-9));
    ASSERT_LE(moved_most, 1.02 * limit);
  }
  EXPECT_GT(commanded_most, 0.2);
  std::printf("[   count  ] %d ways to the trocar, flange %.4f m/s commanded, %.4f m/s moved\n",
              runs, commanded_most, moved_most);
}

/// The replay puts itself on the pivot within one cycle: from the measured state of an arm that
/// answers late, and nobody has said how late, that would be a gain of 500 /s.
TEST(Flange, TheWayBackStaysInsideItBehindAnArmOfUnknownLag) {
  Random random(33);
  const int runs = family(3, 50);
  for (const Law law : {Law::kVelocity, Law::kExact}) {
    double fastest = 0, worst_pivot = 0;
    for (int run = 0; run < runs; ++run) {
      Bench bench({law}, 2, 0.008);
      MotionCommand command;
      command.source = kMe;
      for (int k = 0; k < 1500; ++k) {
        command.motion = Motion::kServoCv;
        if (k % 250 == 0) {
          command.p = Vector3(random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1),
                              random.uniform(-0.03, 0.03));
          command.roll_rate = random.uniform(-1, 1);
        }
        bench.ask(command);
      }
      command.motion = Motion::kRetrace;
      bench.send(command);
      int cycles = 0;
      do {
        const JointVector q = bench.in().q;
        bench.tick();
        fastest = std::max(fastest, commanded(bench, q));
        worst_pivot = std::max(worst_pivot, bench.out().rcm_error);
        ASSERT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
      } while (bench.out().busy && ++cycles < 30000);
      EXPECT_LT(cycles, 30000);
      EXPECT_GT(cycles, 100);
    }
    EXPECT_LE(fastest, 0.25 * (1 + 1e-9));
    EXPECT_LT(worst_pivot, 2e-4);
    std::printf("[   count  ] %d ways back, flange %.3f m/s, pivot %.0f um\n", runs, fastest,
                worst_pivot * 1e6);
  }
}

/// A profile that ends inside the margin before a joint's limit: whoever looks ahead sees the slow
/// way in, and next to nothing has to leave the path for it, and nothing the pivot.
TEST(Flange, TheLookAheadKnowsTheMarginBeforeAJointLimit) {
  Random random(34);
  const int runs = family(12, 150);
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    long inside = 0, off_path = 0;
    double worst_pivot = 0;
    for (int run = 0; run < runs; ++run) {
      const int joint = random.integer(0, 5);
      const bool upper = random.integer(0, 1);
      const double room = random.uniform(0.05, 0.3);
      RobotConfig robot = Bench::robot_with_lag(0);
      (upper ? robot.position_max : robot.position_min)[joint] =
          robot.home[joint] + (upper ? room : -room);
      Bench bench({law}, 0, 0, 0, &robot);
      MotionCommand command = test::command(Motion::kMoveJp);
      command.joints = Vector4(random.uniform(-0.8, 0.8), random.uniform(-0.8, 0.8),
                               random.uniform(0.06, 0.2), random.uniform(-2, 2));
      bench.send(command);
      for (int k = 0; k < 2000; ++k) {
        bench.tick();
        const double left = upper ? robot.position_max[joint] - bench.in().q[joint]
                                  : bench.in().q[joint] - robot.position_min[joint];
        ASSERT_GE(left, 0.0);
        inside += left < robot.limits.joint_margin;
        off_path += bench.out().tier > 0;
        worst_pivot = std::max(worst_pivot, bench.out().rcm_error);
      }
    }
    EXPECT_GT(inside, 500);
    EXPECT_LE(off_path, 2 * runs);  // without the margin in the look ahead: four times as many
    EXPECT_LT(worst_pivot, law == Law::kExact ? 1e-9 : 1e-4);
    std::printf("[   count  ] %ld cycles inside a margin, %ld off the path, pivot %.2g um\n",
                inside, off_path, worst_pivot * 1e6);
  }
}

}  // namespace
}  // namespace surg
