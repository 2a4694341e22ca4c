// rcm/track with a tracker's noise, outliers and drop-outs: how far the shaft is from the trocar
// that is really there. Oracle: the plant's joints and the true trocar.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "support/controller_bench.hpp"
#include "support/results.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using test::Bench;
using test::cell;
using test::kT;
using test::Random;

test::Results& results() {
  static test::Results page("track_noise", "src/surg_core/tests/test_track_noise.cpp",
                            "A noisy tracker on rcm/track");
  return page;
}

/// What the tracker reports as velocity.
enum class Rate { kTrue, kDifferenced, kZero };

const char* name(Rate rate) {
  switch (rate) {
    case Rate::kTrue:
      return "measured";
    case Rate::kDifferenced:
      return "differences of the positions";
    case Rate::kZero:
      return "none";
  }
  return "";
}

struct Tracker {
  double hertz = 60, noise = 0;  // [m] rms per axis
  Rate rate = Rate::kTrue;
  double latency = 0.02;                // [s]
  double outliers = 0, dropped = 0;     // shares of the samples
  double dead_from = 1e9, dead_to = 0;  // [s] no sample at all
  double off_from = 1e9;                // [s] from then on every sample is 5 mm off
};

/// A trocar that breathes across the shaft.
struct Wall {
  double hertz = 0.25, amplitude = 0.005;
  double at(double t) const { return amplitude * std::sin(2 * M_PI * hertz * t); }
  double speed(double t) const {
    return 2 * M_PI * hertz * amplitude * std::cos(2 * M_PI * hertz * t);
  }
};

struct Figures {
  double rms = 0, largest = 0;    // [m] of the true deviation
  double acceleration = 0;        // largest measured joint acceleration over its limit
  double tip = 0;                 // [m] rms of the tip, which shall stand still
  double stopped = -1;            // [s] when the arm left ENABLED
  Reason reason = Reason::kNone;  // why
  long outliers = 0;              // sent
  long outliers_named = 0, dropouts_named = 0, noisy_named = 0;
};

std::string stop_of(const Figures& f) {
  return f.stopped < 0 ? "–" : cell("%.2f s: %s", f.stopped, name(f.reason));
}

