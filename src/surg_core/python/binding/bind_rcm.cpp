#include "convert.hpp"
#include "surg_core/law/rcm.hpp"

namespace surg::python {
namespace {

/// shaft_state of many poses; every array has one row per pose.
struct ShaftStates {
  Array p_BTip, s, e, p_BNear, depth, deviation;
};

ShaftStates shaft_states(const Array& X_BF, const Array& s_F, const Array& p_FTip,
                         const Array& p_BRcm) {
  const std::vector<Pose> poses = to_poses(X_BF, "X_BF");
  const Tool tool{to_vector3(s_F, "s_F"), to_vector3(p_FTip, "p_FTip")};
  const Vector3 rcm = to_vector3(p_BRcm, "p_BRcm");
  const auto n = static_cast<py::ssize_t>(poses.size());
  Rows p_BTip(n, 3), s(n, 3), e(n, 3), p_BNear(n, 3);
  Array depth(n), deviation(n);
  double *depths = depth.mutable_data(), *deviations = deviation.mutable_data();
  {
    py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < n; ++i) {
      const ShaftState state = shaft_state(poses[i], tool, rcm);
      p_BTip.set(i, state.p_BTip);
      s.set(i, state.s);
      e.set(i, state.e);
      p_BNear.set(i, state.p_BNear);
      depths[i] = state.depth;
      deviations[i] = state.e.norm();
    }
  }
  return {p_BTip.take(), s.take(), e.take(), p_BNear.take(), frozen(depth), frozen(deviation)};
}

void bind_shaft_states(py::module_& m) {
  py::class_<ShaftStates>(m, "ShaftStates",
                          "shaft_state of n poses, in B: read-only arrays, one row per pose.")
      .def_readonly("p_BTip", &ShaftStates::p_BTip, "(n, 3) [m]")
      .def_readonly("s", &ShaftStates::s, "(n, 3) unit shaft axes, to the tip.")
      .def_readonly("e", &ShaftStates::e, "(n, 3) lateral vectors from shaft to trocar [m].")
      .def_readonly("p_BNear", &ShaftStates::p_BNear, "(n, 3) shaft points nearest the trocar [m].")
      .def_readonly("depth", &ShaftStates::depth, "(n,) insertion [m], positive inside.")
      .def_readonly("deviation", &ShaftStates::deviation, "(n,) kinematic RCM deviation |e| [m].");
  m.def("shaft_states", &shaft_states, py::arg("X_BF"), py::arg("s_F"), py::arg("p_FTip"),
        py::arg("p_BRcm"),
        "shaft_state of many flange poses (n, 4, 4), or (n, 7): x, y, z and a quaternion x, y, z,\n"
        "w. Releases the GIL.");
}

void bind_shaft_state(py::module_& m) {
  py::class_<ShaftState>(m, "ShaftState", "Where the instrument is relative to its trocar, in B.")
      .def_property_readonly("p_BF", array_of(&ShaftState::p_BF))
      .def_property_readonly("p_BTip", array_of(&ShaftState::p_BTip))
      .def_property_readonly("s", array_of(&ShaftState::s), "Unit shaft axis, to the tip.")
      .def_property_readonly(
          "e", array_of(&ShaftState::e),
          "Lateral vector from the shaft to the trocar; |e| is the RCM deviation [m].")
      .def_property_readonly("p_BNear", array_of(&ShaftState::p_BNear))
      .def_readonly("depth", &ShaftState::depth, "Insertion depth [m], positive inside.")
      .def("__repr__", [](const ShaftState& s) {
        return py::str("ShaftState(depth={!r} m, deviation={!r} m)").format(s.depth, s.e.norm());
      });

  m.def(
      "shaft_state",
      [](const Array& X_BF, const Array& s_F, const Array& p_FTip, const Array& p_BRcm) {
        return shaft_state(to_pose(X_BF, "X_BF"),
                           {to_vector3(s_F, "s_F"), to_vector3(p_FTip, "p_FTip")},
                           to_vector3(p_BRcm, "p_BRcm"));
      },
      py::arg("X_BF"), py::arg("s_F"), py::arg("p_FTip"), py::arg("p_BRcm"),
      "Shaft and trocar from the flange pose (4, 4), the tool calibration (3,), (3,) in F and the\n"
      "trocar (3,) in B.");
}

void bind_angles(py::module_& m) {
  m.def(
      "shaft_direction",
      [](double yaw, double pitch) { return from_matrix(shaft_direction(yaw, pitch)); },
      py::arg("yaw"), py::arg("pitch"),
      "(sin yaw cos pitch, sin pitch, cos yaw cos pitch) in the rcm frame.");
  m.def(
      "shaft_angles",
      [](const Array& s_R) {
        const Eigen::Vector2d angles = shaft_angles(to_vector3(s_R, "s_R"));
        return py::make_tuple(angles[0], angles[1]);
      },
      py::arg("s_R"), "(yaw, pitch) [rad] of a unit direction (3,) in the rcm frame.");
  m.def(
      "rcm_frame",
      [](const Array& s_home, const Array& p_BRcm) {
        return from_pose(rcm_frame(to_vector3(s_home, "s_home"), to_vector3(p_BRcm, "p_BRcm")));
      },
      py::arg("s_home"), py::arg("p_BRcm"),
      "X_BR (4, 4): origin at the trocar, z = the home shaft axis into the patient, x = base x "
      "made\n"
      "perpendicular to z (base y where base x runs along the shaft).");
  m.def(
      "minimal_rotation",
      [](const Array& a, const Array& b) {
        return from_matrix(minimal_rotation(to_vector3(a, "a"), to_vector3(b, "b")));
      },
      py::arg("a"), py::arg("b"), "Rotation (3, 3) of least angle taking unit a to unit b.");
}

}  // namespace

void bind_rcm(py::module_& m) {
  bind_shaft_state(m);
  bind_shaft_states(m);
  bind_angles(m);
}

}  // namespace surg::python
