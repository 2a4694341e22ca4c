// The black box: what it holds runs again bit for bit, in another controller, from the middle of
// any run; and a file that is not whole is refused with words.
#include <array>
#include <cstring>
#include <memory>
#include <string>

#include "support/fixture_bench.hpp"
#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg {
namespace {

using test::Random;

constexpr double kT = 0.002;

ControllerSetup setup(Law law) {
  const RobotConfig robot = test::robot_behind(test::good_robot());
  Controller::Options options;
  options.law = law;
  options.track_rcm = true;
  return {test::ur5e_chain(),  robot,  robot.limits, test::instrument(),
          test::offset_tool(), options};
}

/// An arm on an ideal plant, driven through its box by random commands of every kind.
class Arm {
 public:
  Arm(unsigned seed, Law law)
      : setup_(setup(law)),
        controller_(setup_.chain, setup_.robot, setup_.limits, setup_.instrument, setup_.tool,
                    setup_.options),
        box_(controller_, setup_),
        random_(seed) {
    in_.state_valid = true;
    in_.q = setup_.robot.home;
    in_.qd = JointVector::Zero(6);
    const Pose X_BF = setup_.chain.forward(in_.q);
    box_.set_rcm(X_BF * setup_.tool.p_FTip - 0.12 * (X_BF.linear() * setup_.tool.s_F));
    tick();
    EXPECT_EQ(box_.request(StateCommand::kHome), Reason::kNone);
    EXPECT_EQ(box_.request(StateCommand::kEnable), Reason::kNone);
    tick();
  }

  const Outputs& tick() {
    const Outputs& out = box_.step(in_);
    in_.n_commands = 0;
    in_.q += kT * out.qd_command;
    in_.qd = out.qd_command;
    out_ = &out;
    return out;
  }

  MotionCommand any_command() {
    MotionCommand command;
    command.motion = static_cast<Motion>(random_.integer(0, 16));
    command.source = static_cast<std::uint32_t>(random_.integer(1, 2));
    const Vector3 p_RSet = controller_.X_BR().inverse() * out_->p_set;
    const double far = random_.integer(0, 3) == 0 ? 0.02 : 0.001;
    for (int i = 0; i < 3; ++i) command.p[i] = p_RSet[i] + random_.uniform(-far, far);
    if (command.motion == Motion::kServoCv) command.p = 10 * (command.p - p_RSet);
    command.joints = out_->virtual_set;
    for (int i = 0; i < 4; ++i) command.joints[i] += random_.uniform(-far, far);
    if (command.motion == Motion::kServoJv) command.joints -= out_->virtual_set;
    if (command.motion == Motion::kServoJr || command.motion == Motion::kMoveJr) {
      command.joints -= out_->virtual_set;
    }
    command.rotation = controller_.tool_orientation(out_->s_B, out_->roll_set);
    command.roll_rate = random_.uniform(-0.5, 0.5);
    command.jaw = random_.uniform(0, 1);
    return command;
  }

  /// Steps with streams, calls and faults in between; commands not finite where 'harsh'.
  void run(int steps, bool harsh) {
    int burst = 0;
    MotionCommand command;
    for (int k = 0; k < steps; ++k) {
      if (burst-- <= 0) {
        burst = random_.integer(1, 80);
        command = any_command();
      }
      if (random_.integer(0, 3) > 0) {
        if (random_.integer(0, 1) > 0) {
          const Motion motion = command.motion;
          command = any_command();
          command.motion = motion;
        }
        in_.commands[in_.n_commands++] = command;
      }
      in_.track_valid = random_.integer(0, 200) > 0;
      in_.tip_force = {random_.integer(0, 1) == 0, Vector3(random_.uniform(0, 5.5), 0, 0)};
      in_.track_age = random_.uniform(0, 0.02);
      in_.p_BTrack = out_->p_BRcm;
      if (random_.integer(0, 150) == 0) box_.request(static_cast<StateCommand>(k % 6));
      if (random_.integer(0, 100) == 0) box_.request(StateCommand::kEnable);
      if (random_.integer(0, 100) == 0) box_.request(StateCommand::kResume);
      if (random_.integer(0, 200) == 0) box_.request(StateCommand::kHome);
      if (random_.integer(0, 300) == 0) box_.pause(Reason::kOverrun);
      if (random_.integer(0, 300) == 0) box_.claim(1);
      if (random_.integer(0, 300) == 0) {
        box_.set_rcm(out_->p_BTip - out_->depth * out_->s_B);
      }
      if (random_.integer(0, 250) == 0) box_.set_fixture(wall_before_the_tip());
      if (random_.integer(0, 500) == 0) box_.remove_fixture("wall");
      if (harsh && random_.integer(0, 400) == 0 && in_.n_commands > 0) {
        in_.commands[0].p.x() = std::nan("");
      }
      in_.state_valid = !harsh || random_.integer(0, 500) > 0;
      tick();
    }
    in_.state_valid = true;
  }

