// Subscribers of all command topics of an arm.
#pragma once

#include <ros/ros.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "surg_control/topics/decode.hpp"

namespace surg_control {

/// The arm's subscribers for commands, and the topic 'received', which says what came.
class CommandSubscribers {
 public:
  /// Receives each message: its topic below the arm, the sender's caller id, the header's stamp
  /// (zero if the type has none) and the decoded command.
  using Sink = std::function<void(const std::string& topic, const std::string& caller,
                                  const ros::Time& stamp, Decoded decoded)>;

  /// Reads the files of a tool/mount.
  using ToolReader = std::function<Decoded(const std::string& words)>;

  /// 'wristed': joints are six; 'track': subscribe to rcm/track; 'queue': size of each subscriber's
  /// queue, 0 for unbounded.
  CommandSubscribers(ros::NodeHandle& node, const std::string& arm, bool wristed, bool track,
                     std::uint32_t queue, ToolReader read_tool, Sink sink);

 private:
  template <typename Message>
  void subscribe(const std::string& topic, std::function<Decoded(const Message&)> decode);
  template <typename Message>
  void echo(const std::string& topic, const std::string& sender, const Message& message);
  void subscribe_motions(bool wristed);
  void subscribe_others(bool track, const ToolReader& read_tool);

  ros::NodeHandle& node_;
  std::string arm_;
  std::uint32_t queue_;
  Sink sink_;
  ros::Publisher echo_;
  std::vector<ros::Subscriber> subscribers_;
};

}  // namespace surg_control
