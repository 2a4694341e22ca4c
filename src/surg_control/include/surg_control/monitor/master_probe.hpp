// Questions to the ROS master that end in time. roscpp's own calls wait for ever on a master that
// hangs.
#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <string>

namespace surg_control {

/// Calls 'method' of the master with the caller id and, where it is not empty, one text argument.
/// False when no answer of status 1 is there within 'timeout_s'.
bool ask_master(const std::string& method, const std::string& argument, double timeout_s,
                XmlRpc::XmlRpcValue& answer);

/// F07: whether the master that was there at the start still is. Pure.
class MasterWatch {
 public:
  enum class Change { kNone, kLost, kFound };

  /// One look: its process id, or -1 for no answer. One look that fails is a busy machine, two are
  /// a master that is gone. A master with another id knows none of our topics and counts as gone.
  Change look(int pid) {
    if (first_pid_ < 0) first_pid_ = pid;
    failures_ = pid >= 0 && pid == first_pid_ ? 0 : failures_ + 1;
    const bool lost = failures_ >= 2 || (lost_ && failures_ > 0);
    if (lost == lost_) return Change::kNone;
    lost_ = lost;
    return lost ? Change::kLost : Change::kFound;
  }
  bool lost() const { return lost_; }

 private:
  int first_pid_ = -1, failures_ = 0;
  bool lost_ = false;
};

}  // namespace surg_control
