#include "convert.hpp"

PYBIND11_MODULE(_core, m) {
  namespace binding = surg::python;
  m.doc() =
      "The C++ core of surg_core. Arrays are float64 in C order, copied in and out; poses are "
      "(4, 4); SI units. A wrong shape raises ValueError.";
  pybind11::module_ testing = m.def_submodule(
      "testing",
      "Parts of the core one by one, for tests and experiments; they may change with any version.");
  // A type before its first use in a signature: docstrings and stubs name it then.
  binding::bind_operating_state(m, testing);
  binding::bind_kinematics(m, testing);
  binding::bind_rcm(m, testing);
  binding::bind_motion(testing);
  binding::bind_exact(testing);
  binding::bind_fixtures(m);
  binding::bind_capsules(m);
  binding::bind_config(m, testing);
  binding::bind_limits(testing);
  binding::bind_clearance(m);
  binding::bind_controller(m);
  binding::bind_calibration(m);
}
