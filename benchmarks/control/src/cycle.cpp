// bench_cycle CELL TREMOR CYCLES    whole cycles of the controller, called back to back: JSON on
//                                   standard output
//
// A stream of 500 Hz through gate, filter, law, limits and black box, on an ideal plant. In a node
// other processes run between two cycles, and the same cycle finds its caches cold.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <vector>

#include "clock.hpp"
#include "surg_core/files/arm_setup.hpp"
#include "surg_core/state/black_box.hpp"

namespace bench {
namespace {

using surg::JointVector;
using surg::Vector3;

constexpr double T = 0.002;  // [s]
constexpr std::uint32_t kSender = 7;

int cycles(const std::string& cell, double tremor, int count) {
  surg::ArmSetup arm = surg::load_arm(cell, "");
  arm.robot.tuning.tremor = tremor;
  const surg::Model& model = arm.model;
  const surg::ControllerSetup setup{model.chain,      arm.robot, arm.limits, arm.mounted.instrument,
                                    arm.mounted.tool, {},        {}};
  surg::Controller controller(setup.chain, setup.robot, setup.limits, setup.instrument, setup.tool,
                              setup.options);
  surg::BlackBox box(controller, setup);

  surg::Inputs in;
  in.state_valid = true;
  in.q = arm.robot.home;
  in.qd = JointVector::Zero(model.chain.dof());
  box.set_rcm(arm.trocar.p_BRcm);
  box.step(in);
  box.request(surg::StateCommand::kEnable);
  box.request(surg::StateCommand::kHome);
  const Vector3 p_home = controller.X_BR().inverse() * box.step(in).p_BTip;

  std::vector<float> times;
  times.reserve(count);
  const double empty = empty_call();
  for (int k = 0; k < count; ++k) {
    const double t = T * k, grown = std::min(t, 1.0);
    surg::MotionCommand& target = in.commands[0] = {};
    target.motion = surg::Motion::kServoCp;
    target.source = kSender;
    target.stamp_ns = static_cast<std::int64_t>(1e9 * t) + 1;
    target.p = p_home + grown * Vector3(0.010 * std::sin(2 * t), 0.010 * std::sin(3 * t),
                                        0.005 * std::sin(1.3 * t));
    target.rotation = Eigen::Quaterniond::Identity();
    in.n_commands = 1;
    const surg::Outputs* out = nullptr;
    times.push_back(nanoseconds([&] { out = &box.step(in); }));
    if (out->state != surg::State::kEnabled || out->refused > 0) {
      throw std::runtime_error(std::string("the stream ended: ") + surg::name(out->reason));
    }
    in.qd = out->qd_command;
    in.q += T * in.qd;
  }
  const Cost cost(times, empty);
  std::printf("{\"cycles\": %d, \"median\": %.4f, \"p99\": %.4f}\n", count, cost.median, cost.p99);
  return 0;
}

}  // namespace
}  // namespace bench

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: bench_cycle CELL TREMOR CYCLES\n");
    return 2;
  }
  try {
    return bench::cycles(argv[1], std::atof(argv[2]), std::atoi(argv[3]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_cycle: %s\n", error.what());
    return 1;
  }
}
