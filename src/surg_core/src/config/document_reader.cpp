#include "document_reader.hpp"

#include <cstdio>
#include <ctime>

namespace surg::config {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

std::string show(const Value& value) {
  if (const auto* b = std::get_if<bool>(&value)) return *b ? "true" : "false";
  if (const auto* d = std::get_if<double>(&value)) return number(*d);
  if (const auto* s = std::get_if<std::string>(&value)) return "'" + *s + "'";
  std::string text = "[";
  if (const auto* list = std::get_if<std::vector<double>>(&value)) {
    for (double item : *list) text += (text.size() > 1 ? ", " : "") + number(item);
  } else {
    for (const auto& item : std::get<std::vector<std::string>>(value)) {
      text += (text.size() > 1 ? ", '" : "'") + item + "'";
    }
  }
  return text + "]";
}

std::string place(const Document& document, const std::string& key) {
  const auto line = document.lines.find(key);
  const bool known = line != document.lines.end();
  return document.file + (known ? ":" + std::to_string(line->second) : "");
}

std::string place(const CellArm& arm, const std::string& key, const std::string& cell_file) {
  const auto found = arm.where.find(key);
  const std::string file = found == arm.where.end() ? cell_file : found->second;
  return file + ": arms." + arm.name + "." + key;
}

std::vector<std::string> names_in(const Document& document, const std::string& prefix) {
  std::vector<std::string> names;
  for (const auto& [key, value] : document.values) {
    if (key.rfind(prefix, 0) != 0) continue;
    const auto dot = key.find('.', prefix.size());
    const auto length = dot == std::string::npos ? dot : dot - prefix.size();
    const std::string name = key.substr(prefix.size(), length);
    if (names.empty() || names.back() != name) names.push_back(name);  // keys are sorted
  }
  const auto line = [&](const std::string& name) {
    const auto found = document.lines.find(prefix + name);
    return found == document.lines.end() ? 0 : found->second;
  };
  std::stable_sort(names.begin(), names.end(), [&line](const std::string& a, const std::string& b) {
    return line(a) < line(b);
  });
  return names;
}

std::optional<int> day_of(const std::string& date) {
  std::tm when{};
  int used = 0;
  if (std::sscanf(date.c_str(), "%4d-%2d-%2d%n", &when.tm_year, &when.tm_mon, &when.tm_mday,
                  &used) != 3 ||
      used != static_cast<int>(date.size())) {
    return std::nullopt;
  }
  when.tm_year -= 1900;
  when.tm_mon -= 1;
  const std::tm asked = when;
  const std::time_t seconds = timegm(&when);
  if (when.tm_mon != asked.tm_mon || when.tm_mday != asked.tm_mday) return std::nullopt;
  return static_cast<int>(seconds / 86400);
}

StatedLag read_lag(Reader& reader, const std::string& key) {
  constexpr double kMost = 0.05;  // [s] longest lag of a link
  if (!reader.is_list(key)) return {reader.real(key, 0, kMost, "s"), {}};
  const std::size_t n = reader.numbers(key).size();
  if (n < 1 || n > static_cast<std::size_t>(kMaxJoints)) {
    reader.fail(key,
                "has " + std::to_string(n) + " values; allowed is one number, or one per joint");
  }
  const JointVector joints = reader.joints(key, n, 0, kMost, "s");
  return {joints.maxCoeff(), joints};
}

Capsule read_capsule(Reader& reader, const std::string& prefix, double farthest, double widest) {
  Capsule capsule;
  capsule.a = reader.vector(prefix + "from", farthest, "m");
  capsule.b = reader.vector(prefix + "to", farthest, "m");
  capsule.radius = reader.real(prefix + "radius", 0.001, widest, "m");
  return capsule;
}

}  // namespace surg::config
