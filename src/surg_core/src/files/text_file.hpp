// What the readers of YAML and XML share: files, texts and numbers.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "surg_core/config.hpp"

namespace surg::files {

/// Throws ConfigError with "file:line: what"; line 0: no line.
[[noreturn]] void refuse(const std::string& file, int line, const std::string& what);

/// The bytes of a file of at most 'most' bytes: a wrong path (a video, /dev/zero) must not take the
/// machine down before anybody looks at the text. 'kind' is named in that error. Throws
/// ConfigError.
std::string read_bytes(const std::string& path, std::uintmax_t most, const std::string& kind);

/// 'path' as seen from the folder of 'file', absolute and without links.
std::string beside(const std::string& file, const std::string& path);

/// The line of a text in which a byte is, from 1.
int line_of(std::string_view text, std::size_t offset);

/// A decimal number, with or without exponent. Beyond any double: infinite, so that a range refuses
/// it.
std::optional<double> decimal(std::string_view text);

}  // namespace surg::files
