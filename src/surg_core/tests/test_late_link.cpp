// A link that obeys much later than stated for some tens of milliseconds, as on a machine with too
// many programs, under a fast hand that meets the limits of flange and joints. Judged by the arm's
// true joints.
#include <algorithm>
#include <array>
#include <cstdio>
#include <utility>

#include "support/late_link.hpp"
#include "support/law_scene.hpp"
#include "support/next_command.hpp"
#include "support/test_support.hpp"
#include "surg_core/controller.hpp"

namespace surg {
namespace {

using test::kT;
using test::Late;
using test::LateLink;
using test::Random;
using test::Scene;

constexpr double kStated = 0.012;  // [s]
constexpr double kLatest = 0.018;  // [s] more than stated

std::vector<double> list(const JointVector& v) { return {v.data(), v.data() + v.size()}; }

/// The arms with their joints' limits as shipped.
RobotConfig shipped(const Scene& scene, bool panda) {
  Document document = test::good_robot();
  auto& v = document.values;
  const std::size_t n = scene.q_home.size();
  std::vector<std::string> names(n);
  for (std::size_t i = 0; i < n; ++i) names[i] = "joint" + std::to_string(i + 1);
  v["joints.names"] = names;
  v["joints.home"] = list(scene.q_home);
  v["joints.position_min"] = std::vector<double>(n, -6.28);
  v["joints.position_max"] = std::vector<double>(n, 6.28);
  v["joints.velocity"] = list(scene.velocity);
  v["joints.acceleration"] = list(scene.acceleration);
  v["limits.tip_jerk"] = 100.0;
  v["tuning.rcm_gain"] = 50.0;
  if (panda) {
    v["limits.tip_acceleration"] = 0.6;
    v["limits.pivot_acceleration"] = 5.0;
    v["tuning.stream_delay"] = 0.05;
  }
  return test::robot_behind(document, kStated);
}

ToolCalibration tool_of(const Scene& scene) {
  return {{0, 1, 1, "2026-01-01"}, scene.tool.s_F, scene.tool.p_FTip};
}

/// How late the link is, now and then: for 30 to 500 ms by 12 to 18 ms more than stated.
class Starvation {
 public:
  explicit Starvation(Random& random) : random_(random) {}
  double more() {
    if (left_-- <= 0) {
      late_ = !late_;
      left_ = std::lround((late_ ? random_.magnitude(0.03, 0.5) : random_.uniform(0.05, 1)) / kT);
      more_ = late_ ? random_.uniform(0.012, kLatest) : 0;
    }
    return more_;
  }

 private:
  Random& random_;
  long left_ = 250;
  bool late_ = false;
  double more_ = 0;
};

/// A hand to and fro at up to 0.15 m/s at the tip round a drawn depth; now and then a pedal ends
/// its stream, and it starts anew where the tip is.
class Hand {
 public:
  Hand(Random& random, double depth) : random_(random), middle_(0, 0, depth), at_(middle_) {}
  /// Whether it holds the arm in this cycle; then 'at' has moved. tip: where a stream would begin.
  bool moves(const Vector3& tip) {
    if (left_-- <= 0) {
      const bool held = clutched_;
      clutched_ = random_.uniform(0, 1) < 0.2;
      if (held) at_ = tip;
      left_ = std::lround(random_.uniform(0.05, 0.6) / kT);
      const Vector3 wish(random_.normal(), random_.normal(), 0.5 * random_.normal());
      velocity_ = random_.uniform(0.05, 0.15) * wish.normalized();
    }
    const Vector3 off = at_ - middle_;
    if (off.norm() > kReach && off.dot(velocity_) > 0)
      velocity_ = -velocity_.norm() * off.normalized();
    if (!clutched_) at_ += kT * velocity_;
    return !clutched_;
  }
  const Vector3& at() const { return at_; }

