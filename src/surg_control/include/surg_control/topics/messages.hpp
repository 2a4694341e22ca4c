// Converts values to messages.
#pragma once

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Vector3.h>
#include <ros/time.h>
#include <surg_msgs/Cycle.h>

#include <string>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/topics/source_table.hpp"

namespace surg_control {

ros::Time to_time(std::uint64_t ns);
/// For what belongs to no joint state. Not ros::Time::now(): a simulator's clock may stand still.
ros::Time wall_time();
geometry_msgs::Point to_point(const surg::Vector3& p);
geometry_msgs::Vector3 to_vector(const surg::Vector3& v);
geometry_msgs::Quaternion to_quaternion(const Eigen::Quaterniond& q);
geometry_msgs::Pose to_pose(const surg::Vector3& p, const Eigen::Quaterniond& q);

/// Fills a Cycle message. 'message' keeps its capacity from tick to tick.
void encode_cycle(const CycleRecord& record, const std::string& frame, const SourceTable& sources,
                  surg_msgs::Cycle& message);

}  // namespace surg_control
