// Which cycle a command answers, by the stamp that it carries back.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <random>
#include <vector>

#include "surg_control/loop/stamp_history.hpp"

namespace surg_control {
namespace {

using surg::Motion;

constexpr std::uint64_t kWall = 1'700'000'000'000'000'000;  // stamps of a link in free-run

/// Cycles with uneven stamps, as a link on a wall clock has them.
class Cycles {
 public:
  explicit Cycles(unsigned seed) : random_(seed) {}

  std::uint64_t next(Motion motion) {
    stamp_ += kTickNs - 100'000 + random_() % 200'000;
    history.add(stamp_, motion);
    return stamp_;
  }

  std::uint64_t repeat(int n, Motion motion) {
    std::uint64_t last = 0;
    for (int k = 0; k < n; ++k) last = next(motion);
    return last;
  }

  StampHistory history;

 private:
  std::minstd_rand random_;
  std::uint64_t stamp_ = kWall;
};

TEST(StampHistory, WhatAnswersACycleFromBeforeTheStopIsLate) {
  Cycles cycles(1);
  const std::uint64_t streamed = cycles.repeat(100, Motion::kServoCp);
  EXPECT_FALSE(cycles.history.is_late(streamed));  // the stream has not ended
  const std::uint64_t stopped = cycles.next(Motion::kNone);
  EXPECT_TRUE(cycles.history.is_late(streamed));
  EXPECT_TRUE(cycles.history.is_late(streamed + kTickNs));  // meant for the next cycle
  EXPECT_FALSE(cycles.history.is_late(stopped));  // this one says that the arm has stopped
  EXPECT_FALSE(cycles.history.is_late(stopped + kTickNs));
}

TEST(StampHistory, AStampOfAnotherClockDecidesNothing) {  // F09
  Cycles cycles(2);
  cycles.repeat(100, Motion::kServoCp);
  cycles.next(Motion::kNone);
  EXPECT_FALSE(cycles.history.is_late(0));
  EXPECT_FALSE(cycles.history.is_late(kWall + 50'000'003));         // between two cycles
  EXPECT_FALSE(cycles.history.is_late(kWall - 3'600'000'000'000));  // an hour slow
  EXPECT_FALSE(cycles.history.is_late(kWall + 3'600'000'000'000));  // an hour fast
  Cycles silent(3);
  for (int k = 0; k < 5; ++k) silent.history.add(0, Motion::kServoCp);  // no joint state yet
  silent.history.add(0, Motion::kNone);
  EXPECT_FALSE(silent.history.is_late(0));
  EXPECT_FALSE(silent.history.is_late(kTickNs));
}

TEST(StampHistory, AStreamThatAnotherMotionReplacesHasNotBeenStopped) {
  Cycles cycles(4);
  const std::uint64_t streamed = cycles.repeat(10, Motion::kServoCp);
  cycles.repeat(10, Motion::kMoveCp);
  EXPECT_FALSE(cycles.history.is_late(streamed));
  cycles.next(Motion::kNone);  // the end of a move is no end of a stream
  EXPECT_FALSE(cycles.history.is_late(streamed));
}

TEST(StampHistory, IsForgottenAfterFourSeconds) {
  Cycles cycles(5);
  const std::uint64_t streamed = cycles.repeat(10, Motion::kServoJp);
  cycles.repeat(static_cast<int>(StampHistory::kCycles) - 1, Motion::kNone);
  EXPECT_TRUE(cycles.history.is_late(streamed));
  cycles.next(Motion::kNone);
  EXPECT_FALSE(cycles.history.is_late(streamed));
}

/// Random stretches of streaming and rest, against a plain list of everything.
TEST(StampHistory, AgreesWithAListOfAllCycles) {
  int asked = 0, is_late = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    Cycles cycles(seed);
    std::minstd_rand random(seed + 1000);
    std::vector<std::uint64_t> stamps;
    std::size_t ended = 0;
    bool streams = false;
    for (int k = 0; k < 400; ++k) {
      if (random() % 20 == 0) {
        if (streams) ended = stamps.size();
        streams = !streams;
      }
      stamps.push_back(cycles.next(streams ? Motion::kServoCp : Motion::kNone));
      const std::size_t answers = random() % stamps.size();
      EXPECT_EQ(cycles.history.is_late(stamps[answers]), answers < ended);
      is_late += answers < ended;
      ++asked;
    }
  }
  EXPECT_GT(is_late, asked / 4);
  std::printf("%d stamps looked up, %d of them is_late\n", asked, is_late);
}

/// A clock that is set and a link that falls silent leave stamps in no order: every one of the last
/// four seconds is asked for, and the ticks beside it, against a walk through all of them.
TEST(StampHistory, AgreesWithAWalkWhereTheClockIsSet) {
  int asked = 0, is_late = 0, steps = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    StampHistory history;
    std::minstd_rand random(seed);
    std::vector<std::uint64_t> stamps;
    std::size_t ended = 0;
    bool streams = false;
    std::uint64_t clock = kWall;
    for (int k = 0; k < 5000; ++k) {
      clock += kTickNs;
      if (random() % 700 == 0) {
        clock += kTickNs * (random() % 2000);
        clock -= kTickNs * (random() % 2000);
        ++steps;
      }
      if (random() % 300 == 0) {
        if (streams) ended = stamps.size();
        streams = !streams;
      }
      const std::uint64_t stamp = random() % 400 == 0 ? 0 : clock;
      stamps.push_back(stamp);
      history.add(stamp, streams ? Motion::kServoCp : Motion::kNone);
      if (k % 250 != 249) continue;
      const std::size_t oldest = stamps.size() - std::min(stamps.size(), StampHistory::kCycles);
      const auto walk = [&](std::uint64_t answers) {
        for (std::size_t i = oldest; i < ended; ++i) {
          const std::uint64_t own = stamps[i];
          if (own != 0 && (answers == own || answers == own + kTickNs)) return true;
        }
        return false;
      };
      for (std::size_t i = oldest; i < stamps.size(); i += 1 + random() % 60) {
        for (const std::uint64_t beside : {-kTickNs, std::uint64_t{0}, kTickNs, 2 * kTickNs}) {
          const std::uint64_t answers = stamps[i] + beside;
          const bool expected = answers != 0 && walk(answers);
          ASSERT_EQ(history.is_late(answers), expected) << "seed " << seed << ", cycle " << k;
          is_late += expected;
          ++asked;
        }
      }
    }
  }
  EXPECT_GT(is_late, asked / 10);
  EXPECT_GT(asked - is_late, asked / 10);
  std::printf("%d stamps looked up, %d of them is_late; the clock was set %d times\n", asked,
              is_late, steps);
}

}  // namespace
}  // namespace surg_control
