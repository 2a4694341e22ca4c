// Every command topic of an arm: who listens to what. A topic that is not here does not exist.
#pragma once

#include <ros/ros.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "surg_control/topics/decode.hpp"

namespace surg_control {

/// The arm's subscribers for commands.
class CommandInlets {
 public:
  /// Takes each message as it comes: its topic below the arm, the sender's caller id, the header's
  /// stamp (zero where the type has none) and what decoding made of it.
  using Sink = std::function<void(const std::string& topic, const std::string& caller,
                                  const ros::Time& stamp, Decoded decoded)>;

  /// 'track': whether rcm/track exists; 'queue': of each subscriber, 0 for unbounded.
  CommandInlets(ros::NodeHandle& node, const std::string& arm, bool track, std::uint32_t queue,
                Sink sink);

 private:
  template <typename Message>
  void listen(const std::string& topic, std::function<Decoded(const Message&)> decode);
  void listen_to_motions();
  void listen_to_the_rest(bool track);

  ros::NodeHandle& node_;
  std::string arm_;
  std::uint32_t queue_;
  Sink sink_;
  std::vector<ros::Subscriber> subscribers_;
};

}  // namespace surg_control
