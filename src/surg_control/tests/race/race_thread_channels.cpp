// What crosses threads, for ThreadSanitizer: the command ring, the slot of the newest value, and
// the black box between the loop and its writer. A race ends the program with status 66.
#include <cstdint>
#include <cstdio>
#include <thread>

#include "support/test_arm.hpp"
#include "surg_control/loop/thread_channels.hpp"
#include "surg_core/state/black_box.hpp"

namespace {

struct Pair {
  std::uint64_t a = 0, b = 0;
};

bool ring() {
  constexpr std::uint64_t kCount = 100000;
  surg_control::SpscRing<Pair> ring(16);
  std::thread producer([&ring] {
    for (std::uint64_t i = 1; i <= kCount;) {
      if (ring.push({i, ~i})) {
        ++i;
      } else {
        std::this_thread::yield();
      }
    }
  });
  bool good = true;
  Pair pair;
  for (std::uint64_t i = 1; i <= kCount;) {
    if (!ring.pop(pair)) {
      std::this_thread::yield();
      continue;
    }
    good = good && pair.a == i && pair.b == ~i;
    ++i;
  }
  producer.join();
  return good;
}

bool slot() {
  constexpr std::uint64_t kCount = 30000;
  surg_control::LatestSlot<Pair> slot;
  std::thread producer([&slot] {
    for (std::uint64_t i = 1; i <= kCount; ++i) slot.put({i, 3 * i});
  });
  bool good = true;
  Pair pair;
  for (std::uint64_t last = 0; last < kCount;) {
    if (!slot.take(pair)) {
      std::this_thread::yield();
      continue;
    }
    good = good && pair.b == 3 * pair.a && pair.a > last;
    last = pair.a;
  }
  producer.join();
  return good;
}

/// The loop runs into faults again and again; the writer takes every recording out and replays it.
bool black_box() {
  const surg::RobotConfig robot = surg::parse_robot(surg::test::good_robot());
  const surg::ControllerSetup setup{
      surg::test::ur5e_chain(),  robot, robot.limits, surg::test::instrument(),
      surg::test::offset_tool(), {}};
  surg::Controller controller(setup.chain, setup.robot, setup.limits, setup.instrument, setup.tool,
                              setup.options);
  surg::BlackBox box(controller, setup);
  constexpr int kIncidents = 5;
  std::atomic<bool> done{false};
  std::thread loop([&] {
    surg::Inputs in;
    in.state_valid = true;
    in.q = robot.home;
    in.qd = surg::JointVector::Zero(6);
    while (!done) {
      box.trigger();
      box.request(surg::StateCommand::kDisable);
      box.step(in);
    }
  });
  bool good = true;
  for (int incident = 0; incident < kIncidents;) {
    if (!box.frozen()) {
      std::this_thread::yield();
      continue;
    }
    const surg::BlackBoxRecording recording = box.recording({});
    box.release();
    good = good && !recording.steps.empty() && !surg::replay(surg::decode(encode(recording)));
    ++incident;
  }
  done = true;
  loop.join();
  return good;
}

}  // namespace

int main() {
  int failed = 0;
  const auto check = [&failed](const char* what, bool good) {
    std::printf("%s %s\n", good ? "ok    " : "FAILED", what);
    failed += !good;
  };
  check("command ring", ring());
  check("slot of the newest value", slot());
  check("black box", black_box());
  return failed;
}
