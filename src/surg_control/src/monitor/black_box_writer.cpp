#include "surg_control/monitor/black_box_writer.hpp"

#include <sys/time.h>

#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <system_error>

#include "surg_control/files/black_box_file.hpp"

namespace surg_control {
namespace {

constexpr auto kDrainPeriod = std::chrono::milliseconds(100);

/// UTC with milliseconds, in the extended form for people or the basic one for file names.
std::string utc(bool for_file) {
  timeval now{};
  gettimeofday(&now, nullptr);
  tm parts{};
  gmtime_r(&now.tv_sec, &parts);
  char day[32], text[64];
  std::strftime(day, sizeof day, for_file ? "%Y%m%dT%H%M%S" : "%Y-%m-%dT%H:%M:%S", &parts);
  std::snprintf(text, sizeof text, "%s.%03ldZ", day, static_cast<long>(now.tv_usec / 1000));
  return text;
}

}  // namespace

BlackBoxWriter::BlackBoxWriter(surg::BlackBox& box, const std::string& folder,
                               const surg::BlackBoxLabel& label, StatusReporter& reporter)
    : box_(box),
      folder_(folder),
      label_(label),
      reporter_(reporter),
      thread_(&BlackBoxWriter::run, this) {}

BlackBoxWriter::~BlackBoxWriter() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
  if (box_.frozen()) write();
}

void BlackBoxWriter::run() {
  for (;;) {
    {
      std::unique_lock<std::mutex> lock(mutex_);
      if (wake_.wait_for(lock, kDrainPeriod, [this] { return stop_; })) return;
    }
    if (box_.frozen()) write();
  }
}

void BlackBoxWriter::write() {
  if (++files_ > kMostFiles) {
    reporter_.warning_once("black_box_most",
                           label_.arm + ": " + std::to_string(kMostFiles) +
                               " black boxes have been written to " + folder_ +
                               "; no more are written until the controller is restarted");
    box_.release();
    return;
  }
  label_.written = utc(false);
  const std::string path = folder_ + "/" + label_.arm + "_" + utc(true) + ".blackbox";
  try {
    std::error_code ignored;  // a folder that cannot be made shows in the writing
    std::filesystem::create_directories(folder_, ignored);
    write_black_box(path, box_.recording(label_));
    reporter_.status(label_.arm + ": black box of the last 2 s: " + path +
                     " (rosrun surg_control rcm_replay --black-box " + path + ")");
  } catch (const std::exception& error) {
    reporter_.warning_once("black_box",
                           label_.arm + ": the black box could not be written: " + error.what() +
                               "; control is not affected: free the disk, or name another folder "
                               "in ~black_box");
  }
  box_.release();
}

}  // namespace surg_control
