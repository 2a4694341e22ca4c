// Numbers in a URDF's attributes.
#pragma once

#include <optional>
#include <string>

#include "files/xml.hpp"
#include "surg_core/types.hpp"

namespace surg::files {

/// Checks every element below the root: no xacro left anywhere, and in links, joints and materials
/// nothing but numbers where numbers belong. So whoever reads the file next, for pictures or
/// physics, finds no surprise. Throws ConfigError with line, element and cure.
void check_numbers(const Element& root, const std::string& file);

/// The number in an attribute that check_numbers has seen; empty where there is none.
std::optional<double> number_in(const Element& element, const std::string& attribute);

/// Three of them; 'standard' where the element or its attribute is missing.
Vector3 vector_in(const Element* element, const std::string& attribute, const Vector3& standard);

}  // namespace surg::files
