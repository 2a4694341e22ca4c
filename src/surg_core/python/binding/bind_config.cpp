#include <pybind11/stl.h>

#include <optional>

#include "convert.hpp"
#include "surg_core/config_keys.hpp"
#include "surg_core/limits/workspace.hpp"
#include "surg_core/state/gate.hpp"

namespace surg::python {
namespace {

double to_number(const py::handle& item) { return item.cast<double>(); }

bool is_number(const py::handle& item) {
  return (PyFloat_Check(item.ptr()) || PyLong_Check(item.ptr())) && !PyBool_Check(item.ptr());
}

// By hand, because pybind11's variant would take the integer 1 for 'true'.
Value to_value(const std::string& key, const py::handle& item) {
  if (PyBool_Check(item.ptr())) return item.cast<bool>();
  if (is_number(item)) return to_number(item);
  if (py::isinstance<py::str>(item)) return item.cast<std::string>();
  if (py::isinstance<py::list>(item) || py::isinstance<py::tuple>(item)) {
    std::vector<double> numbers;
    std::vector<std::string> words;
    for (const py::handle& part : item) {
      if (is_number(part)) {
        numbers.push_back(to_number(part));
      } else if (py::isinstance<py::str>(part)) {
        words.push_back(part.cast<std::string>());
      } else {
        throw py::type_error(key + ": a list may hold numbers or texts");
      }
    }
    if (words.empty()) return numbers;
    if (numbers.empty()) return words;
    throw py::type_error(key + ": a list may hold numbers or texts, not both");
  }
  throw py::type_error(key + ": a bool, number, text or list of numbers or texts is needed");
}

Document to_document(const std::string& file, const py::dict& values,
                     const std::map<std::string, int>& lines) {
  Document document{file, {}, lines};
  for (const auto& [key, value] : values) {
    const auto name = key.cast<std::string>();
    document.values[name] = to_value(name, value);
  }
  return document;
}

template <typename T>
using Fields = std::vector<std::pair<const char*, double T::*>>;

template <typename T>
Fields<T> fields_of(const std::vector<config::Key<T>>& keys) {
  Fields<T> fields;
  for (const auto& key : keys) fields.emplace_back(key.name, key.member);
  return fields;
}

/// What a robot's file states, then what its link and its joints say.
Fields<Tuning> tuning_fields() {
  Fields<Tuning> fields = fields_of(config::tuning_keys());
  fields.insert(fields.end(), {{"link_timeout", &Tuning::link_timeout},
                               {"link_lag", &Tuning::link_lag},
                               {"dead_man", &Tuning::dead_man},
                               {"stop_deceleration", &Tuning::stop_deceleration},
                               {"braking_least", &Tuning::braking_least},
                               {"braking_most", &Tuning::braking_most}});
  return fields;
}

template <typename T>
void bind_numbers(py::module_& m, const char* name, const char* text, const Fields<T>& fields) {
  py::class_<T> type(m, name, text);
  for (const auto& [key, member] : fields) type.def_readonly(key, member);
  type.def(
      "as_dict",
      [fields](const T& self) {
        py::dict values;
        for (const auto& [key, member] : fields) values[key] = self.*member;
        return values;
      },
      "Name -> value, SI.");
  type.def("__repr__", [name, fields](const T& self) {
    std::string text;
    for (const auto& [key, member] : fields) {
      text += (text.empty() ? "" : ", ") + std::string(key) + "=" +
              py::repr(py::float_(self.*member)).cast<std::string>();
    }
    return std::string(name) + "(" + text + ")";
  });
}

/// What every calibration has beside its value.
template <typename T>
py::class_<T> bind_calibration_of(py::module_& m, const char* name, const char* text) {
  return py::class_<T>(m, name, text)
      .def_readonly("residual", &T::residual, "[m]")
      .def_readonly("condition", &T::condition)
      .def_readonly("n", &T::n)
      .def_readonly("date", &T::date)
      .def_readonly("source", &T::source, "measured, simulated or computed.")
      .def_readonly("serial", &T::serial, "Of the arm; empty: not stated.");
}

void bind_robot(py::module_& m) {
  py::enum_<Command>(m, "Command", "What a robot link obeys.")
      .value("JOINT_VELOCITY", Command::kJointVelocity)
      .value("CARTESIAN_VELOCITY", Command::kCartesianVelocity);

  py::class_<RobotConfig>(m, "RobotConfig", "One robot's YAML. Arrays have one value per joint.")
      .def_readonly("file", &RobotConfig::file)
      .def_readonly("name", &RobotConfig::name)
      .def_readonly("urdf", &RobotConfig::urdf, "As written: relative to the file's folder.")
      .def_readonly("base_link", &RobotConfig::base_link)
      .def_readonly("flange_link", &RobotConfig::flange_link)
      .def_readonly("command", &RobotConfig::command)
      .def_property_readonly("joint_names", tuple_of(&RobotConfig::joint_names))
      .def_property_readonly("home", array_of(&RobotConfig::home), "[rad]")
      .def_readonly("elbow", &RobotConfig::elbow, "Preferred swivel angle [rad]; NaN: none.")
      .def_property_readonly("position_min", array_of(&RobotConfig::position_min), "[rad]")
      .def_property_readonly("position_max", array_of(&RobotConfig::position_max), "[rad]")
      .def_property_readonly("velocity", array_of(&RobotConfig::velocity), "[rad/s]")
      .def_property_readonly("acceleration", array_of(&RobotConfig::acceleration), "[rad/s^2]")
      .def_readonly("limits", &RobotConfig::limits)
      .def_readonly("tuning", &RobotConfig::tuning)
      .def_property_readonly("joint_lag", array_of(&RobotConfig::joint_lag),
                             "[s] Of each joint; empty: all have tuning.link_lag.")
      .def_property_readonly("capsules", tuple_of(&RobotConfig::capsules),
                             "Empty: no clearance guard.");
}

void bind_link(py::module_& m) {
  py::class_<LinkConfig>(m, "LinkConfig", "A robot link's own parameters.")
      .def_readonly("name", &LinkConfig::name)
      .def_readonly("link_timeout", &LinkConfig::link_timeout, "[s]")
      .def_readonly("link_lag", &LinkConfig::link_lag, "[s] Of the slowest joint.")
      .def_property_readonly("joint_lag", array_of(&LinkConfig::joint_lag),
                             "[s] Of each joint; empty: all alike.")
      .def_readonly("acceleration", &LinkConfig::acceleration, "Share of the robot's.")
      .def_readonly("dead_man", &LinkConfig::dead_man, "[s]")
      .def_readonly("stop_deceleration", &LinkConfig::stop_deceleration, "[rad/s^2]")
      .def_readonly("driver", &LinkConfig::driver, "Folder, relative to the YAML; empty: none.");
}

void bind_calibrations(py::module_& m) {
  py::class_<CameraConfig>(m, "CameraConfig", "The parallel cameras in an endoscope's tip.")
      .def_property_readonly(
          "frames", tuple_of(&CameraConfig::frames),
          "URDF links, optical (x right, y down, z away): left and right, or one.")
      .def_readonly("fovy", &CameraConfig::fovy, "Vertical field of view [rad].")
      .def_readonly("baseline", &CameraConfig::baseline, "Left to right [m]; 0: one camera.");

  py::class_<WristConfig>(m, "WristConfig", "A wrist: pitch about y, then yaw about x.")
      .def_readonly("geometry", &WristConfig::geometry)
      .def_property_readonly("min", array_of(&WristConfig::min),
                             "Pitch, yaw and drive's roll (3,) [rad].")
      .def_property_readonly("max", array_of(&WristConfig::max), "The same (3,) [rad].")
      .def_property_readonly("rolls", &WristConfig::rolls, "Whether the drive turns the shaft.")
      .def_readonly("velocity", &WristConfig::velocity, "[rad/s]")
      .def_readonly("acceleration", &WristConfig::acceleration, "[rad/s^2]")
      .def_readonly("drive_lag", &WristConfig::drive_lag, "From a command to its motion [s].");

  py::class_<InstrumentConfig>(m, "InstrumentConfig", "One instrument's YAML. Jaw angles [rad].")
      .def_readonly("file", &InstrumentConfig::file)
      .def_readonly("name", &InstrumentConfig::name)
      .def_readonly("urdf", &InstrumentConfig::urdf, "As written: relative to the file's folder.")
      .def_readonly("mount_link", &InstrumentConfig::mount_link)
      .def_readonly("tip_link", &InstrumentConfig::tip_link)
      .def_readonly("jaw_min", &InstrumentConfig::jaw_min, "Closed.")
      .def_readonly("jaw_max", &InstrumentConfig::jaw_max)
      .def_readonly("jaw_velocity", &InstrumentConfig::jaw_velocity, "[rad/s]; 0: has no jaw.")
      .def_readonly("passive", &InstrumentConfig::passive, "No drive and no tool link.")
      .def_property_readonly(
          "camera",
          [](const InstrumentConfig& self) -> std::optional<CameraConfig> {
            if (self.camera.frames.empty()) return std::nullopt;
            return self.camera;
          },
          "None: not an endoscope.")
      .def_readonly("wrist", &InstrumentConfig::wrist, "None: a straight instrument.")
      .def_property_readonly("capsules", tuple_of(&InstrumentConfig::capsules));

  bind_calibration_of<ToolCalibration>(m, "ToolCalibration",
                                       "Shaft axis and tip in the flange frame.")
      .def_property_readonly("s_F", array_of(&ToolCalibration::s_F), "Unit, (3,).")
      .def_property_readonly("p_FTip", array_of(&ToolCalibration::p_FTip), "[m] (3,)");

  bind_calibration_of<TrocarCalibration>(m, "TrocarCalibration",
                                         "Taught trocar point in the robot base.")
      .def_property_readonly("p_BRcm", array_of(&TrocarCalibration::p_BRcm), "[m] (3,)");
}

void bind_base(py::module_& m) {
  bind_calibration_of<BaseCalibration>(m, "BaseCalibration", "A measured robot base; surg_base/1.")
      .def_property_readonly("X_WB", array_of(&BaseCalibration::X_WB), "(4, 4) [m]")
      .def_property_readonly("covariance", array_of(&BaseCalibration::covariance),
                             "(6, 6) rotation first.")
      .def_readonly("method", &BaseCalibration::method, "touch, tip or points.")
      .def_readonly("reference", &BaseCalibration::reference, "The cell's first arm.")
      .def_property_readonly("reference_xyz", array_of(&BaseCalibration::reference_xyz), "[m] (3,)")
      .def_property_readonly("reference_rpy", array_of(&BaseCalibration::reference_rpy),
                             "[rad] (3,)")
      .def_readonly("camera_sha256", &BaseCalibration::camera_sha256, "none: seen by no camera.");
}

void bind_cell_endoscope(py::module_& m) {
  py::class_<CellEndoscope>(m, "CellEndoscope", "The source of a real endoscope's pictures.")
      .def_readonly("source", &CellEndoscope::source, "URI such as v4l2:/dev/video0.")
      .def_readonly("layout", &CellEndoscope::layout, "Of the eyes in a grabbed picture.")
      .def_property_readonly(
          "size", [](const CellEndoscope& e) { return py::make_tuple(e.width, e.height); },
          "Width and height of a grabbed picture [px]; 0, 0: as the device has it.")
      .def_readonly("rate", &CellEndoscope::rate, "[1/s]; 0: as the device has it.")
      .def_readonly("swap", &CellEndoscope::swap)
      .def_readonly("flip", &CellEndoscope::flip)
      .def_readonly("latency", &CellEndoscope::latency, "[s] From glass to stamp.");
}

void bind_cell(py::module_& m) {
  py::class_<CellHardware>(m, "CellHardware", "What a cell states of a real or emulated arm.")
      .def_readonly("address", &CellHardware::address)
      .def_readonly("serial", &CellHardware::serial)
      .def_readonly("payload_mass", &CellHardware::payload_mass, "[kg]")
      .def_property_readonly("payload_cog", array_of(&CellHardware::payload_cog), "[m] (3,)")
      .def_readonly("tool_link", &CellHardware::tool_link, "passive, drive or none.")
      .def_readonly("realtime", &CellHardware::realtime, "Priority of the driver.")
      .def_readonly("calibration_days", &CellHardware::calibration_days, "0: not stated.")
      .def_readonly("link_lag", &CellHardware::link_lag,
                    "[s] Measured, of the slowest joint; NaN: not stated.")
      .def_property_readonly("joint_lag", array_of(&CellHardware::joint_lag),
                             "[s] Of each joint; empty: all alike.")
      .def_readonly("home_confirmed", &CellHardware::home_confirmed)
      .def_readonly("commissioning", &CellHardware::commissioning, "Slow, not yet calibrated.")
      .def_property_readonly("emulated", &CellHardware::emulated, "The address is on loopback.");

  py::class_<CellArm>(m, "CellArm", "One arm as cell.yaml states it.")
      .def_readonly("name", &CellArm::name)
      .def_readonly("robot", &CellArm::robot, "As written: relative to the cell file's folder.")
      .def_readonly("instrument", &CellArm::instrument)
      .def_readonly("link", &CellArm::link)
      .def_property_readonly("base_xyz", array_of(&CellArm::base_xyz), "[m] (3,)")
      .def_property_readonly("base_rpy", array_of(&CellArm::base_rpy), "[rad] (3,)")
      .def_property_readonly("home", tuple_of(&CellArm::home),
                             "[rad] Instead of the robot's; empty: the robot's.")
      .def_readonly("elbow", &CellArm::elbow, "Preferred swivel angle [rad]; NaN: none.")
      .def_property_readonly(
          "hardware", [](const CellArm& a) { return a.hardware; },
          "None: driven by the simulator, or by a link that somebody starts by hand.")
      .def_readonly("limits", &CellArm::limits)
      .def_property_readonly("fixtures", tuple_of(&CellArm::fixtures),
                             "Virtual fixtures, in the robot's base frame.");

  py::class_<CellConfig>(m, "CellConfig", "A user's whole system: cell.yaml.")
      .def_readonly("file", &CellConfig::file)
      .def_readonly("name", &CellConfig::name)
      .def_readonly("network", &CellConfig::network)
      .def_property_readonly(
          "machines", [](const CellConfig& c) { return c.machines; },
          "IPv4 address on the isolated network by role: robot, operator, endoscope.")
      .def_readonly("clearance", &CellConfig::clearance)
      .def_property_readonly(
          "endoscope", [](const CellConfig& c) { return c.endoscope; }, "None: the simulator's.")
      .def_property_readonly("arms", tuple_of(&CellConfig::arms));
}

}  // namespace

void bind_config(py::module_& m) {
  py::register_exception<ConfigError>(m, "ConfigError", PyExc_ValueError).doc() =
      "A configuration that must not be used: file, key, value, what is allowed.";

  py::class_<Document>(m, "Document", "A YAML file flattened to dotted keys.")
      .def(py::init(&to_document), py::arg("file"), py::arg("values"),
           py::arg("lines") = std::map<std::string, int>(),
           "file: shown in errors; values: key -> bool, number, text or list of numbers or texts;\n"
           "lines: key -> line, from 1.")
      .def_readonly("file", &Document::file)
      .def_readonly("values", &Document::values)
      .def_readonly("lines", &Document::lines);

  bind_numbers(m, "Limits", "Every limit of an arm, SI.", fields_of(config::limit_keys()));
  bind_numbers(m, "Tuning", "Gains [1/s] and times [s] of the controller.", tuning_fields());
  bind_robot(m);
  bind_calibrations(m);
  bind_base(m);
  bind_cell_endoscope(m);
  bind_cell(m);
  bind_link(m);

  const char* text = "Checks the document against the schema. Raises ConfigError.";
  m.def("parse_robot", &parse_robot, py::arg("document"), text);
  m.def("parse_tool", &parse_tool, py::arg("document"), text);
  m.def("parse_link", &parse_link, py::arg("document"), text);
  m.def("with_link", &with_link, py::arg("robot"), py::arg("link"),
        "The robot as a link drives it: its lag, its time-out, its share of the acceleration.");
  m.def("parse_base", &parse_base, py::arg("document"), text);
  m.def("parse_cell", &parse_cell, py::arg("document"), text);
  m.def(
      "inside_workspace",
      [](const Limits& limits, const Array& p_RTip) {
        return inside_workspace(limits, to_vector3(p_RTip, "p_RTip"));
      },
      py::arg("limits"), py::arg("p_RTip"),
      "Whether a tip target (3,) in the rcm frame lies within the depth range and the cone.");
  m.def(
      "outside_workspace",
      [](const Limits& limits, const Array& p_RTip) {
        return outside_workspace(limits, to_vector3(p_RTip, "p_RTip"));
      },
      py::arg("limits"), py::arg("p_RTip"),
      "How far [m] a tip position (3,) lies outside depth range and cone; negative: inside.");
  m.def("check_step", &check_step, py::arg("limits"), py::arg("begins"), py::arg("since"),
        py::arg("distance"), py::arg("roll_distance"),
        "Step test of a pose stream: Reason.NONE, STEP_TOO_LARGE or STREAM_START_TOO_FAR.\n"
        "Distances [m], [rad] from the last accepted pose, which is 'since' [s] ago, or from the\n"
        "set-point where a stream begins.");
  m.def("check_wrist_step", &check_wrist_step, py::arg("limits"), py::arg("wrist"),
        py::arg("begins"), py::arg("since"), py::arg("turned"),
        "The same of a wrist's joints; turned [rad]: by the one that turns farther.");
}

}  // namespace surg::python
