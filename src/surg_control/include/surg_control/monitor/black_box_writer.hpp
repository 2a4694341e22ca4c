// After a FAULT a separate thread writes the frozen black box to disk and releases it.
#pragma once

#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "surg_control/topics/status_reporter.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg_control {

/// Writes <folder>/<arm>_<UTC time>.blackbox for every freeze and reports the path.
class BlackBoxWriter {
 public:
  /// Maximum number of files per run of the node: repeated FAULTs must not fill the disk.
  static constexpr int kMostFiles = 50;

  /// 'folder' is created on demand; 'label' gets the time of writing.
  BlackBoxWriter(surg::BlackBox& box, const std::string& folder, const surg::BlackBoxLabel& label,
                 StatusReporter& reporter);
  /// Writes a frozen recording, then ends the thread.
  ~BlackBoxWriter();
  BlackBoxWriter(const BlackBoxWriter&) = delete;
  BlackBoxWriter& operator=(const BlackBoxWriter&) = delete;

 private:
  void run();
  void write();

  surg::BlackBox& box_;
  std::string folder_;
  surg::BlackBoxLabel label_;
  StatusReporter& reporter_;
  int files_ = 0;

  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace surg_control
