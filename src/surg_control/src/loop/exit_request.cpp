#include "surg_control/loop/exit_request.hpp"

#include <ros/init.h>
#include <ros/xmlrpc_manager.h>

#include <atomic>
#include <csignal>
#include <mutex>

namespace surg_control {
namespace {

std::atomic<bool> requested{false};
std::atomic<int> holders{0};
static_assert(std::atomic<bool>::is_always_lock_free && std::atomic<int>::is_always_lock_free,
              "used in a signal handler");

void request() {
  requested = true;
  if (holders == 0) ros::requestShutdown();  // sets a flag: fit for a signal handler
}

void on_signal(int) { request(); }

/// 'rosnode kill', and a second node of the same name.
void on_shutdown(XmlRpc::XmlRpcValue&, XmlRpc::XmlRpcValue& result) {
  request();
  result = ros::xmlrpc::responseInt(1, "", 0);
}

}  // namespace

void hold_exit() {
  static std::once_flag once;
  ++holders;
  std::call_once(once, [] {
    std::signal(SIGTERM, on_signal);
    std::signal(SIGINT, on_signal);
    ros::XMLRPCManager::instance()->unbind("shutdown");
    ros::XMLRPCManager::instance()->bind("shutdown", on_shutdown);
  });
}

void release_exit() {
  if (--holders == 0 && requested) ros::requestShutdown();
}

bool exit_requested() { return requested; }

}  // namespace surg_control
