#include "streams.hpp"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <random>
#include <stdexcept>

#include "arm.hpp"
#include "clock.hpp"
#include "surg_core/motion/stream_input.hpp"

namespace bench {
namespace {

using surg::Kinematic;

constexpr std::size_t kRound = 500;

template <typename Value>
std::vector<Value> read_all(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::runtime_error("cannot read " + file);
  std::vector<Value> values;
  Value value;
  while (in.read(reinterpret_cast<char*>(&value), sizeof value)) values.push_back(value);
  return values;
}

struct Stream {
  std::vector<Sample> samples;
  std::vector<std::array<double, 3>> truth;  ///< at k T
};

Stream read_stream(const std::string& folder) {
  Stream stream{read_all<Sample>(folder + "/samples"),
                read_all<std::array<double, 3>>(folder + "/truth")};
  if (stream.samples.size() < 2 || stream.truth.size() < 2) {
    throw std::runtime_error(folder + ": empty stream");
  }
  return stream;
}

/// surg_core: estimate and jerk-limited filter.
struct Filter : Follower {
  explicit Filter(const surg::DofLimits& limits) {
    name = "filter";
    what = "surg_core, stream filter";
    for (auto& filter : filters) filter = surg::StreamFilter(limits);
    acceleration.fill(limits.acceleration);
  }
  void reset(const Sample& first) override {
    for (int i = 0; i < 3; ++i) filters[i].reset({first.x[i], 0, 0});
    const auto& x = first.x;
    input = surg::StreamInput();
    input.begin({x[0], x[1], x[2]}, {}, acceleration, 0, first.t + 1);  // a stamp of 0 is none
    begun = false;
  }
  const Axes& tick(double t, const Sample& newest, bool fresh) override {
    if (begun) input.elapse(T);
    begun = true;
    if (fresh) {
      const auto& x = newest.x;
      input.add({x[0], x[1], x[2]}, t - newest.t, newest.t + 1);
    }
    const auto target = input.target(T);
    for (int i = 0; i < 3; ++i) {
      filters[i].step(target[i], T);
      state[i] = filters[i].state();
    }
    return state;
  }
  surg::StreamInput input;
  surg::StreamInput::Values acceleration{};
  std::array<surg::StreamFilter, 3> filters;
  Axes state{};
  bool begun = false;
};

/// Root mean square distance to the truth, no shift [m].
double rms(Follower& follower, const Stream& stream) {
  const auto& [samples, truth] = stream;
  follower.reset(samples.front());
  double sum = 0;
  std::size_t next = 1, n = 0;
  for (std::size_t k = 0; k + 1 < truth.size(); ++k, ++n) {
    bool fresh = false;
    while (next < samples.size() && samples[next].t <= static_cast<double>(k) * T + 1e-9) {
      ++next;
      fresh = true;
    }
    const Axes& state = follower.tick(static_cast<double>(k) * T, samples[next - 1], fresh);
    for (int i = 0; i < 3; ++i) sum += std::pow(state[i].x - truth[k + 1][i], 2);
  }
  return std::sqrt(sum / static_cast<double>(n));
}

/// One follower with what it has done.
struct FollowerRun {
  Follower* follower;
  std::size_t next = 1;
  std::vector<float> times, updates;  // of all ticks, and of those with a new sample
  std::vector<double> path;           // x, y, z at (k + 1) T
  Axes before{};
  long violations = 0;

  void tick(std::size_t k, const std::vector<Sample>& samples, const surg::DofLimits& limits) {
    const double t = static_cast<double>(k) * T;
    bool fresh = false;
    while (next < samples.size() && samples[next].t <= t + 1e-9) {
      ++next;
      fresh = true;
    }
    const Sample& newest = samples[next - 1];
    const Axes* state = nullptr;
    times.push_back(nanoseconds([&] { state = &follower->tick(t, newest, fresh); }));
    if (fresh) updates.push_back(times.back());
    bool broken = false;
    for (int i = 0; i < 3; ++i) {
      const Kinematic& now = (*state)[i];
      path.push_back(now.x);
      broken |= std::abs(now.v) > limits.velocity * (1 + 1e-6) ||
                std::abs(now.a) > limits.acceleration * (1 + 1e-6) ||
                std::abs(now.a - before[i].a) > limits.jerk * T * (1 + 1e-6);
    }
    violations += broken;
    before = *state;
  }
};

#ifdef BENCH_RUCKIG
// Lead and kind of target are those of least error on another stream.
void add_best_ruckig(Followers& followers, const surg::DofLimits& limits, const Stream& tuning) {
  double best = INFINITY, lead = 0;
  bool moving = false;
  for (int step = 0; step <= 48; ++step) {
    for (bool with_velocity : {false, true}) {
      Followers trial;
      add_ruckig(trial, limits, 0.0025 * step, with_velocity);
      const double error = rms(*trial.front(), tuning);
      if (error < best) {
        best = error;
        lead = 0.0025 * step;
        moving = with_velocity;
      }
    }
  }
  add_ruckig(followers, limits, lead, moving);
}
#endif

// Write every follower's path, and print its figures as JSON.
void print_runs(const std::vector<FollowerRun>& runs, std::size_t ticks, double empty,
                const std::string& out) {
  std::printf("{\"ticks\": %zu, \"laws\": {", ticks);
  const char* separator = "";
  for (const FollowerRun& run : runs) {
    const std::string file = out + "/" + run.follower->name + ".path";
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(run.path.data()),
               static_cast<std::streamsize>(run.path.size() * sizeof(double)));
    const Cost cost(run.times, empty), update(run.updates, empty);
    std::printf(
        "%s\n\"%s\": {\"what\": \"%s\", \"cost_us\": %.4f, \"median_us\": %.4f, "
        "\"update_us\": %.4f, \"p99_us\": %.4f, \"violations\": %ld, \"failures\": %ld}",
        separator, run.follower->name.c_str(), run.follower->what.c_str(), cost.mean, cost.median,
        update.median, cost.p99, run.violations, run.follower->failures);
    separator = ",";
  }
  std::printf("}}\n");
}

}  // namespace

