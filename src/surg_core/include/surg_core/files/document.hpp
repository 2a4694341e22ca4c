// YAML files as flat documents: nested keys joined by '.', each with its line. libyaml parses, and
// nothing is ever constructed. Nodes, programs and Python read through these two functions.
#pragma once

#include <string>

#include "surg_core/config.hpp"

namespace surg {

/// Reads one YAML file. Scalars follow the core schema of YAML 1.2: '1e-3' is a number, 'true' a
/// truth value, everything else a text, dates included. Throws ConfigError for a missing, oversized
/// or broken file, a key that is said twice or has a dot in it, an empty value, or a list of
/// anything but numbers or texts.
Document load_document(const std::string& path);

/// The same for a text; 'file' is named in errors.
Document parse_document(const std::string& text, const std::string& file);

}  // namespace surg
