// wait() of a CRTK client under drawn scheduling: every move ends for the client, whatever is lost.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <random>
#include <vector>

#include "support/ideal_arm.hpp"
#include "surg_control/topics/state_edges.hpp"

namespace surg_control {
namespace {

struct Message {
  double stamp;  // [ticks]
  bool busy;
};

/// What the public Python client keeps of operating_state, and when its wait() ends.
class Client {
 public:
  void hear(const Message& message) {
    if (message.busy && message.stamp > last_busy_) last_busy_ = message.stamp;
    if (message.stamp <= newest_) return;
    newest_ = message.stamp;
    busy_ = message.busy;
  }
  bool waited(double since) const { return last_busy_ > since && !busy_; }

 private:
  double last_busy_ = -1, newest_ = -1;
  bool busy_ = false;
};

/// Controller, ring of records, publisher and client, all on one drawn schedule.
class Machine {
 public:
  explicit Machine(unsigned seed) : dice_(seed) {
    arm_.enable();
    arm_.step();
  }

  /// Ticks that a client waits for commands that arrive together some ticks later; -1: in vain.
  std::int64_t wait_for(const std::vector<CommandItem>& items) {
    constexpr std::int64_t kPatience = 3000;             // 6 s
    const auto since = static_cast<double>(now_) + 0.5;  // after all that this tick published
    const std::int64_t due = now_ + draw(1, 25);
    while (now_ - due < kPatience) {
      tick(now_ + 1 == due ? items : std::vector<CommandItem>());
      if (now_ > due && client_.waited(since)) return now_ - due;
    }
    return -1;
  }

  void tick(const std::vector<CommandItem>& items = {}) {
    ++now_;
    CycleRecord record = arm_.step(items);
    record.tick = static_cast<std::uint64_t>(now_);
    if (ring_.size() < kRing) ring_.push_back(record);
    if (--stalled_ > 0) return;
    while (!ring_.empty()) publish();
    if (draw(0, 199) == 0) stalled_ = draw(2, 1000);  // the publisher gets no CPU for up to 2 s
  }

  IdealArm& arm() { return arm_; }
  int draw(int least, int most) { return std::uniform_int_distribution<int>(least, most)(dice_); }

 private:
  static constexpr std::size_t kRing = 64;

  void publish() {
    const StateEdges::Report report = edges_.next(ring_.front());
    ring_.pop_front();
    stamp_ = std::max(stamp_ + 1e-6, static_cast<double>(now_));
    if (report.due) client_.hear({stamp_, report.busy});
  }

  std::mt19937 dice_;
  IdealArm arm_;
  StateEdges edges_;
  Client client_;
  std::deque<CycleRecord> ring_;
  std::int64_t now_ = 0;
  double stamp_ = 0;
  int stalled_ = 0;
};

/// Whether a client that sends this to a homed, enabled arm hears of a busy arm afterwards.
bool is_busy_after(const std::vector<CommandItem>& items) {
  IdealArm arm;
  arm.enable();
  StateEdges edges;
  CycleRecord record = arm.step();
  for (int settled = 0; settled < 20; ++settled) record = arm.step();
  edges.next(record);
  bool busy = edges.next(arm.step(items)).busy;
  for (int later = 0; later < 20; ++later) busy = busy || edges.next(arm.step()).busy;
  return busy;
}

/// A drawn move, and now and then what ends it in its own cycle.
std::vector<CommandItem> drawn_commands(Machine& machine) {
  using surg::Motion;
  ToolPose target = machine.arm().tip();
  const int kind = machine.draw(0, 6);
  if (kind == 0) target.p.x() += 1e-3 * machine.draw(-5, 5);
  if (kind == 1) target.p.x() += 1.0;  // refused: outside the workspace
  CommandItem move = IdealArm::pose(Motion::kMoveCp, target);
  if (kind == 2) move.frame = FrameName("elsewhere");  // refused
  if (kind == 3) {
    move.motion.motion = Motion::kJawMoveJp;
    move.motion.jaw = 0.2;
  }
  std::vector<CommandItem> items = {move};
  if (kind == 4) items.push_back(IdealArm::pose(Motion::kHold, target));
  if (kind == 5) items.push_back(IdealArm::state(surg::StateCommand::kPause));
  if (kind == 6) items.insert(items.begin(), IdealArm::state(surg::StateCommand::kHome));
  return items;
}

TEST(StateEdges, EveryWaitOfAClientEndsWhateverTheScheduling) {
  const int count = std::getenv("SURG_TEST_FULL") != nullptr ? 5000 : 250;
  Machine machine(7);
  std::int64_t longest = 0;
  int in_vain = 0, moved = 0;
  for (int i = 0; i < count; ++i) {
    const std::int64_t ticks = machine.wait_for(drawn_commands(machine));
    in_vain += ticks < 0;
    const surg::Outputs& out = machine.arm().cycle->record().out;
    moved += out.state == surg::State::kEnabled && ticks > 200;
    longest = std::max(longest, ticks);
    if (out.state == surg::State::kPaused && machine.draw(0, 1) == 0) {
      machine.tick({IdealArm::state(surg::StateCommand::kResume)});
    }
  }
  std::printf("%d waits, %d of motions, %d in vain, the longest other one %.2f s\n", count, moved,
              in_vain, static_cast<double>(longest) * kTick);
  EXPECT_EQ(in_vain, 0);
  EXPECT_GT(moved, count / 8);
}

TEST(StateEdges, AMoveSentDuringAnotherOneHasAnEdgeOfItsOwn) {
  StateEdges edges;
  CycleRecord record;
  record.tick = 1;
  record.out.busy = true;
  record.moves = 1;
  EXPECT_TRUE(edges.next(record).due);
  EXPECT_FALSE(edges.next(record).due);
  record.moves_refused_by_node = 1;
  const StateEdges::Report report = edges.next(record);
  EXPECT_TRUE(report.due && report.busy);
}

TEST(StateEdges, EnableAndHomeOfAHomedArmAreNoMoveThatAClientCouldWaitFor) {
  using surg::StateCommand;
  const CommandItem enable = IdealArm::state(StateCommand::kEnable);
  const CommandItem home = IdealArm::state(StateCommand::kHome);
  EXPECT_FALSE(is_busy_after({enable}));
  EXPECT_FALSE(is_busy_after({home}));
  EXPECT_FALSE(is_busy_after({enable, home}));
  // Homed anew in the same cycle: that is one.
  EXPECT_TRUE(is_busy_after({IdealArm::state(StateCommand::kDisable),
                             IdealArm::state(StateCommand::kUnhome), enable, home}));
}

}  // namespace
}  // namespace surg_control
