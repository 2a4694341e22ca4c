// Names, ranges and units of limits and tuning, and the words of fixtures: the one list, for files,
// messages, hash and Python.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "surg_core/config.hpp"

namespace surg::config {

/// Which direction makes a limit tighter.
enum class Tighter { kSmaller, kLarger };

/// One number of a section: its name, where it lives, the compiled-in range and unit. No YAML can
/// exceed the range.
template <typename Section>
struct Key {
  const char* name;
  double Section::*member;
  double lowest, highest;
  const char* unit;
  Tighter tighter = Tighter::kSmaller;
};

const std::vector<Key<Limits>>& limit_keys();
/// What a robot's file states of its tuning; the rest comes from its link and its joints.
const std::vector<Key<Tuning>>& tuning_keys();

/// The limit of that name; nullptr where there is none.
const Key<Limits>* find_limit(const std::string& name);
/// Why a name is no limit, with those that there are.
std::string not_a_limit();

/// Words of a virtual fixture, in the order of its enumerations.
constexpr std::array<const char*, 3> kShapes{"plane", "sphere", "capsule"};
constexpr std::array<const char*, 2> kSides{"keep_out", "stay_in"};
constexpr std::array<const char*, 2> kParts{"tip", "shaft"};

/// The enumerator of a word; nothing where it is none.
template <typename Enum, std::size_t n>
std::optional<Enum> word_to(const std::string& text, const std::array<const char*, n>& words) {
  for (std::size_t i = 0; i < n; ++i) {
    if (text == words[i]) return static_cast<Enum>(i);
  }
  return std::nullopt;
}
template <typename Enum, std::size_t n>
const char* word_of(Enum value, const std::array<const char*, n>& words) {
  return words[static_cast<std::size_t>(value)];
}

}  // namespace surg::config
