// The elbow of a seven-joint arm: its angle, and how the controller turns it with the pivot kept.
// Oracles: Denavit-Hartenberg matrices written out here, and the plant's measured motion.
#include <algorithm>
#include <chrono>
#include <cmath>

#include "support/next_command.hpp"
#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/kinematics/elbow.hpp"
#include "surg_core/motion/elbow_motion.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg {
namespace {

using namespace test;

constexpr double kT = 0.002;
constexpr double kRounding = 1 + 1e-6;

// --- an independent angle -----------------------------------------------------------------------

/// Craig's link transform of the Panda's published parameters.
Eigen::Matrix4d craig(double a, double d, double alpha, double theta) {
  Eigen::Matrix4d T;
  const double ct = std::cos(theta), st = std::sin(theta);
  const double ca = std::cos(alpha), sa = std::sin(alpha);
  T << ct, -st, 0, a, st * ca, ct * ca, -sa, -d * sa, st * sa, ct * sa, ca, d * ca, 0, 0, 0, 1;
  return T;
}

struct PandaPoints {
  Vector3 shoulder{0, 0, 0.333}, elbow, wrist;
};

PandaPoints panda_points(const JointVector& q) {
  const double a[] = {0, 0, 0, 0.0825, -0.0825, 0}, d[] = {0.333, 0, 0.316, 0, 0.384, 0};
  const double alpha[] = {0, -M_PI_2, M_PI_2, M_PI_2, -M_PI_2, M_PI_2};
  PandaPoints points;
  Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
  for (int i = 0; i < 6; ++i) {
    T = T * craig(a[i], d[i], alpha[i], q[i]);
    if (i == 3) points.elbow = T.block<3, 1>(0, 3);
  }
  points.wrist = T.block<3, 1>(0, 3);
  return points;
}

/// Angle between the vertical half-plane through shoulder and wrist and the elbow's half-plane, by
/// their normals; positive about the line from shoulder to wrist.
double swivel_oracle(const JointVector& q) {
  const PandaPoints at = panda_points(q);
  const Vector3 line = at.wrist - at.shoulder;
  const Vector3 vertical = line.cross(Vector3(0, 0, 1));
  const Vector3 bent = line.cross(Vector3(at.elbow - at.shoulder));
  const double cosine = vertical.dot(bent) / (vertical.norm() * bent.norm());
  const double angle = std::acos(std::clamp(cosine, -1.0, 1.0));
  return vertical.cross(bent).dot(line) < 0 ? -angle : angle;
}

JointVector any_posture(Random& random) {
  JointVector q(7);
  const double low[] = {-2.8, -1.7, -2.8, -3.0, -2.8, 0.0, -2.8};
  const double high[] = {2.8, 1.7, 2.8, -0.1, 2.8, 3.7, 2.8};
  for (int i = 0; i < 7; ++i) q[i] = random.uniform(low[i], high[i]);
  return q;
}

TEST(Elbow, SwivelAngleAgreesWithTheDhFormula) {
  Random random(1);
  const Chain chain = panda_chain();
  long defined = 0;
  const int postures = family(20000, 1000000);
  for (int i = 0; i < postures; ++i) {
    const JointVector q = any_posture(random);
    const double angle = swivel_angle(chain, q);
    if (!std::isfinite(angle)) continue;
    ++defined;
    // acos loses half the digits near 0 and pi.
    ASSERT_NEAR(wrapped(angle - swivel_oracle(q)), 0, 1e-5) << q.transpose();
  }
  EXPECT_GT(defined, 0.95 * postures);
  report("postures with an angle", defined);
}

TEST(Elbow, TurnKeepsTheFlangeAndTurnsByTheAngle) {
  Random random(2);
  const Chain chain = panda_chain();
  long regular = 0;
  for (int i = 0; i < family(5000, 200000); ++i) {
    const JointVector q = any_posture(random);
    const auto [X_BF, J] = chain.flange(q);
    const ElbowTurn turn = elbow_turn(chain, q, J);
    if (!turn.regular || turn.per_angle.norm() > 5) continue;
    ++regular;
    EXPECT_LT((J * turn.per_angle).norm(), 1e-7 * turn.per_angle.norm());
    const double h = 1e-5;
    const double turned = swivel_oracle(q + h * turn.per_angle) - swivel_oracle(q);
    if (std::abs(std::sin(turn.angle)) < 0.1) continue;  // the oracle has few digits there
    EXPECT_NEAR(wrapped(turned) / h, 1, 1e-2);
  }
  report("regular postures", regular);
  EXPECT_GT(regular, 1000);
}

TEST(Elbow, AngleOfAnotherArmIsUndefined) {
  EXPECT_TRUE(std::isnan(swivel_angle(ur5e_chain(), ur5e_home())));
  EXPECT_TRUE(std::isnan(swivel_angle(panda_chain(), JointVector::Zero(7))));  // wrist on axis 1
}

// --- the controller on an ideal Panda -----------------------------------------------------------

RobotConfig panda_robot(double preferred = NAN) {
  Document document = good_robot();
  auto& v = document.values;
  const auto list = [](const JointVector& values) {
    return std::vector<double>(values.data(), values.data() + values.size());
  };
  v["name"] = std::string("panda");
  v["joints.names"] = std::vector<std::string>{"joint1", "joint2", "joint3", "joint4",
                                               "joint5", "joint6", "joint7"};
  v["joints.home"] = list(panda_home());
  v["joints.position_min"] =
      std::vector<double>{-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973};
  v["joints.position_max"] =
      std::vector<double>{2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973};
  v["joints.velocity"] = list(panda_velocity());
  v["joints.acceleration"] = list(panda_acceleration());
  v["limits.tip_acceleration"] = 0.6;
  v["tuning.rcm_gain"] = 50.0;
  RobotConfig robot = robot_behind(document);
  robot.elbow = preferred;
  return robot;
}

/// A controller with an ideal arm: what is measured is the reference.
class PandaBench {
 public:
  explicit PandaBench(Law law = Law::kExact, double preferred = NAN)
      : robot_(panda_robot(preferred)),
        setup_{panda_chain(), robot_, robot_.limits, instrument(), offset_tool(), {law}},
        controller_(setup_.chain, robot_, robot_.limits, setup_.instrument, setup_.tool,
                    setup_.options),
        box_(controller_, setup_) {
    in_.state_valid = true;
    in_.q = robot_.home;
    in_.qd = JointVector::Zero(7);
    p_BRcm_ = tip() - 0.12 * shaft();
    box_.set_rcm(p_BRcm_);
    tick();
    EXPECT_EQ(box_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(box_.request(StateCommand::kEnable), Reason::kNone);
    tick();
  }

  const Outputs& tick() {
    out_ = &box_.step(in_);
    in_.n_commands = 0;
    const JointVector change = out_->qd_command - in_.qd;
    worst_acceleration_ =
        std::max(worst_acceleration_,
                 (change.array() / (kT * robot_.acceleration.array())).abs().maxCoeff());
    in_.qd = out_->qd_command;
    in_.q += kT * in_.qd;
    worst_pivot_ = std::max(worst_pivot_, deviation());
    room_ = std::min({room_, (in_.q - robot_.position_min).minCoeff(),
                      (robot_.position_max - in_.q).minCoeff()});
    return *out_;
  }

  MotionCommand& send(Motion motion, std::uint32_t source = kMe) {
    return test::next_command(in_, motion, source);
  }
  Reason turn(double angle, std::uint32_t source = kMe) {
    send(Motion::kElbowMoveJp, source).elbow = angle;
    const Outputs& out = tick();
    return out.verdicts[0].reason;
  }
  void servo_cp(const Vector3& p_RTip) {
    send(Motion::kServoCp) = pose(controller_, Motion::kServoCp, p_RTip);
  }
  /// Runs until the turn has ended, at most 'seconds'; whether it has.
  bool ends(double seconds) {
    for (int i = 0; i < seconds / kT; ++i) {
      if (!tick().busy) return true;
    }
    return false;
  }

  Vector3 tip() const { return setup_.chain.forward(in_.q) * setup_.tool.p_FTip; }
  Vector3 shaft() const { return setup_.chain.forward(in_.q).linear() * setup_.tool.s_F; }
  /// Distance of the shaft's line from the trocar [m].
  double deviation() const { return off_shaft(setup_.chain, in_.q, setup_.tool, p_BRcm_); }
  double angle() const { return swivel_oracle(in_.q); }
  void forget() { worst_acceleration_ = worst_pivot_ = 0; }

  Controller& controller() { return controller_; }
  BlackBox& box() { return box_; }
  const RobotConfig& robot() const { return robot_; }
  const Outputs& out() const { return *out_; }
  Inputs& in() { return in_; }
  double worst_acceleration() const { return worst_acceleration_; }
  double worst_pivot() const { return worst_pivot_; }
  double room() const { return room_; }

 private:
  RobotConfig robot_;
  ControllerSetup setup_;
  Controller controller_;
  BlackBox box_;
  Vector3 p_BRcm_;
  Inputs in_;
  const Outputs* out_ = nullptr;
  double worst_acceleration_ = 0, worst_pivot_ = 0, room_ = INFINITY;
};

TEST(Elbow, AtRestItComesToEveryAngleThatIsNotRefused) {
  Random random(3);
  long reached = 0, refused = 0;
  double worst_tip = 0, worst_pivot = 0, worst_acceleration = 0, longest = 0;
  PandaBench bench;
  for (int i = 0; i < family(40, 1000); ++i) {
    const double goal = random.uniform(-M_PI, M_PI);
    const double before = bench.angle();
    const Vector3 p_BTip = bench.tip();
    bench.forget();
    const Reason reason = bench.turn(goal);
    if (reason != Reason::kNone) {
      ASSERT_EQ(reason, Reason::kElbowOutOfReach);
      EXPECT_GE(bench.out().elbow_limit, 0);
      ++refused;
      continue;
    }
    ASSERT_TRUE(bench.ends(200)) << goal << " from " << before << " at " << bench.angle();
    EXPECT_EQ(bench.out().elbow_limit, ElbowMotion::kNobody);
    EXPECT_NEAR(bench.angle(), goal, ElbowMotion::kTolerance + 1e-5);
    worst_tip = std::max(worst_tip, (bench.tip() - p_BTip).norm());
    worst_pivot = std::max(worst_pivot, bench.worst_pivot());
    worst_acceleration = std::max(worst_acceleration, bench.worst_acceleration());
    longest = std::max(longest, std::abs(wrapped(goal - before)));
    ++reached;
  }
  std::printf(
      "reached %ld, refused %ld, longest turn %.2f rad, tip moved %.2e um, pivot %.2e um, "
      "acceleration %.3f of the limit, room %.3f rad\n",
      reached, refused, longest, 1e6 * worst_tip, 1e6 * worst_pivot, worst_acceleration,
      bench.room());
  EXPECT_GT(reached, family(10, 250));
  EXPECT_GT(refused, 0);
  EXPECT_LT(worst_tip, 1e-6);
  EXPECT_LT(worst_pivot, 1e-12);
  EXPECT_LE(worst_acceleration, 0.2);
  EXPECT_GT(bench.room(), 0);
}

TEST(Elbow, WhileAStreamRunsItTurnsWithTipAndPivotKept) {
  Random random(4);
  long turned = 0;
  long on_time = 0;
  double worst_tip = 0, worst_behind = 0;
  for (int run = 0; run < family(6, 100); ++run) {
    PandaBench bench;
    const Vector3 p_R = bench.controller().X_BR().inverse() * bench.tip();
    const double amplitude = random.uniform(0.005, 0.03), hertz = random.uniform(0.2, 0.8);
    const double before = bench.angle();
    double goal = before;
    bool slowed = false;
    for (int i = 0; i < 10 / kT; ++i) {
      const double phase = 2 * M_PI * hertz * i * kT;
      const double grow = std::min(i * kT, 1.0);
      bench.servo_cp(p_R +
                     grow * amplitude * Vector3(std::sin(phase), 0.5 * std::sin(2 * phase), 0));
      if (i == 1000) {
        goal = before + random.uniform(-0.5, 0.5);
        bench.send(Motion::kElbowMoveJp, kOther).elbow = goal;
      }
      const Outputs& out = bench.tick();
      ASSERT_EQ(out.state, State::kEnabled);
      if (i == 1000) {
        ASSERT_EQ(out.verdicts[1].reason, Reason::kNone) << goal;
      }
      slowed |= out.tier > 0;  // a path that a limit slows is behind its set-point for a while
      if (!slowed) worst_tip = std::max(worst_tip, (bench.tip() - out.p_set).norm());
    }
    on_time += !slowed;
    worst_behind = std::max(worst_behind, std::abs(bench.angle() - goal));
    for (int i = 0; i < 10 / kT; ++i) bench.tick();  // the stream has ended
    EXPECT_NEAR(bench.angle(), goal, ElbowMotion::kTolerance);
    EXPECT_LT(bench.worst_pivot(), 1e-12);
    EXPECT_LE(bench.worst_acceleration(), kRounding);
    EXPECT_GT(bench.room(), 0);
    turned += std::abs(bench.angle() - before) > 0.1;
  }
  std::printf("tip off its set-point by %.2e um, elbow off its goal by %.3f rad under way\n",
              1e6 * worst_tip, worst_behind);
  EXPECT_LT(worst_behind, 0.3);
  EXPECT_LT(worst_tip, 1e-6);
  EXPECT_GT(on_time, family(4, 80));
  EXPECT_GT(turned, 0);
}

/// The farthest angle that is accepted from here, by halves; the elbow does not turn meanwhile.
double farthest(PandaBench& bench, double sign) {
  double in = 0, out = 3.0;
  const double here = bench.angle();
  for (int i = 0; i < 12; ++i) {
    const double middle = 0.5 * (in + out);
    const bool taken = bench.turn(wrapped(here + sign * middle)) == Reason::kNone;
    bench.send(Motion::kHold);
    bench.tick();
    (taken ? in : out) = middle;
  }
  return wrapped(here + sign * in);
}

TEST(Elbow, ComesToTheFarthestAngleThatIsNotRefused) {
  for (const double sign : {-1.0, 1.0}) {
    PandaBench bench;
    const double goal = farthest(bench, sign);
    ASSERT_EQ(bench.turn(goal), Reason::kNone);
    ASSERT_TRUE(bench.ends(200));
    EXPECT_EQ(bench.out().elbow_limit, ElbowMotion::kNobody);
    EXPECT_NEAR(wrapped(bench.angle() - goal), 0, ElbowMotion::kTolerance + 1e-5);
  }
}

TEST(Elbow, RefusedAngleNamesTheJointThatIsInTheWay) {
  for (const double sign : {-1.0, 1.0}) {
    PandaBench bench;
    const double goal = farthest(bench, sign);
    ASSERT_EQ(bench.turn(goal + 0.05 * sign), Reason::kElbowOutOfReach);
    const int joint = bench.out().elbow_limit;
    ASSERT_EQ(bench.turn(goal), Reason::kNone);
    ASSERT_TRUE(bench.ends(200));
    std::printf("up to %.3f rad, then joint %d\n", goal, joint + 1);
    if (joint == 7) continue;  // a singularity, or the null space turns no elbow
    const double room = std::min(bench.in().q[joint] - bench.robot().position_min[joint],
                                 bench.robot().position_max[joint] - bench.in().q[joint]);
    EXPECT_LT(room, 0.09);
  }
}

TEST(Elbow, GoalThatTheTipMakesUnreachableIsHeldAndNamed) {
  PandaBench bench;
  const double goal = farthest(bench, 1);
  ASSERT_EQ(bench.turn(goal), Reason::kNone);
  ASSERT_TRUE(bench.ends(200));
  Random random(5);
  long held = 0;
  for (int i = 0; i < 12; ++i) {
    MotionCommand& command = bench.send(Motion::kMoveJp);
    command.joints = {random.uniform(-0.4, 0.4), random.uniform(-0.4, 0.4),
                      random.uniform(0.08, 0.16), random.uniform(-1, 1)};
    for (int k = 0; k < 8 / kT; ++k) bench.tick();
    const double off = std::abs(wrapped(bench.angle() - goal));
    const bool named = bench.out().elbow_limit >= 0;
    EXPECT_EQ(named, off > ElbowMotion::kTolerance) << off;
    if (!named) continue;
    ++held;
    EXPECT_EQ(bench.out().reason, Reason::kElbowOutOfReach);
    EXPECT_EQ(bench.out().state, State::kEnabled);
  }
  std::printf("held after %ld of 12 moves, pivot %.2e um\n", held, 1e6 * bench.worst_pivot());
  EXPECT_GT(held, 0);
  EXPECT_LT(bench.worst_pivot(), 1e-12);
  EXPECT_LE(bench.worst_acceleration(), kRounding);
  EXPECT_GT(bench.room(), 0);
}

TEST(Elbow, HoldAndPauseStopItWhereItIs) {
  for (const bool pause : {false, true}) {
    PandaBench bench;
    const double before = bench.angle();
    ASSERT_EQ(bench.turn(before + 0.5), Reason::kNone);
    for (int i = 0; i < 1000; ++i) bench.tick();
    ASSERT_GT(bench.in().qd.norm(), 0.02);
    bench.forget();
    if (pause) {
      ASSERT_EQ(bench.box().request(StateCommand::kPause), Reason::kNone);
    } else {
      bench.send(Motion::kHold);
    }
    for (int i = 0; i < 500; ++i) bench.tick();
    EXPECT_LT(bench.in().qd.norm(), 1e-6);
    EXPECT_LE(bench.worst_acceleration(), kRounding);
    EXPECT_FALSE(bench.out().busy);
    const double stopped = bench.angle();
    EXPECT_LT(stopped, before + 0.45);
    if (pause) {
      ASSERT_EQ(bench.box().request(StateCommand::kResume), Reason::kNone);
    }
    for (int i = 0; i < 2000; ++i) bench.tick();
    EXPECT_NEAR(bench.angle(), stopped, 2e-3);
    EXPECT_LE(bench.worst_acceleration(), kRounding);
  }
}

TEST(Elbow, RetraceTakesTheElbowBackAndLeavesItThere) {
  PandaBench bench;
  const JointVector q = bench.in().q;
  ASSERT_EQ(bench.turn(bench.angle() + 0.3), Reason::kNone);
  ASSERT_TRUE(bench.ends(60));
  bench.send(Motion::kRetrace);
  bench.tick();
  EXPECT_EQ(bench.turn(0.1), Reason::kNotAtRest);
  ASSERT_TRUE(bench.ends(60));
  for (int i = 0; i < 1000; ++i) bench.tick();
  EXPECT_LT((bench.in().q - q).cwiseAbs().maxCoeff(), 5e-3);
  EXPECT_LE(bench.worst_acceleration(), kRounding);
}

TEST(Elbow, PreferredAngleOfTheCellIsTakenUpAfterHome) {
  PandaBench plain;
  const double goal = plain.angle() + 0.3;
  PandaBench bench(Law::kExact, goal);
  EXPECT_EQ(bench.out().elbow_goal, goal);
  for (int i = 0; i < 10; ++i) bench.tick();
  EXPECT_FALSE(bench.out().busy);
  for (int i = 0; i < 20 / kT; ++i) bench.tick();
  EXPECT_NEAR(bench.angle(), goal, ElbowMotion::kTolerance);
  EXPECT_LE(bench.worst_acceleration(), kRounding);
}

TEST(Elbow, RefusedWhereThereIsNoNullSpaceToMove) {
  PandaBench velocity(Law::kVelocity);
  EXPECT_EQ(velocity.turn(0.1), Reason::kNoElbow);
  PandaBench bench;
  EXPECT_EQ(bench.turn(4.0), Reason::kElbowOutOfReach);
  EXPECT_EQ(bench.out().elbow_limit, 7);
  ASSERT_EQ(bench.controller().claim(kOther), Reason::kNone);
  EXPECT_EQ(bench.turn(bench.angle()), Reason::kNoAuthority);
  ASSERT_EQ(bench.box().request(StateCommand::kDisable), Reason::kNone);
  EXPECT_EQ(bench.turn(0.1), Reason::kNotEnabled);
}

TEST(Elbow, ATurnReplaysBitForBit) {
  PandaBench bench;
  ASSERT_EQ(bench.turn(bench.angle() + 0.4), Reason::kNone);
  for (int i = 0; i < 1500; ++i) bench.tick();
  bench.send(Motion::kHold);
  for (int i = 0; i < 300; ++i) bench.tick();
  const BlackBoxRecording recording = decode(encode(bench.box().recording({})));
  const auto difference = replay(recording);
  EXPECT_FALSE(difference) << difference->step << " " << difference->field;
}

TEST(Elbow, JudgingACommandTakesAShortTimeAndNoHeap) {
  PandaBench bench;
  bench.send(Motion::kElbowMoveJp).elbow = 3.0;
  HeapWatch watch;
  const auto begin = std::chrono::steady_clock::now();
  bench.tick();
  const auto end = std::chrono::steady_clock::now();
  EXPECT_EQ(watch.calls(), 0);
  const double us = std::chrono::duration<double, std::micro>(end - begin).count();
  std::printf("the cycle that judges a far angle takes %.0f us\n", us);
  EXPECT_LT(us, 1000);
}

}  // namespace
}  // namespace surg
