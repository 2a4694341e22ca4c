#include "convert.hpp"

PYBIND11_MODULE(_core, m) {
  namespace binding = surg::python;
  m.doc() =
      "The C++ core of surg_core. Arrays are float64 in C order, copied in and out; poses are (4, "
      "4); SI "
      "units. A wrong shape raises ValueError.";
  binding::bind_kinematics(m);
  binding::bind_motion(m);
  binding::bind_rcm(m);
  binding::bind_exact(m);
  binding::bind_config(m);
  binding::bind_limits(m);
  binding::bind_controller(m);
  binding::bind_calibration(m);
}
