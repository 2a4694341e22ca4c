// Calls to the ROS master with a timeout; roscpp's own calls block on a hanging master.
#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <string>

namespace surg_control {

/// Calls 'method' of the master with the caller id and, where it is not empty, one text argument.
/// False when no answer of status 1 is there within 'timeout_s'.
bool ask_master(const std::string& method, const std::string& argument, double timeout_s,
                XmlRpc::XmlRpcValue& answer);

/// F07: whether the master from the start is still there. Pure.
class MasterWatch {
 public:
  enum class Change { kNone, kLost, kFound };

  /// Takes the master's process id, or -1 for no answer. One failure may be a busy machine, two
  /// mean a lost master. A master with another id does not know our topics and counts as lost.
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
