#include "files/urdf_numbers.hpp"

#include <cmath>
#include <sstream>
#include <vector>

#include "files/text_file.hpp"

namespace surg::files {
namespace {

constexpr double kAny = HUGE_VAL;    // no bound: every finite number
constexpr double kFarthest = 100.0;  // [m] a file in millimetres does not pass for an arm

/// What an attribute of an element holds.
struct Numbers {
  const char* element;
  const char* attribute;
  std::size_t count;
  double lowest, highest;
};
constexpr Numbers kNumbers[] = {
    {"origin", "xyz", 3, -kFarthest, kFarthest},  // [m]
    {"origin", "rpy", 3, -kAny, kAny},            // [rad]
    {"axis", "xyz", 3, -kAny, kAny},
    {"limit", "lower", 1, -kAny, kAny},
    {"limit", "upper", 1, -kAny, kAny},
    {"limit", "velocity", 1, 0, kAny},
    {"limit", "effort", 1, -kAny, kAny},
    {"mimic", "multiplier", 1, -kAny, kAny},
    {"mimic", "offset", 1, -kAny, kAny},
    {"dynamics", "damping", 1, -kAny, kAny},
    {"dynamics", "friction", 1, -kAny, kAny},
    {"mass", "value", 1, 0, kAny},  // [kg]
    {"inertia", "ixx", 1, 0, kAny},
    {"inertia", "iyy", 1, 0, kAny},
    {"inertia", "izz", 1, 0, kAny},
    {"inertia", "ixy", 1, -kAny, kAny},
    {"inertia", "ixz", 1, -kAny, kAny},
    {"inertia", "iyz", 1, -kAny, kAny},
    {"box", "size", 3, -kAny, kAny},
    {"cylinder", "radius", 1, -kAny, kAny},
    {"cylinder", "length", 1, -kAny, kAny},
    {"capsule", "radius", 1, -kAny, kAny},
    {"capsule", "length", 1, -kAny, kAny},
    {"sphere", "radius", 1, -kAny, kAny},
    {"color", "rgba", 4, -kAny, kAny},
};

std::vector<std::optional<double>> words_in(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::optional<double>> words;
  for (std::string word; stream >> word;) words.push_back(decimal(word));
  return words;
}

bool fits(const std::string& text, const Numbers& wanted) {
  const auto words = words_in(text);
  if (words.size() != wanted.count) return false;
  for (const std::optional<double>& word : words) {
    const bool inside = word && std::isfinite(*word) && *word >= wanted.lowest;
    if (!inside || *word > wanted.highest) return false;
  }
  return true;
}

std::string allowed(const Numbers& wanted) {
  const char* const counts[] = {"one finite number", "", "three finite numbers",
                                "four finite numbers"};
  std::string text = counts[wanted.count - 1];
  if (wanted.lowest == 0) text += ", 0 or more";
  if (wanted.highest == kFarthest) text += " of at most 100 m";
  return text + (wanted.count > 1 ? ", with blanks between them" : "");
}

/// 'owner': such as "joint 'one': ".
void check_element(const Element& element, const std::string& owner, const std::string& file) {
  for (const Numbers& wanted : kNumbers) {
    if (element.name != wanted.element) continue;
    const std::string* text = element.attribute(wanted.attribute);
    if (text && !fits(*text, wanted)) {
      refuse(file, element.line,
             owner + "<" + element.name + "> " + wanted.attribute + "=\"" + *text + "\" is not " +
                 allowed(wanted));
    }
  }
  for (const Element& child : element.children) check_element(child, owner, file);
}

void check_expanded(const Element& element, const std::string& file) {
  const auto left = [&](const std::string& what) {
    refuse(file, element.line,
           what +
               " is xacro: run xacro first, for example: xacro IN.xacro "
               "-o OUT.urdf");
  };
  const bool named = element.name.find("xacro|") != std::string::npos;
  if (named) left("<xacro:" + element.name.substr(element.name.rfind('|') + 1) + ">");
  for (const auto& [name, value] : element.attributes) {
    const bool open = value.find("${") != std::string::npos;
    if (open) left("<" + element.name + "> " + name + "=\"" + value + "\"");
  }
  for (const Element& child : element.children) check_expanded(child, file);
}

}  // namespace

void check_numbers(const Element& root, const std::string& file) {
  check_expanded(root, file);
  for (const Element& element : root.children) {
    const bool ours =
        element.name == "link" || element.name == "joint" || element.name == "material";
    const std::string* name = element.attribute("name");
    if (ours) check_element(element, element.name + " '" + (name ? *name : "") + "': ", file);
  }
}

std::optional<double> number_in(const Element& element, const std::string& attribute) {
  const std::string* text = element.attribute(attribute);
  return text ? words_in(*text).front() : std::nullopt;
}

Vector3 vector_in(const Element* element, const std::string& attribute, const Vector3& standard) {
  const std::string* text = element ? element->attribute(attribute) : nullptr;
  if (!text) return standard;
  const auto words = words_in(*text);
  return {*words[0], *words[1], *words[2]};
}

}  // namespace surg::files
