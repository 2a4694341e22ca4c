// After a FAULT the black box stands still: a thread of its own puts it on disk and lets it go on.
#pragma once

#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "surg_control/topics/announcer.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg_control {

/// Writes <folder>/<arm>_<UTC time>.blackbox for every freeze, and says where.
class BlackBoxWriter {
 public:
  /// Files that one run of the node writes at most: a FAULT in a loop must not fill the disk.
  static constexpr int kMostFiles = 50;

  /// 'folder' is made when it is needed; 'label' is completed with the time of writing.
  BlackBoxWriter(surg::BlackBox& box, const std::string& folder, const surg::BlackBoxLabel& label,
                 Announcer& announcer);
  /// Writes what is frozen now, then ends.
  ~BlackBoxWriter();
  BlackBoxWriter(const BlackBoxWriter&) = delete;
  BlackBoxWriter& operator=(const BlackBoxWriter&) = delete;

 private:
  void run();
  void write();

  surg::BlackBox& box_;
  std::string folder_;
  surg::BlackBoxLabel label_;
  Announcer& announcer_;
  int files_ = 0;

  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace surg_control
