// Lock-step: whatever order the network chooses, the controller sees one order.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "surg_control/loop/lockstep_gate.hpp"

namespace surg_control {
namespace {

CommandItem item(std::uint32_t mark, CommandItem::Kind kind = CommandItem::Kind::kMotion) {
  CommandItem made;
  made.kind = kind;
  made.source = mark;
  return made;
}

std::vector<std::uint32_t> marks(const std::vector<CommandItem>& items) {
  std::vector<std::uint32_t> all;
  for (const CommandItem& one : items) all.push_back(one.source);
  return all;
}

void send(LockstepGate& gate, const std::string& sender, const std::string& topic,
          const CommandItem& one) {
  gate.received(sender);
  gate.push(sender, topic, one);
}

TEST(LockstepGate, WithoutParticipantsAlwaysDue) {
  const LockstepGate gate({});
  EXPECT_TRUE(gate.due(1));
  EXPECT_EQ(gate.missing(1), "");
}

TEST(LockstepGate, WaitsForReadyAndForEveryMessage) {
  LockstepGate gate({"operator", "assistant"});
  EXPECT_FALSE(gate.due(1));
  gate.ready("operator", 1, 2);
  gate.ready("assistant", 1, 0);
  EXPECT_FALSE(gate.due(1));
  EXPECT_NE(gate.missing(1).find("operator has sent 2 messages of which 0"), std::string::npos);
  send(gate, "operator", "servo_cp", item(1));
  gate.received("operator");  // one that was refused while decoding counts as well
  EXPECT_TRUE(gate.due(1));
  EXPECT_EQ(gate.missing(1), "");
  EXPECT_FALSE(gate.due(2));  // ready for 1 is not ready for 2
  gate.ready("assistant", 2, 0);
  EXPECT_FALSE(gate.due(2));
  gate.ready("operator", 2, 2);
  EXPECT_TRUE(gate.due(2));
  gate.ready("operator", 1, 9);  // late and old: no effect
  EXPECT_TRUE(gate.due(2));
  gate.ready("recorder", 7, 3);  // nobody waits for an undeclared one
  EXPECT_TRUE(gate.due(2));
}

TEST(LockstepGate, AReadyCountsFromTheOneBefore) {
  LockstepGate gate({"policy"});
  gate.ready("policy", 25, 1);
  EXPECT_FALSE(gate.due(1));  // its message has not come
  gate.received("policy");
  EXPECT_TRUE(gate.due(1) && gate.due(25) && !gate.due(26));
  gate.ready("policy", 50, 1);
  gate.ready("policy", 50, 1);
  EXPECT_TRUE(gate.due(26) && gate.due(50));
  EXPECT_FALSE(gate.due(25));  // what it sends for 26 must not be taken earlier
}

TEST(LockstepGate, OneOrderForEveryArrival) {
  struct Sent {
    std::string sender, topic;
    std::vector<CommandItem> items;
  };
  // Streams as TCP keeps them: in order within (sender, topic), in any order between them.
  const std::vector<Sent> streams{
      {"b", "servo_cp", {item(10), item(11)}},
      {"b", "jaw/servo_jp", {item(12)}},
      {"a", "servo_cp", {item(20), item(21), item(22)}},
      {"a", "rcm/set_cp", {item(23, CommandItem::Kind::kSetRcm)}},
      {"b",
       "state_command",
       {item(1, CommandItem::Kind::kState), item(2, CommandItem::Kind::kState)}},
      {"a", "state_command", {item(3, CommandItem::Kind::kState)}},
  };
  const std::vector<std::uint32_t> expected{3, 1, 2, 23, 20, 21, 22, 12, 10, 11};
  std::mt19937 random(1);
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<std::size_t> order;
    for (std::size_t i = 0; i < streams.size(); ++i) {
      order.insert(order.end(), streams[i].items.size(), i);
    }
    std::shuffle(order.begin(), order.end(), random);
    std::vector<std::size_t> next(streams.size(), 0);
    LockstepGate gate({"b", "a"});
    for (const std::size_t i : order) {
      send(gate, streams[i].sender, streams[i].topic, streams[i].items[next[i]++]);
    }
    ASSERT_EQ(marks(gate.take()), expected);
    ASSERT_TRUE(gate.take().empty());
  }
}

TEST(LockstepGate, UndeclaredComeLastAsTheyCame) {
  LockstepGate gate({"z"});
  send(gate, "stranger", "servo_cp", item(5));
  send(gate, "a", "move_cp", item(6));
  send(gate, "z", "servo_cp", item(1));
  send(gate, "stranger", "hold", item(7));
  EXPECT_FALSE(gate.declared("stranger"));
  EXPECT_EQ(marks(gate.take()), (std::vector<std::uint32_t>{1, 5, 6, 7}));
}

TEST(LockstepGate, WhatIsLeftOverComesBeforeWhatIsNew) {
  std::mt19937 random(2);
  for (int trial = 0; trial < 50; ++trial) {
    // 50 commands of each in every tick: 36 are left over after the first, 72 after the second.
    LockstepGate gate({"a", "b"});
    std::uint32_t mark = 0;
    std::vector<std::uint32_t> expected, got;
    for (int tick = 0; tick < 3; ++tick) {
      std::vector<std::pair<std::string, std::uint32_t>> letters;
      for (const char* sender : {"a", "b"}) {
        for (int k = 0; k < 50; ++k) {
          letters.emplace_back(sender, mark);
          expected.push_back(mark++);  // tick by tick, sender by sender, each in its own order
        }
      }
      // The network mixes the two senders, and leaves each in order.
      std::vector<char> turns(100, 'a');
      std::fill(turns.begin() + 50, turns.end(), 'b');
      std::shuffle(turns.begin(), turns.end(), random);
      std::size_t next_a = 0, next_b = 50;
      for (const char turn : turns) {
        const auto& [sender, number] = letters[turn == 'a' ? next_a++ : next_b++];
        send(gate, sender, "servo_cp", item(number));
      }
      const std::vector<std::uint32_t> taken = marks(gate.take());
      ASSERT_EQ(taken.size(), static_cast<std::size_t>(surg::kMaxCommands));
      got.insert(got.end(), taken.begin(), taken.end());
    }
    while (true) {
      const std::vector<std::uint32_t> taken = marks(gate.take());
      if (taken.empty()) break;
      got.insert(got.end(), taken.begin(), taken.end());
    }
    ASSERT_EQ(got, expected);
  }
}

TEST(LockstepGate, AStateCommandIsNotHeldUpByALeftOver) {
  LockstepGate gate({"a", "b"});
  for (std::uint32_t i = 0; i < 200; ++i) send(gate, "a", "servo_cp", item(i));
  gate.take();
  send(gate, "b", "state_command", item(999, CommandItem::Kind::kState));
  EXPECT_EQ(marks(gate.take()).front(), 999U);
}

TEST(LockstepGate, AFloodIsRefusedAndOthersAreNot) {
  LockstepGate gate({"a", "b"});
  std::size_t kept = 0;
  for (std::uint32_t i = 0; i < 3000; ++i) kept += gate.push("a", "servo_cp", item(i));
  EXPECT_EQ(kept, LockstepGate::kMostWaiting);
  EXPECT_TRUE(gate.push("a", "servo_jp", item(1)));
  EXPECT_TRUE(gate.push("b", "servo_cp", item(1)));
  gate.take();  // makes room for as many as it took
  kept = 0;
  for (std::uint32_t i = 0; i < 3000; ++i) kept += gate.push("a", "servo_cp", item(i));
  EXPECT_EQ(kept, static_cast<std::size_t>(surg::kMaxCommands));
}

}  // namespace
}  // namespace surg_control
