// Calibration: exact recordings give the exact answer, noisy ones scatter as their covariance says,
// and what does not determine the answer is refused.
#include <Eigen/Dense>
#include <cstdio>
#include <functional>

#include "support/test_support.hpp"
#include "surg_core/kinematics/calibration.hpp"

namespace surg {
namespace {

using test::Random;

Vector3 random_unit(Random& random) {
  return Vector3(random.normal(), random.normal(), random.normal()).normalized();
}

Vector3 noise(Random& random, double sigma) {
  return sigma * Vector3(random.normal(), random.normal(), random.normal());
}

Matrix3 turn(double angle, const Vector3& axis) {
  return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
}

/// A bench: an instrument anywhere on the flange, a divot or a trocar anywhere in reach.
struct Bench {
  Vector3 s_F, p_FTip, p_BFixed;
  Matrix3 R0;

  explicit Bench(Random& random) {
    s_F = (Vector3::UnitZ() + 0.3 * random_unit(random)).normalized();
    p_FTip = random.uniform(0.25, 0.4) * s_F +
             Vector3(random.uniform(-0.08, 0.08), random.uniform(-0.08, 0.08), 0);
    p_BFixed =
        Vector3(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(0, 0.6));
    R0 = turn(random.uniform(0, 3.1), random_unit(random));
  }

