// The controller as a nodelet: intra-process with a robot link in the same manager.
#include <nodelet/nodelet.h>
#include <ros/ros.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <pluginlib/class_list_macros.hpp>
#include <thread>

#include "surg_control/loop/exit_request.hpp"
#include "surg_control/loop/rcm_loop.hpp"

namespace surg_control {

/// Runs an RcmLoop in a thread of its own. Unloading stops the arm through the law first; so does a
/// manager that is asked to end, which therefore has to wait for it.
class RcmNodelet : public nodelet::Nodelet {
 public:
  ~RcmNodelet() override {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }

 private:
  void onInit() override {
    hold_exit();
    try {
      loop_ = std::make_unique<RcmLoop>(getPrivateNodeHandle());
    } catch (const surg::ConfigError& error) {
      // An arm with a broken configuration must not come up half; the manager goes with it, loudly.
      ROS_FATAL("surg_control: %s", error.what());
      std::fprintf(stderr, "surg_control: %s\n", error.what());
      std::fflush(nullptr);
      std::quick_exit(2);
    }
    thread_ = std::thread([this] {
      try {
        loop_->run(stop_);
      } catch (const std::exception& error) {  // the arm has been told to stop
        ROS_FATAL("surg_control: stopped by an unexpected error: %s", error.what());
      }
      release_exit();
    });
  }

  std::unique_ptr<RcmLoop> loop_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace surg_control

PLUGINLIB_EXPORT_CLASS(surg_control::RcmNodelet, nodelet::Nodelet)
