// Names and ranges of the limits, for every file that states or tightens them.
#pragma once

#include <functional>
#include <string>

#include "surg_core/config.hpp"

namespace surg::config {

/// Which direction makes a limit tighter.
enum class Tighter { kSmaller, kLarger };

/// One limit: its name, where it lives, the compiled-in range and unit. No YAML can exceed the
/// range.
struct LimitKey {
  const char* name;
  double Limits::*member;
  double lowest, highest;
  const char* unit;
  Tighter tighter = Tighter::kSmaller;
};

/// The limit of that name; nullptr where there is none.
const LimitKey* find_limit(const std::string& name);
/// Why a name is no limit, with those that there are.
std::string not_a_limit();

}  // namespace surg::config
