// Ruckig: time-optimal, jerk-limited motion to a target, re-planned every cycle as its tutorial
// does for tracking.
#include <ruckig/ruckig.hpp>

#include "arm.hpp"
#include "streams.hpp"
#include "surg_core/estimators/stream_estimate.hpp"

namespace bench {
namespace {

template <std::size_t n>
void set_limits(ruckig::InputParameter<n>& input, std::size_t i, const surg::DofLimits& limits) {
  input.max_velocity[i] = limits.velocity;
  input.max_acceleration[i] = limits.acceleration;
  input.max_jerk[i] = limits.jerk;
}

/// As shipped (lead < 0): the target is the newest sample, at rest. With a lead: the target is the
/// same estimate that our filter gets, 'lead' seconds ahead; 'moving' gives its velocity as well.
struct Ruckig : Follower {
  Ruckig(const surg::DofLimits& limits, double lead, bool moving)
      : otg(T), limits(limits), lead(lead), moving(moving) {
    name = lead < 0 ? "ruckig" : "ruckig_lead";
    what = lead < 0 ? "Ruckig as shipped, newest sample"
                    : "Ruckig, estimate " +
                          std::to_string(static_cast<int>(lead * 1e4) / 10.0).substr(0, 4) +
                          " ms ahead" + (moving ? " with its velocity" : "");
    for (std::size_t i = 0; i < 3; ++i) set_limits(input, i, limits);
  }
  void reset(const Sample& first) override {
    for (std::size_t i = 0; i < 3; ++i) {
      input.current_position[i] = input.target_position[i] = first.x[i];
      input.current_velocity[i] = input.current_acceleration[i] = 0;
      input.target_velocity[i] = input.target_acceleration[i] = 0;
    }
    estimate.reset({first.x[0], first.x[1], first.x[2]});
    last = first.t;
    period = 0;
  }
  const Axes& tick(double t, const Sample& newest, bool fresh) override {
    if (fresh) {
      period += (period > 0 ? 0.02 : 1) * (newest.t - last - period);
      estimate.update({newest.x[0], newest.x[1], newest.x[2]}, newest.t - last, period);
      last = newest.t;
    }
    const auto targets = estimate.predict(t + T - newest.t + lead);
    for (std::size_t i = 0; i < 3; ++i) {
      if (lead < 0) {
        input.target_position[i] = newest.x[i];
        continue;
      }
      const surg::Kinematic& target = targets[i];
      input.target_position[i] = target.x;
      input.target_velocity[i] =
          moving ? std::clamp(target.v, -limits.velocity, limits.velocity) : 0.0;
    }
    if (otg.update(input, output) < 0) {
      ++failures;
      input.target_velocity = {0, 0, 0};
      otg.update(input, output);
    }
    for (std::size_t i = 0; i < 3; ++i) {
      state[i] = {output.new_position[i], output.new_velocity[i], output.new_acceleration[i]};
    }
    output.pass_to_input(input);
    return state;
  }
  ruckig::Ruckig<3> otg;
  ruckig::InputParameter<3> input;
  ruckig::OutputParameter<3> output;
  surg::DofLimits limits;
  double lead;
  bool moving;
  double last = 0, period = 0;
  surg::StreamEstimate estimate;
  Axes state{};
};

struct RuckigPlanner : Planner {
  explicit RuckigPlanner(const std::array<surg::DofLimits, 4>& limits) {
    name = "ruckig";
    what = "Ruckig, time-optimal";
    for (std::size_t i = 0; i < 4; ++i) set_limits(input, i, limits[i]);
  }
  double plan(const std::array<double, 4>& distance) override {
    input.target_position = distance;
    otg.calculate(input, trajectory);
    return trajectory.get_duration();
  }
  ruckig::Ruckig<4> otg;
  ruckig::InputParameter<4> input;
  ruckig::Trajectory<4> trajectory;
};

}  // namespace

void add_ruckig(Followers& followers, const surg::DofLimits& limits, double lead, bool moving) {
  followers.push_back(std::make_unique<Ruckig>(limits, lead, moving));
}
std::unique_ptr<Planner> ruckig_planner(const std::array<surg::DofLimits, 4>& limits) {
  return std::make_unique<RuckigPlanner>(limits);
}

}  // namespace bench
