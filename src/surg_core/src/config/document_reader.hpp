// Reads a YAML document key by key. Errors say where a value is, what it is and what is allowed.
#pragma once

#include <algorithm>
#include <cstring>
#include <initializer_list>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "surg_core/config.hpp"

namespace surg::config {

std::string number(double value);
std::string show(const Value& value);
/// Where a key is: file, and line where known.
std::string place(const Document& document, const std::string& key);
/// File, line where known, and key of an arm's value in its cell.
std::string place(const CellArm& arm, const std::string& key, const std::string& cell_file);
/// How many letters must be inserted, deleted, replaced or swapped with their neighbour.
std::size_t edits_between(const std::string& a, const std::string& b);
/// Whether one key may be a misspelling of the other: at most every third letter of a word differs.
bool alike(const std::string& a, const std::string& b);
/// The text between a prefix such as "arms." and the next dot of every key, in the file's order.
std::vector<std::string> names_in(const Document& document, const std::string& prefix);
/// The day of a date such as "2026-11-23", counted from 1970; nothing where it is none.
std::optional<int> day_of(const std::string& date);

/// A key that is needed and not there.
class MissingKey : public ConfigError {
 public:
  MissingKey(const std::string& what, std::string key) : ConfigError(what), key_(std::move(key)) {}
  const std::string& key() const { return key_; }

 private:
  std::string key_;
};

/// The key of a document that is a misspelling of one that is missing in it; empty if there is
/// none. It is one if it looks like it, and if nothing misses it or minds its value once it is
/// renamed.
template <typename Parse>
std::string misspelling(const Document& document, const std::string& missing, Parse parse) {
  std::multimap<std::size_t, std::string> nearest_first;
  for (const auto& [key, value] : document.values) {
    if (alike(key, missing)) nearest_first.emplace(edits_between(key, missing), key);
  }
  for (const auto& [edits, key] : nearest_first) {
    Document renamed = document;
    renamed.values[missing] = document.values.at(key);
    renamed.values.erase(key);
    try {
      parse(renamed);
    } catch (const MissingKey& other) {
      if (other.key() == key) continue;
    } catch (const ConfigError& other) {
      if (std::strstr(other.what(), missing.c_str())) continue;
    }
    return key;
  }
  return "";
}

/// Parses a document. Where a key is missing because it is misspelt, the error names both.
template <typename Parse>
auto parse_with_hints(const Document& document, Parse parse) {
  try {
    return parse(document);
  } catch (const MissingKey& missing) {
    const std::string key = misspelling(document, missing.key(), parse);
    if (key.empty()) throw;
    throw ConfigError(place(document, key) + ": " + key + ": is not a known key; did you mean " +
                      missing.key() + "?");
  }
}

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
    const std::string value = get<std::string>(key, "a text");
    std::string list;
    for (const char* item : allowed) {
      if (value == item) return value;
      list += (list.empty() ? "'" : ", '") + std::string(item) + "'";
    }
    fail(key, "'" + value + "' is not known; allowed: " + list);
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
      std::string near, meant;
      for (const auto& candidate : known_) {
        const auto dot = key.rfind('.');
        const std::string section = dot == std::string::npos ? "" : key.substr(0, dot + 1);
        const auto known_dot = candidate.rfind('.');
        const std::string known_section =
            known_dot == std::string::npos ? "" : candidate.substr(0, known_dot + 1);
        if (section == known_section) near += (near.empty() ? "" : ", ") + candidate;
        if (meant.empty() && document_.values.count(candidate) == 0 && alike(key, candidate)) {
          meant = candidate;
        }
      }
      if (!meant.empty()) fail(key, "is not a known key; did you mean " + meant + "?");
      fail(key, "is not a known key" + (near.empty() ? "" : "; known here: " + near));
    }
  }

 private:
  template <typename T>
  T get(const std::string& key, const char* wanted) {
    known_.insert(key);
    const auto found = document_.values.find(key);
    if (found == document_.values.end()) {
      const bool nested =
          std::any_of(document_.values.begin(), document_.values.end(),
                      [&](const auto& item) { return item.first.rfind(key + ".", 0) == 0; });
      if (nested) fail(key, "is a section; " + std::string(wanted) + " is needed");
      throw MissingKey(document_.file + ": " + key + ": is missing; " + wanted + " is needed", key);
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