int streams([[maybe_unused]] const std::string& tuning, const std::string& test,
            const surg::DofLimits& limits, const std::string& out) {
  const auto [samples, truth] = read_stream(test);
  Followers followers;
  followers.push_back(std::make_unique<Filter>(limits));
#ifdef BENCH_RUCKIG
  add_ruckig(followers, limits, -1, false);
  add_best_ruckig(followers, limits, read_stream(tuning));
#endif
  std::vector<FollowerRun> runs;
  for (const auto& follower : followers) {
    follower->reset(samples.front());
    FollowerRun run;
    run.follower = follower.get();
    runs.push_back(std::move(run));
  }
  const double empty = empty_call();
  const std::size_t ticks = truth.size() - 1;
  for (std::size_t from = 0, round = 0; from < ticks; from += kRound, ++round) {
    for (std::size_t i = 0; i < runs.size(); ++i) {
      FollowerRun& run = runs[(i + round) % runs.size()];
      for (std::size_t k = from; k < std::min(from + kRound, ticks); ++k) {
        run.tick(k, samples, limits);
      }
    }
  }
  print_runs(runs, ticks, empty, out);
  return 0;
}

namespace {

struct QuinticPlanner : Planner {
  explicit QuinticPlanner(const std::array<surg::DofLimits, 4>& limits) : profiler(limits, 0.01) {
    name = "quintic";
    what = "surg_core, quintic of least duration";
  }
  double plan(const std::array<double, 4>& distance) override {
    profiler.reset(std::array<double, 4>{});
    profiler.plan(distance);
    return profiler.duration();
  }
  surg::Profiler profiler;
};

}  // namespace

int profiles() {
  const surg::DofLimits tip{0.25, 2, 100}, roll{2, 25, 500};
  const std::array<surg::DofLimits, 4> limits{tip, tip, tip, roll};
  std::vector<std::unique_ptr<Planner>> planners;
  planners.push_back(std::make_unique<QuinticPlanner>(limits));
#ifdef BENCH_RUCKIG
  planners.push_back(ruckig_planner(limits));
#endif
  std::vector<std::vector<float>> times(planners.size());
  std::vector<double> durations(planners.size());
  std::mt19937_64 engine(1);
  std::uniform_real_distribution<double> x(-0.05, 0.05), angle(-1, 1);
  const double empty = empty_call();
  constexpr int kTargets = 20000;
  for (int k = 0; k < kTargets; ++k) {
    const std::array<double, 4> target{x(engine), x(engine), x(engine), angle(engine)};
    for (std::size_t i = 0; i < planners.size(); ++i) {
      Planner& planner = *planners[(i + k) % planners.size()];
      const std::size_t at = (i + k) % planners.size();
      double duration = 0;
      times[at].push_back(nanoseconds([&] { duration = planner.plan(target); }));
      durations[at] += duration / kTargets;
    }
  }
  std::printf("{\"targets\": %d, \"planners\": {", kTargets);
  for (std::size_t i = 0; i < planners.size(); ++i) {
    const Cost cost(times[i], empty);
    std::printf(
        "%s\n\"%s\": {\"what\": \"%s\", \"cost_us\": %.4f, \"p99_us\": %.4f, "
        "\"mean_duration_s\": %.4f}",
        i ? "," : "", planners[i]->name.c_str(), planners[i]->what.c_str(), cost.median, cost.p99,
        durations[i]);
  }
  std::printf("}}\n");
  return 0;
}

}  // namespace bench