  Pose with_tip_at(const Matrix3& R, const Vector3& p_B, const Vector3& p_FPoint) const {
    Pose X = Pose::Identity();
    X.linear() = R;
    X.translation() = p_B - R * p_FPoint;
    return X;
  }
  /// Tilted by up to 'tilt' about any axis across the shaft, rolled by up to 'roll'.
  Matrix3 tilted(Random& random, double tilt, double roll) const {
    const Vector3 across = s_F.cross(random_unit(random)).normalized();
    return R0 * turn(random.uniform(0.3, 1) * tilt, across) *
           turn(random.uniform(-1, 1) * roll, s_F);
  }
  std::vector<Pose> pivoting(Random& random, int n, double tilt, double roll,
                             double sigma = 0) const {
    std::vector<Pose> poses;
    for (int i = 0; i < n; ++i) {
      poses.push_back(with_tip_at(tilted(random, tilt, roll), p_BFixed, p_FTip));
      poses.back().translation() += noise(random, sigma);
    }
    return poses;
  }
  /// Rolled by up to 'roll' and slid by up to 80 mm in a guide; each pose turned by 'sigma' rad.
  std::vector<Pose> rolling(Random& random, int n, double roll, double sigma = 0) const {
    std::vector<Pose> poses;
    for (int i = 0; i < n; ++i) {
      const Vector3 w = noise(random, sigma);
      Matrix3 R = R0 * turn(random.uniform(-1, 1) * roll, s_F);
      if (sigma > 0) R = turn(w.norm(), w.normalized()) * R;
      poses.push_back(with_tip_at(R, p_BFixed + random.uniform(0, 0.08) * (R0 * s_F), p_FTip));
    }
    return poses;
  }
  /// Shafts through the trocar, 20 to 220 mm deep, moved sideways by 'sigma'.
  std::vector<Line> inserted(Random& random, int n, double tilt, double sigma = 0) const {
    std::vector<Line> lines;
    for (int i = 0; i < n; ++i) {
      const Vector3 s = tilted(random, tilt, 3) * s_F;
      const Vector3 aside = noise(random, sigma);
      lines.push_back({p_BFixed + random.uniform(0.02, 0.22) * s + aside - aside.dot(s) * s, s});
    }
    return lines;
  }
};

TEST(Calibration, ExactRecordingsGiveTheExactAnswer) {
  Random random(31);
  const int n = test::family(500, 20000);
  double tip_error = 0, axis_error = 0, points_error = 0, point_error = 0;
  for (int i = 0; i < n; ++i) {
    const Bench bench(random);
    const TipFit tip = calibrate_tip(bench.pivoting(random, random.integer(8, 20), 0.5, 1.5));
    tip_error = std::max(tip_error, (tip.p_FTip - bench.p_FTip).norm());
    tip_error = std::max(tip_error, (tip.p_BDivot - bench.p_BFixed).norm());
    const AxisFit axis = calibrate_axis_by_rolling(
        bench.rolling(random, random.integer(8, 20), random.uniform(0.5, 3)), tip.p_FTip);
    axis_error = std::max(axis_error, (axis.s_F - bench.s_F).norm());
    EXPECT_LT(tip.fit.worst, 1e-12);

    Bench rod = bench;  // the same holder, a shorter or a longer rod
    rod.p_FTip += (i % 2 ? 0.12 : -0.12) * bench.s_F;
    // An offset beside the shaft would not do: the two points must lie on the shaft.
    const TipFit second = calibrate_tip(rod.pivoting(random, 12, 0.5, 1.5));
    const AxisFit line = calibrate_axis_by_points(tip, second);
    points_error = std::max(points_error, (line.s_F - bench.s_F).norm());

    const PointFit point =
        calibrate_trocar(bench.inserted(random, random.integer(6, 20), random.uniform(0.2, 0.9)));
    point_error = std::max(point_error, (point.p_BRcm - bench.p_BFixed).norm());
  }
  test::report("benches", n);
  std::printf("tip %.1e m, axis %.1e (rolling) %.1e (points), trocar %.1e m\n", tip_error,
              axis_error, points_error, point_error);
  EXPECT_LT(tip_error, 1e-12);
  EXPECT_LT(axis_error, 1e-12);
  EXPECT_LT(points_error, 1e-11);  // two tips, each 1e-12, 0.12 m apart
  EXPECT_LT(point_error, 1e-12);
}

/// Mean over many recordings of the squared error in units of the reported covariance
/// (Mahalanobis), which 'one' returns: it must be the number of degrees of freedom.
double mean_squared_distance(int runs, const std::function<double()>& one) {
  double sum = 0;
  for (int i = 0; i < runs; ++i) sum += one();
  return sum / runs;
}

TEST(Calibration, NoiseScattersAsTheCovarianceSays) {
  Random random(32);
  const int runs = test::family(1500, 30000);
  // n is large, so that the residuals tell the noise well: the distance squared is then chi-square
  // but for a factor f / (f - 2) of the F distribution.
  const int n = 60;
  const double sigma = 1e-4;
  const Bench bench(random);
  double tip_bias = 0, tip_rms = 0, predicted = 0;
  const double tip = mean_squared_distance(runs, [&] {
    const TipFit fit = calibrate_tip(bench.pivoting(random, n, 0.5, 1.5, sigma));
    const Vector3 error = fit.p_FTip - bench.p_FTip;
    tip_bias += error.x() / runs;
    tip_rms += error.squaredNorm() / runs;
    predicted += fit.covariance.trace() / runs;
    return error.dot(fit.covariance.inverse() * error);
  });
  const double axis = mean_squared_distance(runs, [&] {
    const AxisFit fit =
        calibrate_axis_by_rolling(bench.rolling(random, n, 1.2, 1e-3), bench.p_FTip);
    const Vector3 error = fit.s_F - bench.s_F;
    const Vector3 u = fit.s_F.unitOrthogonal(), v = fit.s_F.cross(u);
    Eigen::Matrix<double, 3, 2> across;
    across << u, v;
    const Eigen::Vector2d flat = across.transpose() * error;
    return flat.dot((across.transpose() * fit.covariance * across).inverse() * flat);
  });
  const double trocar = mean_squared_distance(runs, [&] {
    const PointFit fit = calibrate_trocar(bench.inserted(random, n, 0.5, sigma));
    const Vector3 error = fit.p_BRcm - bench.p_BFixed;
    return error.dot(fit.covariance.inverse() * error);
  });
  const auto expected = [](int dof, int freedom) {
    return dof * static_cast<double>(freedom) / (freedom - 2);
  };
  const double want_tip = expected(3, 3 * n - 6), want_axis = expected(2, 2 * n - 4),
               want_trocar = expected(3, 2 * n - 3);
  // Standard deviation of a mean of chi-squares: sqrt(2 dof / runs); five of them are allowed.
  const double slack = 5 * std::sqrt(6.0 / runs);
  std::printf(
      "squared errors in units of the predicted covariance: tip %.3f (expected %.3f), axis %.3f "
      "(%.3f), trocar %.3f (%.3f); tip %.4f mm rms, predicted %.4f mm\n",
      tip, want_tip, axis, want_axis, trocar, want_trocar, 1e3 * std::sqrt(tip_rms),
      1e3 * std::sqrt(predicted));
  EXPECT_NEAR(tip, want_tip, slack);
  EXPECT_NEAR(axis, want_axis, slack);
  EXPECT_NEAR(trocar, want_trocar, slack);
  EXPECT_NEAR(std::sqrt(tip_rms / predicted), 1, 0.05);
  EXPECT_LT(std::abs(tip_bias), 5 * std::sqrt(predicted / runs));
}

/// Expects a refusal that says 'words'.
template <typename Call>
void expect_refused(const Call& call, const std::string& words) {
  try {
    call();
    ADD_FAILURE() << "taken, instead of: " << words;
  } catch (const CalibrationError& error) {
    EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
  }
}

TEST(Calibration, MotionsThatDetermineNothingAreRefused) {
  Random random(33);
  const int n = test::family(200, 5000);
  for (int i = 0; i < n; ++i) {
    const Bench bench(random);
    const Vector3 tip = bench.p_FTip;
    expect_refused([&] { calibrate_tip(bench.pivoting(random, 5, 0.5, 1)); }, "at least 6");
    // The same pose again and again, moved sideways, turned about one axis only, hardly tilted.
    expect_refused(
        [&] { calibrate_tip(std::vector<Pose>(9, bench.pivoting(random, 1, 0.5, 1)[0])); },
        "without bound");
    expect_refused([&] { calibrate_tip(bench.rolling(random, 9, 0.0)); }, "without bound");
    std::vector<Pose> one_axis;
    const Vector3 axis = random_unit(random);
    for (int k = 0; k < 9; ++k) {
      one_axis.push_back(bench.with_tip_at(bench.R0 * turn(0.2 * k, axis), bench.p_BFixed, tip));
    }
    expect_refused([&] { calibrate_tip(one_axis); }, "tilt the instrument further");
    expect_refused([&] { calibrate_tip(bench.pivoting(random, 12, 0.02, 0.02)); }, "condition");

    expect_refused([&] { calibrate_axis_by_rolling(bench.rolling(random, 9, 0.0), tip); },
                   "roll the instrument further");
    expect_refused([&] { calibrate_axis_by_rolling(bench.rolling(random, 9, 0.02), tip); },
                   "roll the instrument further");
    // Tilting instead of rolling: no axis keeps its direction, or it is not the shaft.
    expect_refused([&] { calibrate_axis_by_rolling(bench.pivoting(random, 12, 0.5, 1.5), tip); },
                   "axis");
    std::vector<Pose> wrong_axis;
    const Vector3 across = tip.unitOrthogonal();
    for (int k = 0; k < 9; ++k) {
      wrong_axis.push_back(
          bench.with_tip_at(bench.R0 * turn(0.2 * k, across), bench.p_BFixed, tip));
    }
    expect_refused([&] { calibrate_axis_by_rolling(wrong_axis, tip); }, "about its shaft");

    expect_refused([&] { calibrate_trocar(bench.inserted(random, 5, 0.5)); }, "at least 6");
    expect_refused([&] { calibrate_trocar(bench.inserted(random, 9, 0.0)); }, "without bound");
    expect_refused([&] { calibrate_trocar(bench.inserted(random, 9, 0.02)); }, "tilt");

    TipFit a, b;
    a.p_FTip = tip;
    b.p_FTip = tip + 0.049 * bench.s_F;
    expect_refused([&] { calibrate_axis_by_points(a, b); }, "another length");
  }
  test::report("benches, 12 motions each", n);
}

TEST(Calibration, DataThatDoNotAgreeAreRefused) {
  Random random(34);
  const int n = test::family(200, 5000);
  for (int i = 0; i < n; ++i) {
    const Bench bench(random);
    // One of twelve has slipped by 20 mm.
    auto poses = bench.pivoting(random, 12, 0.5, 1.5);
    poses[6].translation() += 0.02 * random_unit(random);
    expect_refused([&] { calibrate_tip(poses); }, "residual");
    auto lines = bench.inserted(random, 12, 0.5);
    lines[3].p_B += 0.02 * lines[3].s_B.unitOrthogonal();
    expect_refused([&] { calibrate_trocar(lines); }, "residual");
    expect_refused(
        [&] { calibrate_axis_by_rolling(bench.rolling(random, 12, 1, 0.02), bench.p_FTip); },
        "tilted in its guide");
  }
  Bench bench(random);
  auto poses = bench.pivoting(random, 12, 0.5, 1.5);
  poses[4].translation().x() = std::nan("");
  expect_refused([&] { calibrate_tip(poses); }, "pose 5");
  expect_refused([&] { calibrate_axis_by_rolling(poses, bench.p_FTip); }, "pose 5");
  auto lines = bench.inserted(random, 12, 0.5);
  lines[2].s_B *= 2;
  expect_refused([&] { calibrate_trocar(lines); }, "shaft 3");
  test::report("benches with an outlier", n);
}

TEST(Calibration, AWrongToolShowsInTheTrocarsResidual) {
  // Shafts reconstructed with a shaft axis 0.5 deg wrong do not meet once the instrument is rolled.
  Random random(35);
  const Bench bench(random);
  const Vector3 wrong = turn(M_PI / 360, bench.s_F.unitOrthogonal()) * bench.s_F;
  std::vector<Line> lines;
  for (int i = 0; i < 20; ++i) {
    const Matrix3 R = bench.tilted(random, 0.5, 3);
    const Vector3 tip = bench.p_BFixed + random.uniform(0.05, 0.2) * (R * bench.s_F);
    lines.push_back({tip, R * wrong});
  }
  CalibrationLimits loose;
  loose.rms_max = loose.worst_max = 1;
  const PointFit fit = calibrate_trocar(lines, loose);
  std::printf("residual rms %.2f mm\n", 1e3 * fit.fit.rms);
  EXPECT_GT(fit.fit.rms, 0.5e-3);
  EXPECT_LT(fit.fit.rms, 2e-3);
}

TEST(Calibration, TheFilesHoldTheWorstOfTheEvidence) {
  Random random(36);
  const Bench bench(random);
  const TipFit tip = calibrate_tip(bench.pivoting(random, 12, 0.5, 1.5, 1e-4));
  const AxisFit axis = calibrate_axis_by_rolling(bench.rolling(random, 10, 1.2, 1e-3), tip.p_FTip);
  const ToolCalibration tool = tool_calibration(tip, axis, "2026-11-21");
  EXPECT_EQ(tool.n, 22);
  EXPECT_EQ(tool.s_F, axis.s_F);
  EXPECT_EQ(tool.p_FTip, tip.p_FTip);
  EXPECT_GE(tool.residual, tip.fit.rms);
  EXPECT_GE(tool.residual, 0.99 * axis.fit.rms * axis.s_F.dot(tip.p_FTip));
  EXPECT_GE(tool.condition, std::max(tip.fit.condition, axis.fit.condition));
  const PointFit point = calibrate_trocar(bench.inserted(random, 8, 0.5, 1e-4));
  const TrocarCalibration trocar = trocar_calibration(point, "2026-11-21");
  EXPECT_EQ(trocar.p_BRcm, point.p_BRcm);
  EXPECT_EQ(trocar.residual, point.fit.rms);
  EXPECT_EQ(trocar.condition, point.fit.condition);
  EXPECT_EQ(trocar.n, 8);
}

}  // namespace
}  // namespace surg
