// States that come late and in bursts: the feedback must not shake the arm with its own delay.
#include <algorithm>
#include <cstdio>

#include "support/controller_bench.hpp"
#include "support/lagging_arm.hpp"
#include "support/next_command.hpp"
#include "support/timed_bench.hpp"

namespace surg {
namespace {

using namespace test;

constexpr int kBehind = 3;  // ticks that a state is on its way; nobody tells the controller

/// A link on a starved machine: it wakes up now and then, does all its ticks at once with the
/// newest command, and says once where the arm is.
class StarvedLink {
 public:
  StarvedLink(Law law, Random& random, int longest)
      : robot_(robot()),
        chain_(ur5e_chain()),
        controller_(chain_, robot_, robot_.limits, instrument(), offset_tool(), {law}),
        random_(random),
        arm_(robot_.home, random),
        longest_(longest) {
    in_.state_valid = true;
    in_.q = arm_.measured();
    in_.qd = JointVector::Zero(6);
    const Pose X_BF = chain_.forward(in_.q);
    const ToolCalibration tool = offset_tool();
    p_BRcm_ = X_BF * tool.p_FTip - 0.12 * (X_BF.linear() * tool.s_F);
    controller_.set_rcm(p_BRcm_);
    controller_.step(in_);
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
  }

  const Outputs& tick() {
    const Outputs& out = controller_.step(in_);
    in_.n_commands = 0;
    in_.state_age += kT;
    ++asleep_;
    if (asleep_ >= wakes_) {
      for (; asleep_ > 0; --asleep_) arm_.obey(out.qd_command);
      wakes_ = random_.integer(1, longest_);
      on_the_way_.push_back({ticks_ + kBehind, arm_.measured()});
    }
    for (; !on_the_way_.empty() && on_the_way_.front().arrives <= ticks_; on_the_way_.pop_front()) {
      in_.qd = (on_the_way_.front().q - in_.q) / std::max(in_.state_age, kT);
      in_.q = on_the_way_.front().q;
      in_.state_age = 0;
    }
    ++ticks_;
    return out;
  }

  void servo_cp(const Vector3& p_RTip) {
    next_command(in_, Motion::kServoCp) = pose(controller_, Motion::kServoCp, p_RTip);
  }

  /// Distance of the true shaft from the pivot [m].
  double deviation() const { return off_shaft(chain_, arm_.truth(), offset_tool(), p_BRcm_); }

 private:
  static RobotConfig robot() {
    Document document = good_robot();
    document.values["tuning.rcm_gain"] = 50.0;  // as shipped
    return robot_behind(document, 0.012);
  }

  RobotConfig robot_;
  Chain chain_;
  Controller controller_;
  Random& random_;
  LaggingArm arm_;
  Vector3 p_BRcm_;
  struct Letter {
    long arrives;
    JointVector q;
  };
  int longest_, asleep_ = 0, wakes_ = 1;
  long ticks_ = 0;
  std::deque<Letter> on_the_way_;
  Inputs in_;
};

TEST(StaleState, NeitherShakesTheArmNorMovesItOffThePivot) {
  Random random(5);
  int runs = 0;
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const int longest : {1, 3, 6, 12, 24, 40}) {  // up to 80 ms of silence
      double worst = 0, rest = 0;
      for (int k = 0; k < test::family(2, 20); ++k, ++runs) {
        StarvedLink link(law, random, longest);
        const Outputs* out = nullptr;
        for (int i = 0; i < 5000; ++i) {
          const double t = i * kT, ramp = std::min(t, 1.0);
          const Vector3 swing(0.02 * std::sin(1.26 * t), 0.02 * std::sin(0.94 * t), 0);
          if (t < 6) link.servo_cp(Vector3(0, 0, 0.12) + ramp * swing);
          out = &link.tick();
          worst = std::max(worst, link.deviation());
          if (t > 9) rest = std::max(rest, out->qd_command.cwiseAbs().maxCoeff());
          if (out->state != State::kEnabled) break;
        }
        EXPECT_EQ(out->state, State::kEnabled) << static_cast<int>(out->reason);
      }
      std::printf("law %d, silent for up to %d ms: pivot %.3f mm, at rest %.5f rad/s\n",
                  static_cast<int>(law), 2 * longest, 1e3 * worst, rest);
      EXPECT_LT(worst, 5e-4);
      EXPECT_LT(rest, 0.01);
    }
  }
  test::report("runs", runs);
}

/// States that are late by a constant time: at the full gain the loop would be unstable.
TEST(StaleState, LateStatesReduceTheFeedbackOfBothLaws) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const std::size_t late : {15, 30, 40}) {  // up to 80 ms
      TimedBench bench(law, {0.004, 0.008}, 0.012, 15, 3e-4);
      bench.delay_states(late);
      double rest = 0;
      for (int i = 0; i < 3000; ++i) {
        const double t = i * kT;
        if (t < 3) bench.servo_cp(Vector3(0.01 * std::sin(6 * t) * std::min(t, 1.0), 0, 0.12));
        bench.cycle();
        if (t > 5) rest = std::max(rest, bench.out().qd_command.cwiseAbs().maxCoeff());
      }
      std::printf("law %d, states %zu ms late: pivot %.3f mm, at rest %.5f rad/s\n",
                  static_cast<int>(law), 2 * late, 1e3 * bench.worst_pivot(), rest);
      EXPECT_EQ(bench.out().state, State::kEnabled) << name(bench.out().reason);
      EXPECT_LT(rest, 0.01);
      EXPECT_LT(bench.worst_pivot(), 1e-3);
    }
  }
}

}  // namespace
}  // namespace surg
