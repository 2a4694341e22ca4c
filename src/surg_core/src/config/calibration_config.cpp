// Calibration files: tool, trocar, a UR's own kinematics, a measured base.
#include <Eigen/Eigenvalues>
#include <cmath>

#include "document_reader.hpp"

namespace surg {

using namespace config;

namespace {

constexpr int kUrJoints = 6;            // joints of a UR
constexpr double kUnitRounding = 1e-6;  // from the length of a unit vector or quaternion

/// What every calibration file carries beside its value. A bad calibration is refused here.
Evidence read_evidence(Reader& reader) {
  Evidence evidence;
  evidence.residual = reader.real("residual", 0.0, 0.002, "m");
  evidence.condition = reader.real("condition", 1.0, 1e4, "");
  evidence.n = static_cast<int>(reader.real("n", 1, 1e6, "samples"));
  evidence.date = reader.word("date");
  // A file of before has no source: what has no residual at all was computed.
  evidence.source = reader.has("source")
                        ? reader.choice("source", {"measured", "simulated", "computed"})
                    : evidence.residual > 0 ? "measured"
                                            : "computed";
  if (reader.has("serial")) evidence.serial = reader.word("serial");
  return evidence;
}

/// A list of a known number of values, each within +-largest.
template <int n>
Eigen::Matrix<double, n, 1> read_numbers(Reader& reader, const std::string& key, double largest) {
  const std::vector<double> list = reader.numbers(key);
  if (list.size() != n) {
    reader.fail(key, "has " + std::to_string(list.size()) +
                         " values; allowed: " + std::to_string(n) + " numbers");
  }
  for (double item : list) {
    // Written so that NaN fails too.
    if (!(std::abs(item) <= largest)) {
      reader.fail(key, "holds " + number(item) + "; allowed: -" + number(largest) + " to " +
                           number(largest));
    }
  }
  return Eigen::Map<const Eigen::Matrix<double, n, 1>>(list.data());
}

Eigen::Quaterniond read_quaternion(Reader& reader, const std::string& key) {
  const Eigen::Vector4d q = read_numbers<4>(reader, key, 1.0 + kUnitRounding);  // x, y, z, w
  if (!(std::abs(q.norm() - 1.0) <= kUnitRounding)) {
    reader.fail(key, "has length " + number(q.norm()) + "; allowed: x, y, z, w of length 1");
  }
  return Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized();
}

/// The rules and bounds of checked_document.py: symmetric, positive definite, of a believable size.
Eigen::Matrix<double, 6, 6> read_covariance(Reader& reader, const std::string& key) {
  const Eigen::Matrix<double, 36, 1> list = read_numbers<36>(reader, key, 1.0);
  const Eigen::Matrix<double, 6, 6> C =
      Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(list.data());
  if (!((C - C.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * C.cwiseAbs().maxCoeff())) {
    reader.fail(key, "is not symmetric; allowed: a symmetric 6 x 6 matrix");
  }
  if (!(C.diagonal().minCoeff() > 0)) {
    reader.fail(key, "holds the variance " + number(C.diagonal().minCoeff()) +
                         "; allowed: positive variances");
  }
  const Eigen::Matrix<double, 6, 1> sd = C.diagonal().cwiseSqrt();
  const Eigen::Matrix<double, 6, 6> scaled =
      sd.cwiseInverse().asDiagonal() * C * sd.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 6, 6>> solver(scaled,
                                                                          Eigen::EigenvaluesOnly);
  if (!(solver.eigenvalues()[0] > 1e-9)) {
    reader.fail(key, "has the eigenvalue " + number(solver.eigenvalues()[0]) +
                         " (scaled); allowed: a positive definite matrix");
  }
  for (const int at : {0, 3}) {
    const double most = at == 0 ? 0.35 : 0.1;
    const double found = sd.segment<3>(at).maxCoeff();
    const char* unit = at == 0 ? " rad" : " m";
    if (!(found <= most)) {
      reader.fail(key, "holds the standard deviation " + number(found) + unit +
                           "; allowed: at most " + number(most) + unit + ". Measure again");
    }
  }
  return C;
}

}  // namespace

ToolCalibration parse_tool(const Document& document) {
  Reader reader(document, "surg_tool/1");
  ToolCalibration tool;
  tool.s_F = reader.vector("shaft_axis", 1.0 + 1e-9, "");
  if (!(std::abs(tool.s_F.norm() - 1.0) < kUnitRounding)) {
    reader.fail("shaft_axis",
                "has length " + number(tool.s_F.norm()) + "; a unit vector is needed");
  }
  tool.s_F.normalize();
  tool.p_FTip = reader.vector("tip", 1.0, "m");
  const double along = tool.s_F.dot(tool.p_FTip);
  if (!(along > 0)) {
    reader.fail("shaft_axis", "points away from the tip, which is " + number(along) +
                                  " m along it; it must point from the flange to the tip");
  }
  static_cast<Evidence&>(tool) = read_evidence(reader);
  reader.finish();
  return tool;
}

TrocarCalibration parse_trocar(const Document& document) {
  Reader reader(document, "surg_trocar/1");
  TrocarCalibration trocar;
  trocar.p_BRcm = reader.vector("point", 2.0, "m");
  static_cast<Evidence&>(trocar) = read_evidence(reader);
  reader.finish();
  return trocar;
}

UrKinematics parse_kinematics(const Document& document) {
  Reader reader(document, "surg_kinematics/1");
  UrKinematics own;
  own.file = document.file;
  own.model = reader.word("model");
  own.serial = reader.word("serial");
  own.date = reader.word("date");
  own.theta = reader.joints("theta", kUrJoints, -7.0, 7.0, "rad");
  own.d = reader.joints("d", kUrJoints, -1e4, 1e4, "m");
  own.a = reader.joints("a", kUrJoints, -10.0, 10.0, "m");
  own.alpha = reader.joints("alpha", kUrJoints, -4.0, 4.0, "rad");
  reader.finish();
  return own;
}

BaseCalibration parse_base(const Document& document) {
  Reader reader(document, "surg_base/1");
  BaseCalibration base;
  base.file = document.file;
  base.X_WB.translation() = reader.vector("position", 10.0, "m");
  base.X_WB.linear() = read_quaternion(reader, "quaternion").toRotationMatrix();
  base.covariance = read_covariance(reader, "covariance");
  base.method = reader.choice("method", {"touch", "tip", "points"});
  base.residual = reader.real("residual", 0.0, 0.02, "m");
  base.condition = reader.real("condition", 1.0, 1e6, "");
  const double n = reader.real("n", 6, 1e6, "points");
  if (std::floor(n) != n) reader.fail("n", number(n) + "; allowed: a whole number");
  base.n = static_cast<int>(n);
  base.date = reader.word("date");
  if (!day_of(base.date)) reader.fail("date", "'" + base.date + "'; allowed: \"2026-11-23\"");
  base.source = reader.choice("source", {"measured", "simulated"});
  base.reference = reader.word("reference");
  base.reference_xyz = reader.vector("reference_xyz", 10.0, "m");
  base.reference_rpy = reader.vector("reference_rpy", 6.3, "rad");
  base.camera_sha256 = reader.word("camera_sha256");
  const bool hex = base.camera_sha256.size() == 64 &&
                   base.camera_sha256.find_first_not_of("0123456789abcdef") == std::string::npos;
  if (!hex && base.camera_sha256 != "none") {
    reader.fail("camera_sha256",
                "'" + base.camera_sha256 + "'; allowed: 64 hexadecimal digits, or none");
  }
  reader.finish();
  return base;
}

void check_tool(const ToolCalibration& tool, const Limits& limits, const std::string& tool_file) {
  const double length = tool.s_F.dot(tool.p_FTip);
  if (limits.depth_max < length) return;
  throw ConfigError(tool_file + ": tip: is " + number(length) +
                    " m along the shaft from the flange, and limits.depth_max " +
                    number(limits.depth_max) +
                    " m would push the flange into the trocar: tighten depth_max in the cell to "
                    "less than that, or calibrate the tool again");
}

void check_kinematics(const UrKinematics& own, const CellArm& arm, const RobotConfig& robot) {
  const char* cure = ": delete the file, then read the arm's own: ./surg robot CELL kinematics";
  if (own.model != robot.name) {
    throw ConfigError(own.file + ": model: '" + own.model + "', and the cell's robot is '" +
                      robot.name + "'" + cure);
  }
  if (arm.hardware && arm.hardware->serial != own.serial) {
    throw ConfigError(own.file + ": serial: '" + own.serial + "', and the cell's arm is '" +
                      arm.hardware->serial + "'" + cure);
  }
}

void check_base(const BaseCalibration& base, const CellArm& arm, const CellConfig& cell) {
  const CellArm& first = cell.arms.front();
  const std::string cure = ": delete the file, or repeat ./surg calibrate CELL bases";
  if (arm.name == first.name) {
    throw ConfigError(base.file + ": position: " + arm.name + " is the cell's first arm; allowed " +
                      "is the base that " + cell.file + " states, to which the others are " +
                      "measured: delete the file");
  }
  if (base.reference != first.name) {
    throw ConfigError(base.file + ": reference: '" + base.reference + "'; allowed is the cell's " +
                      "first arm, '" + first.name + "'" + cure);
  }
  const double moved = std::max((base.reference_xyz - first.base_xyz).cwiseAbs().maxCoeff(),
                                (base.reference_rpy - first.base_rpy).cwiseAbs().maxCoeff());
  if (!(moved <= 1e-9)) {
    throw ConfigError(base.file + ": reference_xyz, reference_rpy: differ from arms." + first.name +
                      ".base in " + cell.file + " by up to " + number(moved) +
                      "; allowed is the same: the first arm was moved after this measurement" +
                      cure);
  }
  const bool real = arm.hardware && !arm.hardware->emulated() && !arm.hardware->commissioning;
  if (real && base.source != "measured") {
    throw ConfigError(base.file + ": source: '" + base.source +
                      "'; allowed for a real arm is 'measured'" + cure);
  }
}

}  // namespace surg
