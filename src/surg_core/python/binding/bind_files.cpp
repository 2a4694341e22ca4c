#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/files/arm_setup.hpp"
#include "surg_core/files/document.hpp"
#include "surg_core/files/urdf.hpp"

namespace surg::python {
namespace {

void bind_urdf(py::module_& m) {
  py::class_<UrdfLimit>(m, "UrdfLimit", "A joint's <limit>; None: not stated.")
      .def_readonly("lower", &UrdfLimit::lower, "[rad], or [m] of a prismatic joint.")
      .def_readonly("upper", &UrdfLimit::upper)
      .def_readonly("velocity", &UrdfLimit::velocity, "[rad/s], [m/s]");
  py::class_<UrdfMimic>(m, "UrdfMimic", "The joint that another one follows.")
      .def_readonly("joint", &UrdfMimic::joint)
      .def_readonly("multiplier", &UrdfMimic::multiplier)
      .def_readonly("offset", &UrdfMimic::offset, "[rad], [m]");
  py::class_<UrdfJoint>(m, "UrdfJoint", "One joint of a URDF.")
      .def_readonly("name", &UrdfJoint::name)
      .def_readonly("kind", &UrdfJoint::kind,
                    "revolute, continuous, prismatic, fixed, floating or planar.")
      .def_readonly("parent", &UrdfJoint::parent, "Link it hangs on.")
      .def_readonly("child", &UrdfJoint::child, "Link that hangs on it.")
      .def_property_readonly("X_PJ", array_of(&UrdfJoint::X_PJ),
                             "(4, 4) joint frame in the parent link at position 0 [m].")
      .def_property_readonly("axis", array_of(&UrdfJoint::axis),
                             "(3,) in the joint frame, of length 1.")
      .def_readonly("limit", &UrdfJoint::limit)
      .def_readonly("mimic", &UrdfJoint::mimic)
      .def_property_readonly("turning", &UrdfJoint::turning, "Revolute or continuous.");
  py::class_<Urdf>(m, "Urdf", "A URDF file: one tree of links.")
      .def_readonly("file", &Urdf::file)
      .def_readonly("text", &Urdf::text)
      .def_property_readonly("links", tuple_of(&Urdf::links))
      .def_property_readonly("joints", [](const Urdf& u) { return u.joints; });
  m.def("load_urdf", &load_urdf, py::arg("path"),
        "Reads a URDF in the encoding that it states. Raises ConfigError.");
  m.def("joints_between", &joints_between, py::arg("urdf"), py::arg("start"), py::arg("end"),
        "The joints from one link down to another. Raises ConfigError.");
  m.def("chain_of", &chain_of, py::arg("urdf"), py::arg("base"), py::arg("flange"),
        py::arg("joint_names"), "The chain from one link to another. Raises ConfigError.");
  m.def(
      "fixed_transform",
      [](const Urdf& urdf, const std::string& parent, const std::string& child) {
        return from_pose(fixed_transform(urdf, parent, child));
      },
      py::arg("urdf"), py::arg("parent"), py::arg("child"),
      "Pose (4, 4) of one link in another, with only fixed joints between. Raises ConfigError.");
  m.def(
      "load_chain", [](const RobotConfig& robot) { return load_model(robot).chain; },
      py::arg("robot"),
      "The chain of a robot from its URDF, checked against its YAML: joints, and limits that\n"
      "tighten the URDF's. Raises ConfigError.");
}

void bind_arm_setup(py::module_& m) {
  py::class_<ArmSetup>(m, "ArmSetup", "One arm of a cell with all its files read and checked.")
      .def_readonly("arm", &ArmSetup::arm)
      .def_readonly("robot", &ArmSetup::robot)
      .def_readonly("link", &ArmSetup::link)
      .def_readonly("driver", &ArmSetup::driver, "Folder, absolute; empty: none.")
      .def_property_readonly("link_settings", [](const ArmSetup& a) { return a.link_settings; })
      .def_property_readonly("instrument", [](const ArmSetup& a) { return a.mounted.instrument; })
      .def_property_readonly("tool", [](const ArmSetup& a) { return a.mounted.tool; })
      .def_property_readonly("instrument_urdf",
                             [](const ArmSetup& a) { return a.mounted.instrument_urdf; })
      .def_readonly("trocar", &ArmSetup::trocar)
      .def_readonly("limits", &ArmSetup::limits)
      .def_property_readonly("X_WB", array_of(&ArmSetup::X_WB), "(4, 4)")
      .def_property_readonly("X_WB_stated", array_of(&ArmSetup::X_WB_stated), "(4, 4)")
      .def_readonly("robot_urdf", &ArmSetup::robot_urdf)
      .def_property_readonly("chain", [](const ArmSetup& a) { return a.model.chain; })
      .def_readonly("kinematics", &ArmSetup::kinematics);
  m.def("cell_file_of", &cell_file_of, py::arg("cell"), "The cell.yaml of a cell, absolute.");
  m.def("load_arm", &load_arm, py::arg("cell"), py::arg("arm"),
        "Reads one arm of a cell. Raises ConfigError.");
}

}  // namespace

void bind_files(py::module_& m) {
  m.def("load_document", &load_document, py::arg("path"),
        "Reads and flattens a YAML file. Raises ConfigError.");
  m.def("parse_document", &parse_document, py::arg("text"), py::arg("file"),
        "Flattens a YAML text; 'file' is named in errors. Raises ConfigError.");
  bind_urdf(m);
  bind_arm_setup(m);
}

}  // namespace surg::python
