// Followers of a stream of tip positions, three axes, and profilers for discrete targets.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "surg_core/motion/profiler.hpp"
#include "surg_core/motion/quintic.hpp"

namespace bench {

using Axes = std::array<surg::Kinematic, 3>;

/// A sample of the stream with its own stamp.
struct Sample {
  double t;
  std::array<double, 3> x;
};

/// One way to follow a stream within limits.
class Follower {
 public:
  virtual ~Follower() = default;
  virtual void reset(const Sample& first) = 0;
  /// One tick that begins at t; 'fresh' where a sample has come since the last one. Returns the
  /// state at t + T. Timed.
  virtual const Axes& tick(double t, const Sample& newest, bool fresh) = 0;
  std::string name, what;
  long failures = 0;
};
using Followers = std::vector<std::unique_ptr<Follower>>;

/// Time optimal profiles for discrete targets, four degrees of freedom from rest to rest.
class Planner {
 public:
  virtual ~Planner() = default;
  virtual double plan(const std::array<double, 4>& distance) = 0;  ///< duration [s]. Timed.
  std::string name, what;
};

void add_ruckig(Followers& followers, const surg::DofLimits& limits, double lead, bool moving);
std::unique_ptr<Planner> ruckig_planner(const std::array<surg::DofLimits, 4>& limits);

/// Follows the stream in folder 'test'; what a follower leaves to tune is tuned on 'tuning'.
int streams(const std::string& tuning, const std::string& test, const surg::DofLimits& limits,
            const std::string& out);
int profiles();

}  // namespace bench