  /// A keep-out sphere 2 to 20 mm from the tip.
  Fixture wall_before_the_tip() {
    const Vector3 to = Vector3(random_.normal(), random_.normal(), random_.normal()).normalized();
    const double radius = 0.01;
    const Vector3 center = out_->p_BTip + (radius + random_.uniform(0.002, 0.02)) * to;
    return test::fixture("wall", Fixture::Shape::kSphere, Fixture::Side::kKeepOut, center,
                         Vector3::Zero(), radius);
  }

  BlackBox& box() { return box_; }
  const Controller& controller() const { return controller_; }
  const Outputs& out() const { return *out_; }
  Inputs& in() { return in_; }
  Random& random() { return random_; }

 private:
  ControllerSetup setup_;
  Controller controller_;
  BlackBox box_;
  Random random_;
  Inputs in_;
  const Outputs* out_ = nullptr;
};

BlackBoxLabel label() { return {"PSM1", "cells/sim", "2026-01-01T00:00:00Z", "0.1.0"}; }

std::string told(const std::optional<BlackBoxDifference>& difference) {
  if (!difference) return "none";
  return "step " + std::to_string(difference->step) + ", " + difference->field + ": recorded " +
         difference->recorded + ", replayed " + difference->replayed;
}

/// A run with a fault in it or at its end, and its frozen box.
std::unique_ptr<Arm> incident(unsigned seed, Law law) {
  auto arm = std::make_unique<Arm>(seed, law);
  arm->run(arm->random().integer(10, 3000), false);
  if (!arm->box().frozen()) arm->box().fault(Reason::kNotFinite);
  for (int k = 0; k < 1000 && !arm->box().frozen(); ++k) arm->tick();
  EXPECT_TRUE(arm->box().frozen());
  return arm;
}

TEST(BlackBox, AFaultFreezesItAndItsFileRunsAgainBitForBit) {
  long steps = 0;
  const int runs = test::family(30, 500);
  for (int seed = 0; seed < runs; ++seed) {
    const auto arm = incident(seed, static_cast<Law>(seed % 3));
    const BlackBoxRecording recording = arm->box().recording(label());
    const BlackBoxRecording read = decode(encode(recording));
    ASSERT_EQ(read.steps.size(), recording.steps.size());
    ASSERT_EQ(read.label.cell, "cells/sim");
    const auto difference = replay(read);
    ASSERT_FALSE(difference) << "seed " << seed << ": " << told(difference);
    const std::size_t fault = read.steps.size() - 1 - BlackBox::kAfter;
    ASSERT_EQ(read.steps[fault].out.state, State::kFault);
    ASSERT_TRUE(fault == 0 || read.steps[fault - 1].out.state != State::kFault);
    steps += static_cast<long>(read.steps.size());
  }
  test::report("steps replayed bit for bit", steps);
}

TEST(BlackBox, GoesOnFromAnyImageLikeTheOneThatWasSaved) {
  // Whatever member is missing from the image shows up here: random runs of every kind of command.
  const int runs = test::family(100, 1500);
  long steps = 0;
  for (int seed = 0; seed < runs; ++seed) {
    Arm arm(seed, static_cast<Law>(seed % 3));
    arm.run(arm.random().integer(0, 900), true);
    const std::size_t size = arm.controller().save(nullptr, 0);
    ASSERT_GT(size, 0U);
    arm.box().release();
    arm.run(1100, true);
    const BlackBoxRecording recording = arm.box().recording(label());
    const auto difference = replay(recording);
    ASSERT_FALSE(difference) << "seed " << seed << ": " << told(difference);
    steps += static_cast<long>(recording.steps.size());
  }
  test::report("steps replayed from random images", steps);
}

TEST(BlackBox, AFixtureOfTheRunIsPartOfTheReplay) {
  using Kind = BlackBoxEvent::Kind;
  int set = 0, removed = 0, missed = 0;
  for (int seed = 0; seed < 40; ++seed) {
    Arm arm(seed, Law::kExact);
    arm.run(1000, false);
    BlackBoxRecording recording = arm.box().recording(label());
    const auto difference = replay(decode(encode(recording)));
    ASSERT_FALSE(difference) << "seed " << seed << ": " << told(difference);
    for (BlackBoxEvent& event : recording.events) {
      const bool taken = event.answer == Reason::kNone;
      removed += event.kind == Kind::kRemoveFixture && taken;
      if (event.kind != Kind::kSetFixture || !taken) continue;
      ++set;
      event.fixture.point = arm.out().p_BTip;  // the tip stands within the region
      event.fixture.radius = 0.05;
    }
    missed += !replay(recording);
  }
  test::report("fixtures set in the runs", set);
  EXPECT_GT(set, 20);
  EXPECT_GT(removed, 2);
  EXPECT_LT(missed, 10) << "runs whose replay does not notice other fixtures";
}

TEST(BlackBox, HoldsTwoSecondsWithWhatFollowedTheFault) {
  Arm arm(1, Law::kVelocity);
  arm.run(5000, false);
  arm.box().release();
  arm.box().trigger();
  int k = 0;
  while (!arm.box().frozen()) {
    arm.tick();
    ASSERT_LE(++k, BlackBox::kAfter);
  }
  const std::size_t held = arm.box().recording(label()).steps.size();
  EXPECT_GE(held, 1000U + BlackBox::kAfter);
  EXPECT_LE(held, std::size_t(BlackBox::kBlocks * BlackBox::kBlockSteps));
  // Frozen: nothing is taken in, the controller goes on.
  arm.run(10, false);
  EXPECT_EQ(arm.box().recording(label()).steps.size(), held);
  arm.box().release();
  arm.run(10, false);
  const BlackBoxRecording again = arm.box().recording(label());
  EXPECT_EQ(again.steps.size(), 10U);
  EXPECT_FALSE(replay(again));
}

TEST(BlackBox, AFloodOfCommandsShortensTheRecordingAndBreaksNothing) {
  Arm arm(2, Law::kVelocity);
  for (int k = 0; k < 300; ++k) {
    while (arm.in().n_commands < kMaxCommands) {
      arm.in().commands[arm.in().n_commands++] = arm.any_command();
    }
    for (int i = 0; i < 20; ++i) arm.box().request(StateCommand::kEnable);
    arm.tick();
  }
  const BlackBoxRecording recording = arm.box().recording(label());
  EXPECT_GE(recording.steps.size(), 40U);
  const auto difference = replay(recording);
  EXPECT_FALSE(difference) << told(difference);
}

TEST(BlackBox, TheReplayNamesTheFirstDifference) {
  const auto arm = incident(5, Law::kVelocity);
  const BlackBoxRecording good = arm->box().recording(label());
  ASSERT_GT(good.steps.size(), 100U);

  BlackBoxRecording changed = good;  // one bit of one output
  double& qd = changed.steps[50].out.qd_command[3];
  qd = std::nextafter(qd, 1.0);
  auto difference = replay(changed);
  ASSERT_TRUE(difference);
  EXPECT_EQ(difference->step, 50U);
  EXPECT_EQ(difference->field, "qd_command");
  EXPECT_NE(difference->recorded, difference->replayed);

  changed = good;  // a trifle of one input
  changed.steps[60].in.q[0] += 1e-14;
  difference = replay(changed);
  ASSERT_TRUE(difference);
  EXPECT_EQ(difference->step, 60U);
  EXPECT_EQ(difference->field, "X_BF");

  changed = good;  // another controller
  changed.setup.limits.stop_deceleration *= 1.0000001;
  changed.setup.robot.tuning.tip_gain += 1e-12;
  EXPECT_TRUE(replay(changed)) << "the gain is in every command";

  changed = good;  // another build
  changed.image.pop_back();
  EXPECT_THROW(replay(changed), BlackBoxError);
}

/// Every field of a cycle is recorded and compared: one that is changed is the one that is named.
TEST(BlackBox, TheReplayComparesEveryFieldOfACycle) {
  const auto arm = incident(5, Law::kExact);
  const BlackBoxRecording recording = arm->box().recording(label());
  const struct {
    const char* name;
    void (*change)(Outputs&);
  } fields[] = {{"state", [](Outputs& o) { o.state = State::kFault; }},
                {"reason", [](Outputs& o) { o.reason = Reason::kLate; }},
                {"homed", [](Outputs& o) { o.homed = !o.homed; }},
                {"busy", [](Outputs& o) { o.busy = !o.busy; }},
                {"motion", [](Outputs& o) { o.motion = Motion::kJawMoveJp; }},
                {"source", [](Outputs& o) { o.source += 1; }},
                {"accepted", [](Outputs& o) { o.accepted += 1; }},
                {"refused", [](Outputs& o) { o.refused += 1; }},
                {"warn_rcm", [](Outputs& o) { o.warn_rcm = !o.warn_rcm; }},
                {"warn_force", [](Outputs& o) { o.warn_force = !o.warn_force; }},
                {"X_BF", [](Outputs& o) { o.X_BF.translation().x() += 1e-9; }},
                {"p_BTip", [](Outputs& o) { o.p_BTip.x() += 1e-9; }},
                {"s_B", [](Outputs& o) { o.s_B.x() += 1e-9; }},
                {"p_BRcm", [](Outputs& o) { o.p_BRcm.x() += 1e-9; }},
                {"v_BTip", [](Outputs& o) { o.v_BTip.x() += 1e-9; }},
                {"roll", [](Outputs& o) { o.roll += 1e-9; }},
                {"depth", [](Outputs& o) { o.depth += 1e-9; }},
                {"rcm_error", [](Outputs& o) { o.rcm_error += 1e-9; }},
                {"virtual_q", [](Outputs& o) { o.virtual_q[0] += 1e-9; }},
                {"virtual_qd", [](Outputs& o) { o.virtual_qd[0] += 1e-9; }},
                {"virtual_set", [](Outputs& o) { o.virtual_set[0] += 1e-9; }},
                {"p_goal", [](Outputs& o) { o.p_goal.x() += 1e-9; }},
                {"p_set", [](Outputs& o) { o.p_set.x() += 1e-9; }},
                {"v_set", [](Outputs& o) { o.v_set.x() += 1e-9; }},
                {"roll_goal", [](Outputs& o) { o.roll_goal += 1e-9; }},
                {"roll_set", [](Outputs& o) { o.roll_set += 1e-9; }},
                {"jaw_set", [](Outputs& o) { o.jaw_set += 1; }},
                {"jaw", [](Outputs& o) { o.jaw += 1; }},
                {"scale", [](Outputs& o) { o.scale += 1e-9; }},
                {"limited_by", [](Outputs& o) { o.limited_by = "nothing"; }},
                {"clearance", [](Outputs& o) { o.clearance = 0; }},
                {"tier", [](Outputs& o) { o.tier += 1; }},
                {"qd_command", [](Outputs& o) { o.qd_command[0] += 1e-9; }},
                {"twist_command", [](Outputs& o) { o.twist_command[0] += 1e-9; }}};
  for (const auto& field : fields) {
    BlackBoxRecording changed = recording;
    field.change(changed.steps[50].out);
    const auto difference = replay(decode(encode(changed)));
    ASSERT_TRUE(difference) << field.name;
    EXPECT_EQ(difference->step, 50U);
    EXPECT_EQ(difference->field, field.name);
  }
}

TEST(BlackBox, ADamagedFileIsRefusedWithWords) {
  const auto arm = incident(6, Law::kVelocity);
  const std::string good = encode(arm->box().recording(label()));
  ASSERT_FALSE(replay(decode(good)));
  const auto refused = [](const std::string& bytes) -> std::string {
    try {
      decode(bytes);
    } catch (const BlackBoxError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(refused("").find("not a black box"), std::string::npos);
  EXPECT_NE(refused("a,b\n1,2\n").find("not a black box"), std::string::npos);
  EXPECT_NE(refused(good.substr(0, 12)).find("cut short"), std::string::npos);
  EXPECT_NE(refused(good.substr(0, good.size() - 1)).find("length"), std::string::npos);
  EXPECT_NE(refused(good + "x").find("length"), std::string::npos);
  std::string bytes = good;
  bytes[8] = 9;
  EXPECT_NE(refused(bytes).find("version 9"), std::string::npos);
  Random random(7);
  const int cases = test::family(100, 2000);
  for (int i = 0; i < cases; ++i) {
    bytes = good;
    const int at = random.integer(20, static_cast<int>(good.size()) - 1);
    bytes[static_cast<std::size_t>(at)] ^= static_cast<char>(1 << random.integer(0, 7));
    ASSERT_NE(refused(bytes).find("checksum"), std::string::npos) << "byte " << at;
  }
  test::report("flipped bits", cases);
}

TEST(BlackBox, MadeUpContentsWithARightChecksumAreRefusedToo) {
  // Lengths and names are not trusted, whoever wrote the file.
  const auto arm = incident(8, Law::kVelocity);
  const std::string good = encode(arm->box().recording(label()));
  const auto sealed = [](std::string bytes) {
    std::uint64_t hash = 1469598103934665603ULL;
    for (std::size_t i = 20; i + 8 < bytes.size(); ++i) {
      hash = (hash ^ static_cast<unsigned char>(bytes[i])) * 1099511628211ULL;
    }
    std::memcpy(&bytes[bytes.size() - 8], &hash, 8);
    return bytes;
  };
  ASSERT_NO_THROW(decode(sealed(good)));
  Random random(9);
  const int cases = test::family(100, 1000);
  int refused = 0;
  for (int i = 0; i < cases; ++i) {
    std::string bytes = good;
    const bool front = random.integer(0, 1) == 0;
    const int at = random.integer(20, front ? 3000 : static_cast<int>(good.size()) - 9);
    bytes[static_cast<std::size_t>(at)] = static_cast<char>(random.integer(0, 255));
    try {
      decode(sealed(bytes));
    } catch (const BlackBoxError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 0);
  test::report("made-up files refused", refused);
}

TEST(BlackBox, EveryMotionAndEveryCallLeaveTheHeapAlone) {
#if !SURG_HEAP_IS_WATCHED
  GTEST_SKIP() << "the heap cannot be watched under a sanitizer";
#else
  std::array<int, 17> accepted{};
  long calls = 0;
  for (const Law law : {Law::kVelocity, Law::kPaper, Law::kExact}) {
    Arm arm(3, law);
    for (int k = 0; k < 6000; ++k) {
      const bool out = arm.out().depth < 0.031;  // back in, or all but insert is refused
      MotionCommand command = arm.any_command();
      command.source = 1;
      if (k % 7 == 0 && out) command.motion = Motion::kInsert;
      if (k % 50 == 0) command.p.x() = std::nan("");
      if (k % 25 < 3) arm.in().commands[arm.in().n_commands++] = command;
      test::HeapWatch watch;
      arm.box().request(StateCommand::kEnable);
      if (k % 100 == 0) arm.box().claim(1);
      if (k % 700 == 0) arm.box().pause(Reason::kOverrun);
      if (k % 700 == 50) arm.box().request(StateCommand::kResume);
      arm.tick();
      calls += watch.calls();
      for (int i = 0; i < arm.out().n_verdicts; ++i) {
        const Verdict& verdict = arm.out().verdicts[i];
        accepted[static_cast<std::size_t>(verdict.motion)] += verdict.reason == Reason::kNone;
      }
    }
  }
  EXPECT_EQ(calls, 0);
  for (std::size_t motion = 1; motion < accepted.size(); ++motion) {
    EXPECT_GT(accepted[motion], 0) << "motion " << motion << " was never under way";
  }
#endif
}

}  // namespace
}  // namespace surg
