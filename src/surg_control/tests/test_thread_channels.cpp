// Values across threads: nothing lost, nothing torn, nobody waits.
#include <gtest/gtest.h>

#include <cstdint>
#include <thread>

#include "surg_control/loop/realtime.hpp"
#include "surg_control/loop/thread_channels.hpp"
#include "surg_control/topics/source_table.hpp"

namespace surg_control {
namespace {

struct Pair {
  std::uint64_t a = 0, b = 0;
};

TEST(Handover, RingKeepsOrderAndSaysFull) {
  SpscRing<int> ring(3);
  int value = 0;
  EXPECT_FALSE(ring.pop(value));
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(ring.push(i));
  EXPECT_FALSE(ring.push(3));
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(ring.pop(value));
    EXPECT_EQ(value, i);
  }
  EXPECT_FALSE(ring.pop(value));
}

TEST(Handover, RingBetweenThreads) {
  constexpr std::uint64_t kCount = 200000;
  SpscRing<Pair> ring(64);
  std::thread producer([&ring] {
    for (std::uint64_t i = 1; i <= kCount;) {
      if (ring.push({i, ~i})) {
        ++i;
      } else {
        std::this_thread::yield();
      }
    }
  });
  Pair pair;
  for (std::uint64_t i = 1; i <= kCount;) {
    if (!ring.pop(pair)) {
      std::this_thread::yield();
      continue;
    }
    ASSERT_EQ(pair.a, i);
    ASSERT_EQ(pair.b, ~i);
    ++i;
  }
  producer.join();
}

TEST(Handover, ASlotNeverWaitsIsNeverTornAndNeverGoesBack) {
  constexpr std::uint64_t kCount = 200000;
  LatestSlot<Pair> slot;
  Pair pair;
  EXPECT_FALSE(slot.take(pair));
  std::thread producer([&slot] {
    for (std::uint64_t i = 1; i <= kCount; ++i) slot.put({i, 3 * i});
  });
  for (std::uint64_t last = 0; last < kCount;) {
    if (!slot.take(pair)) continue;
    ASSERT_EQ(pair.b, 3 * pair.a);
    ASSERT_GT(pair.a, last);
    last = pair.a;
  }
  producer.join();
  EXPECT_FALSE(slot.take(pair));
}

TEST(Handover, SourcesKeepTheirNumbers) {
  SourceTable sources;
  const std::uint32_t a = sources.id("/a");
  EXPECT_NE(a, 0U);
  EXPECT_NE(sources.id("/b"), a);
  EXPECT_EQ(sources.id("/a"), a);
  EXPECT_EQ(sources.name(a), "/a");
  EXPECT_EQ(sources.name(0), "");
  EXPECT_EQ(sources.name(99), "");
}

TEST(Metronome, KeepsThePaceAndDoesNotCatchUpInABurst) {
  Metronome metronome(2'000'000);
  const std::int64_t start = steady_ns();
  for (int i = 0; i < 100; ++i) metronome.wait();
  EXPECT_GE(steady_ns() - start, 199'000'000);
  std::this_thread::sleep_for(std::chrono::milliseconds(30));
  EXPECT_GE(metronome.wait(), 25'000'000);
  EXPECT_TRUE(metronome.late());
  // A whole period lies between the late beat and the next one.
  EXPECT_GE(metronome.wait(), 1'500'000);
}

}  // namespace
}  // namespace surg_control
