// Reads a YAML document key by key. Errors say where a value is, what it is and what is allowed.
#pragma once

#include <algorithm>
#include <array>
#include <initializer_list>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "surg_core/config.hpp"

namespace surg::config {

std::string number(double value);
std::string show(const Value& value);
/// Where a key is: file, and line where known.
std::string place(const Document& document, const std::string& key);
/// File, line where known, and key of an arm's value in its cell.
std::string place(const CellArm& arm, const std::string& key, const std::string& cell_file);
/// The text between a prefix such as "arms." and the next dot of every key, in the file's order.
std::vector<std::string> names_in(const Document& document, const std::string& prefix);
/// The day of a date such as "2026-11-23", counted from 1970; nothing where it is none.
std::optional<int> day_of(const std::string& date);

/// Reads a document key by key, remembers what was asked for, and refuses what was not.
class Reader {
 public:
  Reader(const Document& document, const char* format) : document_(document) {
    choice("format", {format});
  }

  [[noreturn]] void fail(const std::string& key, const std::string& problem) const {
    throw ConfigError(place(document_, key) + ": " + key + ": " + problem);
  }

  double real(const std::string& key, double lowest, double highest, const char* unit) {
    const double value = get<double>(key, "a number");
    // Written so that NaN fails too.
    if (!(value >= lowest && value <= highest)) {
      fail(key, number(value) + " " + unit + " is out of range; allowed is " + number(lowest) +
                    " to " + number(highest) + " " + unit);
    }
    return value;
  }

  std::string word(const std::string& key) {
    const std::string value = get<std::string>(key, "a non-empty text");
    if (value.empty()) fail(key, "is empty; a non-empty text is needed");
    return value;
  }

  bool flag(const std::string& key) { return get<bool>(key, "true or false"); }

  std::string choice(const std::string& key, std::initializer_list<const char*> allowed) {
    return allowed.begin()[choose(key, allowed.begin(), allowed.size())];
  }

  /// The enumerator of one of the words, which are in the enumeration's order.
  template <typename Enum, std::size_t n>
  void choose(const std::string& key, const std::array<const char*, n>& words, Enum& value) {
    value = static_cast<Enum>(choose(key, words.data(), n));
  }

  JointVector joints(const std::string& key, std::size_t n, double lowest, double highest,
                     const char* unit) {
    const auto list = get<std::vector<double>>(key, "a list of numbers, one per joint");
    if (list.size() != n) {
      fail(key,
           "has " + std::to_string(list.size()) + " values; joints.names has " + std::to_string(n));
    }
    JointVector values(static_cast<int>(n));
    for (std::size_t i = 0; i < n; ++i) {
      if (!(list[i] >= lowest && list[i] <= highest)) {
        fail(key, "value " + std::to_string(i + 1) + ", " + number(list[i]) + " " + unit +
                      ", is out of range; allowed is " + number(lowest) + " to " + number(highest) +
                      " " + unit);
      }
      values[static_cast<int>(i)] = list[i];
    }
    return values;
  }

  Vector3 vector(const std::string& key, double largest, const char* unit) {
    const auto list = get<std::vector<double>>(key, "a list of three numbers");
    if (list.size() != 3) {
      fail(key, "has " + std::to_string(list.size()) + " values; three are needed");
    }
    for (double item : list) {
      if (!(std::abs(item) <= largest)) {
        fail(key, number(item) + " " + unit + " is out of range; allowed is -" + number(largest) +
                      " to " + number(largest) + " " + unit);
      }
    }
    return {list[0], list[1], list[2]};
  }

  /// Whether the document says the key, or any key of a section of this name.
  bool has(const std::string& name) const {
    const auto next = document_.values.lower_bound(name + ".");
    return document_.values.count(name) != 0 ||
           (next != document_.values.end() && next->first.rfind(name + ".", 0) == 0);
  }

  /// Whether the value of a key is a list of numbers.
  bool is_list(const std::string& key) const {
    const auto found = document_.values.find(key);
    return found != document_.values.end() &&
           std::holds_alternative<std::vector<double>>(found->second);
  }

  std::vector<double> numbers(const std::string& key) {
    return get<std::vector<double>>(key, "a list of numbers");
  }

  std::vector<std::string> words(const std::string& key) {
    return get<std::vector<std::string>>(key, "a list of texts");
  }

  /// Leaves a section to somebody else, who checks its keys.
  void leave(const std::string& section) {
    for (const auto& [key, value] : document_.values) {
      if (key.rfind(section + ".", 0) == 0) known_.insert(key);
    }
  }

  /// Refuses keys that nobody asked for: a misspelt limit must not pass for a set one.
  void finish() const {
    for (const auto& [key, value] : document_.values) {
      if (known_.count(key)) continue;
      std::string near;
      for (const auto& candidate : known_) {
        if (section(key) == section(candidate)) near += (near.empty() ? "" : ", ") + candidate;
      }
      fail(key, "is not a known key" + (near.empty() ? "" : "; known here: " + near));
    }
  }

 private:
  std::size_t choose(const std::string& key, const char* const* allowed, std::size_t n) {
    const std::string value = get<std::string>(key, "a text");
    std::string list;
    for (std::size_t i = 0; i < n; ++i) {
      if (value == allowed[i]) return i;
      list += (list.empty() ? "'" : ", '") + std::string(allowed[i]) + "'";
    }
    fail(key, "'" + value + "' is not known; allowed: " + list);
  }

  static std::string section(const std::string& key) { return key.substr(0, key.rfind('.') + 1); }

  template <typename T>
  T get(const std::string& key, const char* wanted) {
    known_.insert(key);
    const auto found = document_.values.find(key);
    if (found == document_.values.end()) {
      const bool nested =
          std::any_of(document_.values.begin(), document_.values.end(),
                      [&](const auto& item) { return item.first.rfind(key + ".", 0) == 0; });
      if (nested) fail(key, "is a section; " + std::string(wanted) + " is needed");
      std::string near;  // a misspelt key is among them
      for (const auto& [other, value] : document_.values) {
        const bool new_here = known_.count(other) == 0 && section(other) == section(key);
        if (new_here) near += (near.empty() ? "; here stands " : ", ") + other;
      }
      throw ConfigError(document_.file + ": " + key + ": is missing; " + wanted + " is needed" +
                        near);
    }
    if (const T* value = std::get_if<T>(&found->second)) return *value;
    fail(key, show(found->second) + " is not " + wanted);
  }

  const Document& document_;
  std::set<std::string> known_;
};

/// The lag of a link: one number, or one per joint.
struct StatedLag {
  double slowest;      ///< [s]
  JointVector joints;  ///< [s] empty: one number for all
};
StatedLag read_lag(Reader& reader, const std::string& key);

/// A capsule on a link or in the world, with bounds of its coordinates and its radius [m].
Capsule read_capsule(Reader& reader, const std::string& prefix, double farthest, double widest);

}  // namespace surg::config