/// An arm that lags (4 ms of delay, 8 ms first order) behind a controller that is told 12 ms.
Figures follow(const Tracker& tracker, const Wall& wall, double seconds, unsigned seed) {
  Controller::Options options;
  options.track_rcm = true;
  Bench bench(options, 2, 0.008, 0.012);
  Random random(seed);
  const Vector3 p0 = bench.out().p_BRcm, across = bench.controller().X_BR().linear().col(0);
  const Vector3 p_RTip = bench.tip_in_R();
  const Vector3 p_BTip0 = bench.out().p_BTip;
  const ToolCalibration tool = test::offset_tool();
  const auto noise = [&] {
    return Vector3(tracker.noise * Vector3(random.normal(), random.normal(), random.normal()));
  };
  Figures f;
  double squares = 0, tips = 0;
  long n = 0, newest = -1;
  Vector3 p = p0, v = Vector3::Zero();
  double taken = 0;
  JointVector qd_before = bench.in().qd;
  for (long i = 0; i * kT < seconds; ++i) {
    const double t = i * kT;
    for (long k = newest + 1; k / tracker.hertz <= t - tracker.latency; ++k) {
      newest = k;
      const double then = k / tracker.hertz;
      const bool lost = random.uniform(0, 1) < tracker.dropped ||
                        (then >= tracker.dead_from && then < tracker.dead_to);
      Vector3 seen = p0 + wall.at(then) * across + noise();
      const bool outlier = then > 1 && random.uniform(0, 1) < tracker.outliers;
      if (outlier) {
        seen += random.uniform(0.004, 0.03) *
                Vector3(random.normal(), random.normal(), random.normal()).normalized();
      }
      if (then >= tracker.off_from) seen += 0.005 * bench.controller().X_BR().linear().col(1);
      if (lost) continue;
      f.outliers += outlier;
      if (tracker.rate == Rate::kTrue) v = wall.speed(then) * across;
      if (tracker.rate == Rate::kDifferenced && then > taken) v = (seen - p) / (then - taken);
      p = seen;
      taken = then;
      bench.in().track_valid = true;
    }
    bench.in().track_age = t - taken;
    bench.in().p_BTrack = p;
    bench.in().v_BTrack = v;
    bench.servo_cp(p_RTip);
    bench.tick();
    f.outliers_named += bench.out().warn_track == TrackWarning::kOutlier;
    f.dropouts_named += bench.out().warn_track == TrackWarning::kDropout;
    f.noisy_named += bench.out().warn_track == TrackWarning::kNoisy;
    if (bench.out().state != State::kEnabled && f.stopped < 0) {
      f.stopped = t;
      f.reason = bench.out().reason;
    }
    const JointVector qdd = (bench.in().qd - qd_before) / kT;
    qd_before = bench.in().qd;
    f.acceleration = std::max(f.acceleration,
                              (qdd.array() / bench.robot().acceleration.array()).abs().maxCoeff());
    if (t < 2 || f.stopped >= 0) continue;
    const Pose X_BF = bench.chain().forward(bench.in().q);
    const Vector3 s = X_BF.linear() * tool.s_F, p_BTip = X_BF * tool.p_FTip;
    const Vector3 to = p0 + wall.at(t + kT) * across - p_BTip;
    const double off = (to - s * s.dot(to)).norm();
    f.largest = std::max(f.largest, off);
    squares += off * off;
    tips += (p_BTip - p_BTip0).squaredNorm();
    ++n;
  }
  if (n > 0) {
    f.rms = std::sqrt(squares / n);
    f.tip = std::sqrt(tips / n);
  }
  return f;
}

/// Limits of a row [m]: with the velocity that the tracker measures, and with positions alone.
struct Row {
  double hertz, noise;
  double largest_measured;
  double rms_alone, largest_alone;
};

constexpr Row kRows[] = {
    {25, 0, 4e-5, 4e-5, 1.5e-4},      {500, 0, 1e-5, 1e-5, 1e-5},      {25, 1e-4, 3e-4, 2e-4, 6e-4},
    {25, 3e-4, 3e-4, 4.5e-4, 1.5e-3}, {30, 3e-4, 3e-4, 4e-4, 1.2e-3},  {60, 3e-4, 3e-4, 3e-4, 1e-3},
    {100, 2e-4, 3e-4, 2e-4, 6e-4},    {500, 5e-5, 3e-4, 5e-5, 1.5e-4},
};

TEST(TrackNoise, ThePivotKeepsToABreathingTrocar) {
  const double seconds = test::family(20, 300);
  results().table(
      "Noise",
      "UR5e with 4 ms of delay and 8 ms of lag, tip held 120 mm deep; the trocar moves 5 mm at "
      "0.25 "
      "Hz across the shaft. White noise per axis on the positions, 20 ms of latency. Velocity: as "
      "the tracker measures it; differences of the noisy positions; none (zeros). True deviation "
      "of "
      "the shaft from the trocar, after the first 2 s. Acceleration: largest measured joint "
      "acceleration over its limit.",
      {"rate Hz", "noise mm rms", "velocity", "rms mm", "max mm", "tip mm rms", "acceleration",
       "stopped"});
  for (const Row& row : kRows) {
    for (const Rate rate : {Rate::kTrue, Rate::kDifferenced, Rate::kZero}) {
      Tracker tracker;
      tracker.hertz = row.hertz;
      tracker.noise = row.noise;
      tracker.rate = rate;
      const Figures f = follow(tracker, {}, seconds, 3);
      results().row({cell("%.0f", row.hertz), cell("%.2f", 1e3 * row.noise), name(rate),
                     cell("%.3f", 1e3 * f.rms), cell("%.3f", 1e3 * f.largest),
                     cell("%.3f", 1e3 * f.tip), cell("%.2f", f.acceleration), stop_of(f)});
      const std::string where = cell("%.0f Hz, %.2f mm, ", row.hertz, 1e3 * row.noise) + name(rate);
      EXPECT_LT(f.stopped, 0) << where;
      EXPECT_LE(f.acceleration, 1 + 1e-6) << where;
      EXPECT_LE(f.largest, rate == Rate::kTrue ? row.largest_measured : row.largest_alone) << where;
      if (rate != Rate::kTrue) {
        EXPECT_LE(f.rms, row.rms_alone) << where;
      }
    }
  }
}

