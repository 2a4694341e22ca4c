// The controller as a plain executable:
//   rosrun surg_control rcm_node __ns:=/PSM1 __name:=controller _cell:=cells/sim_ur5e _arm:=PSM1
#include <ros/ros.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>

#include "surg_control/rcm_loop.hpp"

namespace {

std::atomic<bool> stop{false};

void on_signal(int) { stop = true; }

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "controller", ros::init_options::NoSigintHandler);
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  if (!ros::master::check()) {
    std::fprintf(stderr, "surg_control: no ROS master at %s: start one, or set ROS_MASTER_URI\n",
                 ros::master::getURI().c_str());
    return 1;
  }
  try {
    ros::start();
    surg_control::RcmLoop loop(ros::NodeHandle("~"));
    loop.run(stop);
  } catch (const surg::ConfigError& error) {
    std::fprintf(stderr, "surg_control: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "surg_control: stopped by an unexpected error: %s\n", error.what());
    return 1;
  }
  return 0;
}
