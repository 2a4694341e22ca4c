#include <string>

#include "convert.hpp"

namespace {

/// numpy 2 moved fields of its array type. A module built by an older pybind11 reads the old places
/// and returns wrong arrays without an error.
void check_numpy() {
#if PYBIND11_VERSION_HEX < 0x020C0000
  const auto version = pybind11::module_::import("numpy").attr("__version__").cast<std::string>();
  if (std::stoi(version) < 2) return;
  throw pybind11::import_error(
      "surg_core was built with pybind11 " + std::to_string(PYBIND11_VERSION_MAJOR) + "." +
      std::to_string(PYBIND11_VERSION_MINOR) +
      ", which returns wrong arrays under numpy 2 and later; here is numpy " + version +
      ". Install numpy<2, or build surg_core with pybind11 2.12 or later.");
#endif
}

}  // namespace

PYBIND11_MODULE(_core, m) {
  namespace binding = surg::python;
  check_numpy();
  m.doc() =
      "The C++ core of surg_core. Arrays are float64 in C order, copied in and out; poses are "
      "(4, 4); SI units. A wrong shape raises ValueError.";
  // A type before its first use in a signature: docstrings and stubs name it then.
  binding::bind_operating_state(m);
  binding::bind_kinematics(m);
  binding::bind_rcm(m);
  binding::bind_wrist(m);
  binding::bind_motion(m);
  binding::bind_fixtures(m);
  binding::bind_capsules(m);
  binding::bind_config(m);
  binding::bind_files(m);
  binding::bind_clearance(m);
  binding::bind_controller(m);
  binding::bind_calibration(m);
}
