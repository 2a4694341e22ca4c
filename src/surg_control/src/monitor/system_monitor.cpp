#include "surg_control/monitor/system_monitor.hpp"

#include <chrono>
#include <cstdio>

#include "surg_control/loop/realtime.hpp"
#include "surg_core/state/operating_state.hpp"

namespace surg_control {
namespace {

constexpr auto kPollPeriod = std::chrono::milliseconds(250);
constexpr int kMasterEvery = 2;      // looks; two that fail take at most 1.8 s
constexpr int kParametersEvery = 8;  // looks
constexpr double kMasterTimeout = 0.4;

XmlRpc::XmlRpcValue private_parameters(const std::string& space) {
  XmlRpc::XmlRpcValue value;
  ros::param::get(space, value);
  return value;
}

}  // namespace

SystemMonitor::SystemMonitor(const ros::NodeHandle& private_node, const std::string& arm,
                             const std::string& limits_hash, bool lockstep,
                             StatusReporter& reporter, Health& health)
    : space_(private_node.getNamespace()),
      arm_(arm),
      limits_hash_(limits_hash),
      lockstep_(lockstep),
      reporter_(reporter),
      health_(health),
      parameters_(private_parameters(space_)),
      thread_(&SystemMonitor::run, this) {}

SystemMonitor::~SystemMonitor() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void SystemMonitor::run() {
  for (int turn = 0;; ++turn) {
    check_clock();
    if (turn % kMasterEvery == 0) check_master();
    if (turn % kParametersEvery == kParametersEvery - 1) check_parameters();
    std::unique_lock<std::mutex> lock(mutex_);
    if (wake_.wait_for(lock, kPollPeriod, [this] { return stop_; })) return;
  }
}

void SystemMonitor::check_clock() {
  const auto wall_ns = static_cast<std::int64_t>(ros::WallTime::now().toNSec());
  const std::int64_t by = clock_.look(wall_ns, steady_ns());
  if (by == 0) return;
  ++health_.clock_steps;
  char text[32];
  std::snprintf(text, sizeof text, "%+.1f s", static_cast<double>(by) * 1e-9);
  reporter_.warning("clock_step",
                    arm_ + ": clock_step: the wall clock stepped by " + text +
                        "; control is not affected, but stamps before and after do not compare: "
                        "start a new recording",
                    static_cast<double>(steady_ns()) * 1e-9);
}

void SystemMonitor::check_master() {
  XmlRpc::XmlRpcValue pid;
  const bool there = ask_master("getPid", "", kMasterTimeout, pid) &&
                     pid.getType() == XmlRpc::XmlRpcValue::TypeInt;
  const MasterWatch::Change change = master_.look(there ? static_cast<int>(pid) : -1);
  health_.master_lost = master_.lost();
  if (change == MasterWatch::Change::kLost) {
    reporter_.error(arm_ + ": master_lost: " + surg::sentence(surg::Reason::kMasterLost) +
                    "; until then the arm obeys the nodes it is connected to" +
                    (lockstep_ ? "" : ", and refuses enable and resume"));
  } else if (change == MasterWatch::Change::kFound) {
    reporter_.status(arm_ + ": the ROS master answers again");
  }
}

void SystemMonitor::check_parameters() {
  if (health_.master_lost) return;
  XmlRpc::XmlRpcValue value;
  if (!ask_master("getParam", space_, kMasterTimeout, value)) return;
  for (const std::string& sentence : parameters_.look(value)) {
    reporter_.warning(sentence,
                      arm_ + ": " + sentence +
                          "; that has no effect: parameters are read once (limits_hash stays " +
                          limits_hash_ + "); restart the controller to use it",
                      static_cast<double>(steady_ns()) * 1e-9);
  }
  health_.changed_params = static_cast<std::uint32_t>(parameters_.changed());
}

}  // namespace surg_control
