// Kinematics of a wrist for Python: the closed form in both directions.
#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/kinematics/wrist.hpp"

namespace surg::python {
namespace {

Pose pose_of(const TipFrame& frame) {
  Pose X = Pose::Identity();
  X.linear() = frame.R;
  X.translation() = frame.p;
  return X;
}

TipFrame frame_of(const Array& X, const char* name) {
  const Pose pose = to_pose(X, name);
  return {pose.translation(), pose.linear()};
}

Array tip(const WristGeometry& wrist, const Array& X_RCentre, const Array& joints) {
  return from_pose(pose_of(
      tip_of_wrist(wrist, {frame_of(X_RCentre, "X_RCentre"), to_vector2(joints, "joints")})));
}

std::vector<std::pair<Array, Array>> wrists(const WristGeometry& wrist, const Array& X_RTip) {
  std::vector<std::pair<Array, Array>> out;
  const auto found = wrists_of_tip(wrist, frame_of(X_RTip, "X_RTip"));
  if (!found) return out;
  for (const WristPose& pose : *found) {
    out.emplace_back(from_pose(pose_of(pose.centre)), from_matrix(pose.joints));
  }
  return out;
}

}  // namespace

void bind_wrist(py::module_& m) {
  py::class_<WristGeometry>(m, "WristGeometry", "Lengths of a wrist [m].")
      .def(py::init([](double pitch_to_yaw, double yaw_to_tip, double turn) {
             return WristGeometry{pitch_to_yaw, yaw_to_tip, turn};
           }),
           py::arg("pitch_to_yaw"), py::arg("yaw_to_tip"), py::arg("turn") = 0.0,
           "turn [rad]: of the pitch axis about the shaft, against y of the tool frame.")
      .def_readonly("pitch_to_yaw", &WristGeometry::pitch_to_yaw)
      .def_readonly("yaw_to_tip", &WristGeometry::yaw_to_tip)
      .def_readonly("turn", &WristGeometry::turn, "[rad]");
  m.def("tip_of_wrist", &tip, py::arg("wrist"), py::arg("X_RCentre"), py::arg("joints"),
        "Tip (4, 4) behind a wrist: X_RCentre (4, 4) is the rolled shaft at the pitch axis, joints "
        "(2,) pitch and yaw [rad].");
  m.def("wrists_of_tip", &wrists, py::arg("wrist"), py::arg("X_RTip"),
        "The two wrists that hold the tip at X_RTip (4, 4) in the rcm frame, whose origin is the "
        "trocar: pairs of X_RCentre (4, 4) and joints (2,) [rad], first the one with |pitch| < "
        "pi/2. Empty where the yaw axis points to the trocar.");
}

}  // namespace surg::python
