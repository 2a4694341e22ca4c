#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <string>
#include <vector>

#include "convert.hpp"
#include "surg_core/files/arm_setup.hpp"
#include "surg_core/files/document.hpp"
#include "surg_core/files/urdf.hpp"

namespace surg::python {
namespace {

using Path = std::filesystem::path;

template <typename Config>
void bind_loader(py::module_& m, const char* name, Config (*parse)(const Document&),
                 const std::string& what) {
  m.def(
      name, [parse](const Path& path) { return parse(load_document(path.string())); },
      py::arg("path"),
      (what + " Raises ConfigError with file, line, key, value and what is allowed.").c_str());
}

void bind_urdf_parts(py::module_& m) {
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
}

void bind_urdf_readers(py::module_& m) {
  m.def(
      "load_urdf", [](const Path& path) { return load_urdf(path.string()); }, py::arg("path"),
      "Reads a URDF in the encoding that it states: its text, links and joints. Raises "
      "ConfigError\n"
      "for a missing or malformed file, xacro that nobody has expanded, a number that is none, or\n"
      "links and joints that are not one tree.");
  m.def(
      "read_joints",
      [](const Path& path, const std::string& start, const std::string& end) {
        return joints_between(load_urdf(path.string()), start, end);
      },
      py::arg("path"), py::arg("start"), py::arg("end"),
      "The joints from link 'start' down to link 'end', in this order, fixed ones included. "
      "Raises\n"
      "ConfigError as load_urdf, for an unknown link, no way from start to end, or a joint of a\n"
      "kind other than revolute, continuous or fixed.");
  m.def(
      "chain_from_urdf",
      [](const Path& path, const std::string& base, const std::string& flange,
         const std::vector<std::string>& joint_names) {
        return chain_of(load_urdf(path.string()), base, flange, joint_names);
      },
      py::arg("path"), py::arg("base_link"), py::arg("flange_link"), py::arg("joint_names"),
      "The serial chain from one link to another, without a robot's YAML. joint_names: the "
      "turning\n"
      "joints in order from the base, exactly those on the way; fixed joints in between are "
      "folded\n"
      "into them. Raises ConfigError as read_joints, for other joints than named, or one without\n"
      "the limits that URDF demands.");
  m.def(
      "fixed_transform",
      [](const Path& path, const std::string& parent, const std::string& child) {
        return from_pose(fixed_transform(load_urdf(path.string()), parent, child));
      },
      py::arg("path"), py::arg("parent_link"), py::arg("child_link"),
      "Pose (4, 4) of one link in another, which only fixed joints may separate. Raises "
      "ConfigError\n"
      "as read_joints, and for a joint on the way that is not fixed.");
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
  m.def(
      "read_document", [](const Path& path) { return load_document(path.string()); },
      py::arg("path"),
      "Reads and flattens a YAML file. Raises ConfigError for a file that is missing, unreadable, "
      "no\n"
      "YAML, not a mapping, or that says a key twice.");
  bind_loader(m, "load_robot", &parse_robot, "Reads a robot YAML.");
  bind_loader(m, "load_instrument", &parse_instrument, "Reads an instrument YAML.");
  bind_loader(m, "load_tool", &parse_tool, "Reads a tool calibration.");
  bind_loader(m, "load_trocar", &parse_trocar, "Reads a trocar calibration.");
  bind_loader(m, "load_kinematics", &parse_kinematics, "Reads an arm's own kinematics.");
  m.def(
      "kinematics_of",
      [](const std::string& text, const std::string& file) {
        return parse_kinematics(parse_document(text, file));
      },
      py::arg("text"), py::arg("file"),
      "An arm's own kinematics from the text of their file; 'file' is named in errors.");
  m.def("parse_document", &parse_document, py::arg("text"), py::arg("file"),
        "Flattens a YAML text; 'file' is named in errors. Raises ConfigError.");
  bind_urdf_parts(m);
  bind_urdf_readers(m);
  bind_arm_setup(m);
}

}  // namespace surg::python
