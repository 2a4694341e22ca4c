// Caller ids as numbers, so that the control cycle handles no strings.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <vector>

namespace surg_control {

/// Two-way table of caller ids; 0 means nobody. Not for the control thread: it locks.
class SourceTable {
 public:
  std::uint32_t id(const std::string& caller) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto [entry, fresh] = ids_.emplace(caller, static_cast<std::uint32_t>(names_.size()));
    if (fresh) names_.push_back(caller);
    return entry->second;
  }

  std::string name(std::uint32_t id) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return id < names_.size() ? names_[id] : std::string();
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::string, std::uint32_t> ids_;
  std::vector<std::string> names_{std::string()};
};

}  // namespace surg_control
