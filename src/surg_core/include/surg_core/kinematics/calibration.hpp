// Calibration of instrument and trocar from recorded flange poses: linear least squares in closed
// form, without start value or iteration. Each result carries its residuals and condition number
// and is refused where they exceed the limits. docs/guide/first_session.md describes the
// procedures.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

#include "surg_core/config.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// A calibration that must not be used. The text states the value, the allowed range and the
/// remedy.
class CalibrationError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Acceptance limits of a calibration. The schema of the files sets the outer bounds.
struct CalibrationLimits {
  int n_min = 6;              ///< poses or lines
  double condition_max = 30;  ///< some 3 deg (rms) of change in the orientation
  double rms_max = 0.001;     ///< [m]
  double worst_max = 0.002;   ///< [m] of a single pose or line
  /// [rad] of the axis found by rolling: 1 mm and 2 mm on 300 mm of shaft.
  double axis_rms_max = 0.0035;
  double axis_worst_max = 0.007;
  double distance_min = 0.05;  ///< [m] between two points of the shaft
};

/// Quality of a fit of n observations. 'condition' is the ratio of the largest to the smallest
/// singular value of the stacked equations with all unknowns; it depends only on the motion between
/// the poses.
struct Fit {
  int n = 0;
  double rms = 0;    ///< of the distances that are left [m]; of the axis [rad]
  double worst = 0;  ///< largest of them
  double condition = 0;
};

/// The tip, by pivoting it in a fixed divot.
struct TipFit {
  Vector3 p_FTip;      ///< [m]
  Vector3 p_BDivot;    ///< where the divot was [m]
  Matrix3 covariance;  ///< of p_FTip [m^2], from the residuals
  Fit fit;
};

/// The shaft axis.
struct AxisFit {
  Vector3 s_F;         ///< unit, flange to tip
  Matrix3 covariance;  ///< [rad^2], zero along s_F
  Fit fit;             ///< rms and worst in rad
};

/// The trocar point, from shafts through it.
struct PointFit {
  Vector3 p_BRcm;      ///< [m]
  Matrix3 covariance;  ///< [m^2]
  Fit fit;
};

/// A shaft in B: a point on it and its unit direction.
struct Line {
  Vector3 p_B, s_B;
};

/// R_i t + p_i = c for all poses: the tip t in F that stays at one point c of B. Throws
/// CalibrationError; needs rotations about at least two axes.
TipFit calibrate_tip(const std::vector<Pose>& X_BF, const CalibrationLimits& limits = {});

/// R_i s = a for all poses: the axis s in F that keeps its direction a in B while the instrument is
/// turned about its own shaft in a snug guide (it may slide in it). 'p_FTip' tells which way is
/// outwards. Throws CalibrationError; needs some rolling, and nothing but rolling.
AxisFit calibrate_axis_by_rolling(const std::vector<Pose>& X_BF, const Vector3& p_FTip,
                                  const CalibrationLimits& limits = {});

/// The line through two points of the shaft, each found by pivoting: the tip, and the tip of a
/// shorter or longer rod in the same holder. Throws CalibrationError where they are too close.
AxisFit calibrate_axis_by_points(const TipFit& tip, const TipFit& second,
                                 const CalibrationLimits& limits = {});

/// The point nearest to all lines. Throws CalibrationError; needs tilts about at least one axis.
PointFit calibrate_trocar(const std::vector<Line>& shafts, const CalibrationLimits& limits = {});

/// The content of a surg_tool/1 file. Its residual is the larger of the tip's and the axis' (as a
/// distance at the tip), its condition the worse one, n counts all poses.
ToolCalibration tool_calibration(const TipFit& tip, const AxisFit& axis, const std::string& date);
/// The content of a surg_trocar/1 file.
TrocarCalibration trocar_calibration(const PointFit& point, const std::string& date);

}  // namespace surg
