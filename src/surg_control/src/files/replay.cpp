#include "surg_control/files/replay.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "surg_core/law/rcm.hpp"

namespace surg_control {
namespace {

/// Splits one CSV line (RFC 4180: quotes protect commas, "" is a quote).
void split(const std::string& line, std::vector<std::string>& fields) {
  fields.assign(1, {});
  bool quoted = false;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (c == '"') {
      if (quoted && i + 1 < line.size() && line[i + 1] == '"') {
        fields.back() += line[++i];
      } else {
        quoted = !quoted;
      }
    } else if (c == ',' && !quoted) {
      fields.emplace_back();
    } else if (c != '\r') {
      fields.back() += c;
    }
  }
}

/// One line of the table, by column name.
class Row {
 public:
  explicit Row(const std::string& header) {
    std::vector<std::string> names;
    split(header, names);
    for (std::size_t i = 0; i < names.size(); ++i) columns_[names[i]] = i;
  }

  void read(const std::string& line) {
    ++line_number_;
    split(line, fields_);
    if (fields_.size() != columns_.size()) {
      throw ReplayError("line " + std::to_string(line_number_) + " has " +
                        std::to_string(fields_.size()) + " fields, the header " +
                        std::to_string(columns_.size()));
    }
  }

  const std::string& text(const std::string& column) const {
    const auto found = columns_.find(column);
    if (found == columns_.end()) throw ReplayError("line 1: no column '" + column + "'");
    return fields_[found->second];
  }

  double number(const std::string& column) const {
    const std::string& field = text(column);
    double value = 0;
    const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
    if (error != std::errc() || end != field.data() + field.size()) {
      throw ReplayError("line " + std::to_string(line_number_) + ", column '" + column + "': '" +
                        field + "' is no number");
    }
    return value;
  }

  surg::Vector3 point(const std::string& name) const {
    return {number(name + "_x"), number(name + "_y"), number(name + "_z")};
  }

 private:
  std::map<std::string, std::size_t> columns_;
  std::vector<std::string> fields_;
  std::uint64_t line_number_ = 1;
};

/// Keeps the larger; a NaN on the way is the largest.
void keep(double& worst, double difference) {
  if (!(difference <= worst)) worst = std::isnan(difference) ? HUGE_VAL : difference;
}

}  // namespace

double ReplayReport::worst() const { return std::max({tip, depth, rcm_error}); }

ReplayReport replay(std::istream& in, std::ostream& out, const surg::Chain& chain,
                    const surg::ToolCalibration& calibration) {
  std::string line;
  if (!std::getline(in, line) || line.empty()) throw ReplayError("line 1: no header");
  Row row(line);
  const surg::Tool tool{calibration.s_F, calibration.p_FTip};
  ReplayReport report;
  surg::JointVector q(chain.dof());
  out << "stamp_ns,tick,p_tip_x,p_tip_y,p_tip_z,depth,rcm_error\n";
  out.precision(17);
  while (std::getline(in, line)) {
    if (line.empty()) continue;
    row.read(line);
    if (row.text("q0").empty()) {
      ++report.skipped;
      continue;
    }
    for (int i = 0; i < chain.dof(); ++i) q[i] = row.number("q" + std::to_string(i));
    const surg::ShaftState shaft = surg::shaft_state(chain.forward(q), tool, row.point("p_rcm"));
    const double rcm_error = shaft.e.norm();
    out << row.text("stamp_ns") << ',' << row.text("tick") << ',' << shaft.p_BTip.x() << ','
        << shaft.p_BTip.y() << ',' << shaft.p_BTip.z() << ',' << shaft.depth << ',' << rcm_error
        << '\n';
    keep(report.tip, (shaft.p_BTip - row.point("p_tip")).norm());
    keep(report.depth, std::abs(shaft.depth - row.number("depth")));
    keep(report.rcm_error, std::abs(rcm_error - row.number("rcm_error")));
    ++report.rows;
  }
  return report;
}

}  // namespace surg_control
