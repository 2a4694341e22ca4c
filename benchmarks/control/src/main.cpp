// bench_control laws ARM PATH   the laws on one path, ideal plant: JSON on standard output
//
// `./surg dev bench control` writes the files, calls this and prints tables (benchmarks/control/).
#include <cmath>
#include <cstdio>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <vector>

#include "clock.hpp"
#include "laws.hpp"

namespace bench {
namespace {

using surg::JointVector;

constexpr std::size_t kRound = 500;  // cycles that one law runs before the next one has its turn
constexpr std::size_t kTail = 250;   // samples of the path behind the last cycle (TAIL in scene.py)

/// A law on its own ideal plant: q <- q + T qd.
struct Run {
  Law* law;
  JointVector q, qd;
  std::vector<float> times;
  double rcm_sum = 0, rcm_at_samples = 0, rcm_between = 0;
  double tip_sum = 0, tip_max = 0, roll_max = 0;
  long cycles = 0, violations = 0;

  void cycle(const Scene& scene, std::size_t k) {
    const Goal goal{&scene, k, scene.p_BTip[k], scene.p_BTip[k + 1]};
    const JointVector last = qd;
    times.push_back(nanoseconds([&] { qd = law->step(q, last, goal); }));
    for (double part : {0.25, 0.5, 0.75}) {  // the joints move on a straight line in between
      const surg::Pose X_BF = scene.chain.forward(q + part * T * qd);
      rcm_between =
          std::max(rcm_between, surg::shaft_state(X_BF, scene.tool, scene.p_BRcm).e.norm());
    }
    q += T * qd;
    const surg::Pose X_BF = scene.chain.forward(q);
    const surg::ShaftState shaft = surg::shaft_state(X_BF, scene.tool, scene.p_BRcm);
    const double rcm = shaft.e.norm(), tip = (shaft.p_BTip - goal.p_next).norm();
    rcm_sum += rcm;
    rcm_at_samples = std::max(rcm_at_samples, rcm);
    tip_sum += tip;
    tip_max = std::max(tip_max, tip);
    roll_max = std::max(roll_max, std::abs(surg::absolute_roll(X_BF.linear(), scene.home.R_BF,
                                                               scene.home.s_B, shaft.s)));
    for (int i = 0; i < q.size(); ++i) {
      const double v = scene.limits.velocity[i], dv = scene.limits.acceleration[i] * T;
      if (std::abs(qd[i]) > v * (1 + 1e-6) || std::abs(qd[i] - last[i]) > dv * (1 + 1e-6)) {
        ++violations;
        break;
      }
    }
    ++cycles;
  }
};

int laws(const std::string& arm, const std::string& path) {
  const Scene scene = read_scene(arm, path);
  Laws laws;
  add_own(laws, scene);
#ifdef BENCH_EIQUADPROG
  add_eiquadprog(laws, scene);
#endif
#ifdef BENCH_PROXQP
  add_proxqp(laws, scene);
#endif
#ifdef BENCH_KDL
  add_kdl(laws, scene);
#endif
  std::vector<Run> runs;
  for (const auto& law : laws) {
    Run run{law.get(), scene.q_home, JointVector::Zero(scene.q_home.size()), {}};
    run.times.reserve(scene.p_BTip.size());
    runs.push_back(std::move(run));
  }
  const double empty = empty_call();
  // The path goes on behind the last cycle, so that a preview does not see it end.
  if (scene.p_BTip.size() < 2 + kTail) throw std::runtime_error(path + ": too short");
  const std::size_t cycles = scene.p_BTip.size() - 1 - kTail;
  for (std::size_t from = 0, round = 0; from < cycles; from += kRound, ++round) {
    const std::size_t to = std::min(from + kRound, cycles);
    for (std::size_t i = 0; i < runs.size(); ++i) {  // another one begins each round
      Run& run = runs[(i + round) % runs.size()];
      for (std::size_t k = from; k < to; ++k) run.cycle(scene, k);
    }
    if (round % 20 == 0) std::fprintf(stderr, "progress %zu %zu\n", from, cycles);
  }
  std::printf("{\"cycles\": %zu, \"empty_call_us\": %.4f, \"laws\": {", cycles, empty * 1e-3);
  const char* separator = "";
  for (const Run& run : runs) {
    const Cost cost(run.times, empty);
    const double n = static_cast<double>(run.cycles);
    std::printf(
        "%s\n\"%s\": {\"what\": \"%s\", \"median\": %.4f, \"p99\": %.4f, \"rcm_mean_um\": %.4g, "
        "\"rcm_max_at_samples_um\": %.4g, \"rcm_max_between_um\": %.4g, \"tip_mean_um\": %.4g, "
        "\"tip_max_um\": %.4g, \"roll_max_deg\": %.4g, \"violations\": %ld, \"failures\": %ld}",
        separator, run.law->name.c_str(), run.law->what.c_str(), cost.median, cost.p99,
        run.rcm_sum / n * 1e6, run.rcm_at_samples * 1e6, run.rcm_between * 1e6,
        run.tip_sum / n * 1e6, run.tip_max * 1e6, run.roll_max * 180 / M_PI, run.violations,
        run.law->failures);
    separator = ",";
  }
  std::printf("}}\n");
  return 0;
}

int run(const std::vector<std::string>& words) {
  if (words.size() == 3 && words[0] == "laws") return laws(words[1], words[2]);
  std::fprintf(stderr, "usage: bench_control laws ARM PATH\n");
  return 2;
}

}  // namespace
}  // namespace bench

int main(int argc, char** argv) {
  try {
    return bench::run({argv + 1, argv + argc});
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_control: %s\n", error.what());
    return 1;
  }
}
