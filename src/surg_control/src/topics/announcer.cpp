#include "surg_control/topics/announcer.hpp"

#include <std_msgs/String.h>

namespace surg_control {
namespace {

constexpr double kQuiet = 1.0;  // [s]

std_msgs::String text_message(const std::string& text) {
  std_msgs::String message;
  message.data = text;
  return message;
}

}  // namespace

Announcer::Announcer(ros::NodeHandle& node, const std::string& arm)
    : warning_(node.advertise<std_msgs::String>("/" + arm + "/warning", 100)),
      status_(node.advertise<std_msgs::String>("/" + arm + "/status", 100)),
      // Latched: whoever comes to look after a FAULT reads why.
      error_(node.advertise<std_msgs::String>("/" + arm + "/error", 100, true)) {}

void Announcer::warning(const std::string& key, const std::string& text, double now) {
  std::string counted = text;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = last_.find(key);
    if (found != last_.end() && now - found->second.when < kQuiet) {
      ++found->second.held_back;
      return;
    }
    if (found != last_.end() && found->second.held_back > 0) {
      counted +=
          " (and " + std::to_string(found->second.held_back) + " times more since the last one)";
    }
    last_[key] = {now, 0};
  }
  warning_.publish(text_message(counted));
}

void Announcer::warning_once(const std::string& key, const std::string& text) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!last_.emplace(key, Last{0, 0}).second) return;
  }
  warning_.publish(text_message(text));
}

void Announcer::status(const std::string& text) {
  ROS_INFO_STREAM(text);
  status_.publish(text_message(text));
}

void Announcer::error(const std::string& text) {
  ROS_ERROR_STREAM(text);
  error_.publish(text_message(text));
}

}  // namespace surg_control
