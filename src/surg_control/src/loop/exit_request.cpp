#include "surg_control/loop/exit_request.hpp"

#include <ros/xmlrpc_manager.h>

#include <atomic>
#include <csignal>

namespace surg_control {
namespace {

std::atomic<bool> requested{false};
static_assert(std::atomic<bool>::is_always_lock_free, "used in a signal handler");

void on_signal(int) { requested = true; }

/// 'rosnode kill', and a second node of the same name.
void on_shutdown(XmlRpc::XmlRpcValue&, XmlRpc::XmlRpcValue& result) {
  requested = true;
  result = ros::xmlrpc::responseInt(1, "", 0);
}

}  // namespace

void hold_exit() {
  std::signal(SIGTERM, on_signal);
  std::signal(SIGINT, on_signal);
  ros::XMLRPCManager::instance()->unbind("shutdown");
  ros::XMLRPCManager::instance()->bind("shutdown", on_shutdown);
}

bool exit_requested() { return requested; }

}  // namespace surg_control