TEST(TrackNoise, OutliersAndDropoutsAreBridgedAndNamed) {
  const double seconds = test::family(20, 300);
  results().table("Outliers and drop-outs",
                  "As above, 0.3 mm of noise with the measured velocity; outliers of 4 to 30 mm.",
                  {"rate Hz", "outliers %", "lost %", "gap s", "rms mm", "max mm", "named outliers",
                   "named drop-outs", "stopped"});
  for (const double hertz : {25.0, 60.0}) {
    for (const auto& [outliers, dropped, gap] : std::vector<std::array<double, 3>>{
             {0.02, 0, 0}, {0, 0.1, 0}, {0.01, 0.05, 0}, {0, 0, 0.15}}) {
      Tracker tracker;
      tracker.hertz = hertz;
      tracker.noise = 3e-4;
      tracker.outliers = outliers;
      tracker.dropped = dropped;
      tracker.dead_from = gap > 0 ? 8 : 1e9;
      tracker.dead_to = 8 + gap;
      const Figures f = follow(tracker, {}, seconds, 4);
      results().row({cell("%.0f", hertz), cell("%.0f", 100 * outliers), cell("%.0f", 100 * dropped),
                     cell("%.2f", gap), cell("%.3f", 1e3 * f.rms), cell("%.3f", 1e3 * f.largest),
                     cell("%ld of %ld", f.outliers_named, f.outliers),
                     cell("%ld", f.dropouts_named), stop_of(f)});
      EXPECT_LT(f.stopped, 0) << hertz << " " << outliers << " " << dropped;
      EXPECT_LE(f.largest, 5e-4) << hertz << " " << outliers << " " << dropped;
      EXPECT_EQ(f.outliers_named, f.outliers);
      EXPECT_EQ(f.dropouts_named > 0, dropped > 0 || gap > 0);
    }
  }
}

TEST(TrackNoise, ALostTrackPauses) {
  Tracker silent;
  silent.noise = 1e-4;
  silent.dead_from = 5;
  silent.dead_to = 1e9;
  const Figures f = follow(silent, {}, 6, 5);
  EXPECT_EQ(f.reason, Reason::kTrackStale) << name(f.reason);
  EXPECT_GT(f.stopped, 5.2);
  EXPECT_LT(f.stopped, 5.3);
}

TEST(TrackNoise, F23ATrackThatJumpsFaultsWithItsThirdSample) {
  for (const double hertz : {25.0, 60.0, 500.0}) {
    for (const double noise : {0.0, 3e-4}) {
      Tracker leapt;
      leapt.hertz = hertz;
      leapt.noise = noise;
      leapt.off_from = 5;
      const Figures f = follow(leapt, {}, 6, 5);
      EXPECT_EQ(f.reason, Reason::kRcmError) << name(f.reason);
      EXPECT_NEAR(f.stopped, 5 + 2 / hertz + leapt.latency, 0.0021) << hertz << " " << noise;
    }
  }
}

TEST(TrackNoise, ATrackerNoisierThanStatedIsNamed) {
  Tracker fine, noisy;
  fine.noise = 3e-4;
  noisy.noise = 7e-4;
  EXPECT_EQ(follow(fine, {}, 20, 6).noisy_named, 0);
  EXPECT_GT(follow(noisy, {}, 20, 6).noisy_named, 100);
}

}  // namespace
}  // namespace surg
