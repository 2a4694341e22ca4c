// Tables of measured figures. They are always printed; with SURG_RESULTS_DIR in the environment (as
// './surg test --full' sets it to docs/results) they are written to <area>.md there as well, when
// the program ends. One test program owns one area.
#pragma once

#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace surg::test {

/// A cell from a printf format, for example cell("%.2f", x).
[[gnu::format(printf, 1, 2)]] inline std::string cell(const char* format, ...) {
  char text[256];
  va_list values;
  va_start(values, format);
  std::vsnprintf(text, sizeof text, format, values);
  va_end(values);
  return text;
}

/// Three digits of a number of any size.
inline std::string number(double x) {
  const double size = std::abs(x);
  if (size == 0) return "0";
  return cell(size >= 100 ? "%.0f" : size >= 0.01 ? "%.3g" : "%.1e", x);
}

/// A Markdown page of tables.
class Results {
 public:
  /// 'area' names the file, 'source' the test that writes it, 'what' says what the page is.
  Results(const std::string& area, const std::string& source, const std::string& what)
      : area_(area) {
    page_ << "# " << what << "\n\nWritten by `./surg test --full` (`" << source
          << "`): simulation, seeded, the same in every run.\n";
  }
  Results(const Results&) = delete;
  Results& operator=(const Results&) = delete;

  ~Results() {
    const char* directory = std::getenv("SURG_RESULTS_DIR");
    if (directory == nullptr || *directory == '\0' || !written_) return;
    const std::filesystem::path path = std::filesystem::path(directory) / (area_ + ".md");
    std::error_code ignored;
    std::filesystem::create_directories(path.parent_path(), ignored);
    std::ofstream file(path);
    file << page_.str();
    if (!file.good()) std::fprintf(stderr, "results: cannot write %s\n", path.c_str());
  }

  /// Begins a table under a heading; 'note' stands between them.
  void table(const std::string& heading, const std::string& note,
             const std::vector<std::string>& columns) {
    add("\n## " + heading + "\n\n" + (note.empty() ? "" : note + "\n\n"));
    row(columns);
    std::string line = "|";
    for (std::size_t i = 0; i < columns.size(); ++i) line += "---|";
    add(line + "\n");
  }
  /// Printed always; 'on_page' says whether the page has it, too.
  void row(const std::vector<std::string>& cells, bool on_page = true) {
    std::string line = "|";
    for (const std::string& text : cells) line += " " + text + " |";
    add(line + "\n", on_page);
  }
  /// A paragraph after a table.
  void text(const std::string& paragraph) { add("\n" + paragraph + "\n"); }

 private:
  void add(const std::string& text, bool on_page = true) {
    if (on_page) page_ << text;
    std::fputs(text.c_str(), stdout);
    written_ = true;
  }

  std::string area_;
  std::ostringstream page_;
  bool written_ = false;
};

}  // namespace surg::test