 private:
  static constexpr double kReach = 0.03;  // [m]
  Random& random_;
  Vector3 middle_, at_, velocity_ = Vector3::Zero();
  long left_ = 0;
  bool clutched_ = true;
};

/// An arm at its trocar behind a starved link, enabled.
class Arm {
 public:
  Arm(bool panda, Late kind, Law law, Random& random)
      : scene_(panda, true),
        robot_(shipped(scene_, panda)),
        controller_(scene_.chain, robot_, robot_.limits, test::instrument(), tool_of(scene_),
                    {law}),
        link_(scene_.q_home, kStated, kind),
        starvation_(random),
        depth_(random.uniform(0.05, 0.12)) {
    const Pose X_BF = scene_.chain.forward(scene_.q_home);
    p_BRcm_ = X_BF * scene_.tool.p_FTip - depth_ * (X_BF.linear() * scene_.tool.s_F);
    in_.state_valid = true;
    controller_.set_rcm(p_BRcm_);
    tick(0);
    EXPECT_EQ(controller_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(controller_.request(StateCommand::kEnable), Reason::kNone);
    tick(0);
  }

  void tick() { tick(starvation_.more()); }
  /// A pose of a stream at 100 Hz.
  void follow(const Vector3& p) {
    if (++sent_ % 5 != 0) return;
    send(Motion::kServoCp) = test::pose(controller_, Motion::kServoCp, p);
  }
  MotionCommand& send(Motion motion) { return test::next_command(in_, motion); }

  Controller& controller() { return controller_; }
  const Outputs& out() const { return *out_; }
  double depth() const { return depth_; }
  /// Where a stream would begin.
  Vector3 set_point() const { return controller_.X_BR().inverse() * out_->p_set; }
  /// [m] of the true shaft from its pivot.
  double off_pivot() const { return shaft().e.norm(); }
  Vector3 tip() const { return shaft().p_BTip; }

 private:
  ShaftState shaft() const {
    return shaft_state(scene_.chain.forward(link_.truth()), scene_.tool, p_BRcm_);
  }
  void tick(double more) {
    in_.q = link_.measured();
    in_.qd = link_.velocity();
    out_ = &controller_.step(in_);
    in_.n_commands = 0;
    link_.obey(out_->qd_command, more);
  }

  Scene scene_;
  RobotConfig robot_;
  Controller controller_;
  LateLink link_;
  Starvation starvation_;
  double depth_;
  Vector3 p_BRcm_;
  Inputs in_;
  const Outputs* out_ = nullptr;
  long sent_ = 0;
};

struct Storm {
  double worst = 0;  ///< [m] while ENABLED
  double way = 0;    ///< [m] of the tip
  long faults = 0, pauses = 0;
};

/// 'seconds' of a storm; an arm that was let go is enabled again.
void drive(Storm& storm, Arm& arm, double seconds, Random& random) {
  Hand hand(random, arm.depth());
  long let_go = 0;
  for (long i = 0; i < std::lround(seconds / kT); ++i) {
    const bool was_enabled = arm.out().state == State::kEnabled;
    if (was_enabled && hand.moves(arm.set_point())) arm.follow(hand.at());
    const Vector3 before = arm.tip();
    arm.tick();
    storm.way += (arm.tip() - before).norm();
    if (was_enabled) storm.worst = std::max(storm.worst, arm.off_pivot());
    const State state = arm.out().state;
    if (state == State::kEnabled) {
      let_go = 0;
      continue;
    }
    if (was_enabled) {
      ++(state == State::kFault ? storm.faults : storm.pauses);
      std::printf("let go: %s\n", name(arm.out().reason));
    }
    if (++let_go > 250) {
      arm.controller().request(state == State::kFault ? StateCommand::kEnable
                                                      : StateCommand::kResume);
    }
  }
}

constexpr std::array kKinds{Late::kServo, Late::kQueue, Late::kBunch};

bool full() { return test::family(0, 1) == 1; }

/// [m] Of the true shaft off its pivot.
double allowed(Law law, bool panda) {
  const bool rare_peaks = full() && law == Law::kVelocity && panda;  // measured: 0.54 mm
  return rare_peaks ? 0.0007 : 0.0005;
}

const char* name_of(Late kind) {
  return std::array{"slow servo", "queue", "bunches"}[static_cast<int>(kind)];
}
const char* name_of(bool panda) { return panda ? "Panda" : "UR5e"; }

TEST(LateLink, AFastHandBehindALinkThatComesLateStaysOnThePivot) {
  Random random(26);
  long ticks = 0;
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    const int runs = law == Law::kExact ? test::family(6, 60) : test::family(1, 60);
    for (const bool panda : {false, true}) {
      for (const Late kind : kKinds) {
        Storm storm;
        double peaks = 0;
        for (int k = 0; k < runs; ++k) {
          Arm arm(panda, kind, law, random);
          const double before = std::exchange(storm.worst, 0);
          drive(storm, arm, 20, random);
          peaks += storm.worst / runs;
          storm.worst = std::max(storm.worst, before);
          ticks += 10000;
        }
        std::printf(
            "%s form, %s, %s: pivot %.3f mm (mean of the peaks %.3f), %.1f m of the tip, "
            "%ld faults, %ld pauses\n",
            law == Law::kExact ? "exact" : "velocity", name_of(panda), name_of(kind),
            1e3 * storm.worst, 1e3 * peaks, storm.way, storm.faults, storm.pauses);
        EXPECT_LT(storm.worst, allowed(law, panda));
        // While the arm is late the flange is slow: without that 0.31 to 0.58 mm.
        const double usual = panda ? 0.00027 : 0.00021;
        EXPECT_TRUE(law != Law::kExact || peaks < usual) << peaks;
        EXPECT_EQ(storm.faults, 0);
        EXPECT_LE(storm.pauses, test::family(0, 2));  // measured: 1 in 60 runs
        EXPECT_GT(storm.way, 0.3 * runs) << "the arm hardly moved";
      }
    }
  }
  test::report("ticks", ticks);
}

TEST(LateLink, TheWayBackOfAStormStaysOnThePivot) {
  Random random(27);
  const int runs = test::family(1, 40);
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const bool panda : {false, true}) {
      double worst = 0, seconds = 0;
      for (int k = 0; k < 3 * runs; ++k) {
        Arm arm(panda, kKinds[k % 3], law, random);
        Storm storm;
        drive(storm, arm, 3, random);
        if (arm.out().state != State::kEnabled) continue;
        arm.send(Motion::kRetrace);
        long left = 30000;
        do {
          arm.tick();
          worst = std::max(worst, arm.off_pivot());
          seconds += kT;
          ASSERT_EQ(arm.out().state, State::kEnabled) << name(arm.out().reason);
        } while (arm.out().busy && --left > 0);
        EXPECT_GT(left, 0);
      }
      std::printf("%s form, %s: pivot %.3f mm, %.0f s of ways back\n",
                  law == Law::kExact ? "exact" : "velocity", name_of(panda), 1e3 * worst, seconds);
      EXPECT_LT(worst, 0.0005);
      EXPECT_GT(seconds, runs);
    }
  }
}

}  // namespace
}  // namespace surg
