#include "files/text_file.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>

namespace surg::files {

namespace fs = std::filesystem;

void refuse(const std::string& file, int line, const std::string& what) {
  throw ConfigError(file + (line > 0 ? ":" + std::to_string(line) : "") + ": " + what);
}

std::string read_bytes(const std::string& path, std::uintmax_t most, const std::string& kind) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) {
    const bool gone = !error || error == std::errc::no_such_file_or_directory;
    refuse(path, 0, "cannot be read: " + std::string(std::strerror(gone ? ENOENT : error.value())));
  }
  if (fs::is_directory(status)) refuse(path, 0, "cannot be read: Is a directory");
  if (!fs::is_regular_file(status)) refuse(path, 0, "cannot be read: is not a file");
  const std::uintmax_t size = fs::file_size(path, error);
  if (error || size > most) {
    refuse(path, 0, "is larger than " + std::to_string(most >> 20) + " MiB: not a " + kind);
  }
  std::ifstream stream(path, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  const bool readable = stream.is_open() && (size == 0 || !text.fail());
  if (!readable) refuse(path, 0, "cannot be read: " + std::string(std::strerror(errno)));
  return text.str();
}

std::string beside(const std::string& file, const std::string& path) {
  return fs::weakly_canonical(fs::absolute(fs::path(file).parent_path()) / path).string();
}

int line_of(std::string_view text, std::size_t offset) {
  const std::string_view before = text.substr(0, offset);
  return 1 + static_cast<int>(std::count(before.begin(), before.end(), '\n'));
}

std::optional<double> decimal(std::string_view text) {
  const bool negative = !text.empty() && text.front() == '-';
  if (!text.empty() && (text.front() == '+' || negative)) text.remove_prefix(1);
  // from_chars would also take a second sign, "inf" and "nan".
  if (text.empty() || (text.front() != '.' && (text.front() < '0' || text.front() > '9')))
    return {};
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error == std::errc::invalid_argument || end != text.data() + text.size()) return {};
  if (error == std::errc::result_out_of_range) {
    const std::size_t exponent = text.find_first_of("eE");
    const bool tiny = exponent != std::string_view::npos && text[exponent + 1] == '-';
    value = tiny ? 0.0 : std::numeric_limits<double>::infinity();
  }
  return negative ? -value : value;
}

}  // namespace surg::files
