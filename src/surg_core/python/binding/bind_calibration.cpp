#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/kinematics/calibration.hpp"

namespace surg::python {
namespace {

const CalibrationLimits kUsual;

void bind_fits(py::module_& m) {
  py::class_<Fit>(m, "Fit", "How well n observations agree.")
      .def_readonly("n", &Fit::n, "Poses or shafts.")
      .def_readonly("rms", &Fit::rms, "Of the distances left [m]; of an axis [rad].")
      .def_readonly("worst", &Fit::worst, "Largest of them.")
      .def_readonly("condition", &Fit::condition, "Of the equations; 1 is best.")
      .def("__repr__", [](const Fit& f) {
        return py::str("Fit(n={}, rms={:.3g}, worst={:.3g}, condition={:.3g})")
            .format(f.n, f.rms, f.worst, f.condition);
      });

  py::class_<TipFit>(m, "TipFit", "The tip, by pivoting it in a fixed divot.")
      .def_property_readonly("p_FTip", array_of(&TipFit::p_FTip), "(3,) in the flange frame [m].")
      .def_property_readonly("p_BDivot", array_of(&TipFit::p_BDivot), "(3,) in the base [m].")
      .def_property_readonly("covariance", array_of(&TipFit::covariance),
                             "(3, 3) of p_FTip [m^2], from the residuals.")
      .def_readonly("fit", &TipFit::fit);

  py::class_<AxisFit>(m, "AxisFit", "The shaft axis.")
      .def_property_readonly("s_F", array_of(&AxisFit::s_F),
                             "(3,) unit, flange to tip, in the flange frame.")
      .def_property_readonly("covariance", array_of(&AxisFit::covariance),
                             "(3, 3) [rad^2], zero along s_F.")
      .def_readonly("fit", &AxisFit::fit, "rms and worst in rad.");

  py::class_<PointFit>(m, "PointFit", "The trocar point, from shafts through it.")
      .def_property_readonly("p_BRcm", array_of(&PointFit::p_BRcm), "(3,) in the base [m].")
      .def_property_readonly("covariance", array_of(&PointFit::covariance), "(3, 3) [m^2].")
      .def_readonly("fit", &PointFit::fit);
}

void bind_solvers(py::module_& m) {
  m.def(
      "calibrate_tip",
      [](const Array& X_BF) { return calibrate_tip(to_poses(X_BF, "X_BF"), kUsual); },
      py::arg("X_BF"),
      "The tip in the flange frame from flange poses with the tip in one divot.\n\n"
      "X_BF: (n, 4, 4), or (n, 7) with x, y, z and a quaternion x, y, z, w. Raises "
      "CalibrationError\n"
      "for too few poses, too little tilting about two axes, or a tip that has left its divot.");
  m.def(
      "calibrate_axis_by_rolling",
      [](const Array& X_BF, const Array& p_FTip) {
        return calibrate_axis_by_rolling(to_poses(X_BF, "X_BF"), to_vector3(p_FTip, "p_FTip"),
                                         kUsual);
      },
      py::arg("X_BF"), py::arg("p_FTip"),
      "The shaft axis from flange poses (n, 4, 4) or (n, 7) in which the instrument was turned "
      "about\n"
      "its own shaft in a guide; p_FTip (3,) tells which way is outwards. Raises "
      "CalibrationError.");
  m.def(
      "calibrate_axis_by_points",
      [](const TipFit& tip, const TipFit& second) {
        return calibrate_axis_by_points(tip, second, kUsual);
      },
      py::arg("tip"), py::arg("second"),
      "The shaft axis through two pivoted points of it. Raises CalibrationError when too close.");
  m.def(
      "calibrate_trocar",
      [](const Array& p_B, const Array& s_B) {
        const auto n = p_B.ndim() == 2 ? p_B.shape(0) : 0;
        check_shape(p_B, {n, 3}, "p_B");
        check_shape(s_B, {n, 3}, "s_B");
        std::vector<Line> lines;
        for (py::ssize_t i = 0; i < n; ++i) {
          lines.push_back({Vector3(p_B.at(i, 0), p_B.at(i, 1), p_B.at(i, 2)),
                           Vector3(s_B.at(i, 0), s_B.at(i, 1), s_B.at(i, 2))});
        }
        return calibrate_trocar(lines, kUsual);
      },
      py::arg("p_B"), py::arg("s_B"),
      "The point of the base nearest to n shafts: a point on each (n, 3) [m], unit directions (n, "
      "3).\n\n"
      "Raises CalibrationError for too few, too little tilting, or shafts that do not meet.");
  m.def("tool_calibration", &tool_calibration, py::arg("tip"), py::arg("axis"), py::arg("date"),
        "The content of a surg_tool/1 file; date as text, such as 2026-11-21.");
  m.def("trocar_calibration", &trocar_calibration, py::arg("point"), py::arg("date"),
        "The content of a surg_trocar/1 file.");
}

}  // namespace

void bind_calibration(py::module_& m) {
  py::register_exception<CalibrationError>(m, "CalibrationError", PyExc_ValueError).doc() =
      "A calibration that must not be used: what was found, what is allowed, what to do.";

  bind_fits(m);
  bind_solvers(m);
}

}  // namespace surg::python
