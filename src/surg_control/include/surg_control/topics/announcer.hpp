// Words for people on <arm>/warning, status and error: what was wrong and what to do, and never a
// flood.
#pragma once

#include <ros/ros.h>

#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace surg_control {

/// Publishes texts. Safe from the callback and the publisher thread; not for the control thread.
class Announcer {
 public:
  Announcer(ros::NodeHandle& node, const std::string& arm);

  /// At most once a second per 'key'; what was held back is counted in the next one. 'now' [s] is
  /// the steady clock, or tick time in lock-step.
  void warning(const std::string& key, const std::string& text, double now);
  /// Once in the life of the node per 'key'.
  void warning_once(const std::string& key, const std::string& text);
  void status(const std::string& text);
  void error(const std::string& text);

 private:
  struct Last {
    double when;
    std::uint64_t held_back;
  };

  ros::Publisher warning_, status_, error_;
  std::mutex mutex_;
  std::map<std::string, Last> last_;
};

}  // namespace surg_control
