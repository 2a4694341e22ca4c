// The controller as a plain executable:
//   rosrun surg_control rcm_node __ns:=/PSM1 __name:=controller _cell:=cells/sim_ur5e _arm:=PSM1
#include <ros/ros.h>

#include <atomic>
#include <cstdio>
#include <exception>

#include "surg_control/loop/exit_request.hpp"
#include "surg_control/loop/rcm_loop.hpp"

int main(int argc, char** argv) {
  ros::init(argc, argv, "controller", ros::init_options::NoSigintHandler);
  if (!ros::master::check()) {
    std::fprintf(stderr, "surg_control: no ROS master at %s: start one, or set ROS_MASTER_URI\n",
                 ros::master::getURI().c_str());
    return 1;
  }
  try {
    ros::start();
    surg_control::hold_exit();
    surg_control::RcmLoop loop(ros::NodeHandle("~"));
    loop.run(std::atomic<bool>(false));
  } catch (const surg::ConfigError& error) {
    std::fprintf(stderr, "surg_control: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "surg_control: stopped by an unexpected error: %s\n", error.what());
    return 1;
  }
  return 0;
}
