#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/limits/clearance.hpp"

namespace surg::python {
namespace {

Array point(const Vector3& p) { return frozen(from_matrix(p)); }

void bind_arm_shape(py::module_& m) {
  py::class_<ArmShape>(m, "ArmShape", "One arm with its instrument, as capsules.")
      .def(py::init([](const std::string& name, const Chain& chain, const Array& X_WB,
                       const RobotConfig& robot, const InstrumentConfig& instrument,
                       const ToolCalibration& tool) {
             return arm_shape(name, chain, to_pose(X_WB, "X_WB"), robot, instrument, tool);
           }),
           py::arg("name"), py::arg("chain"), py::arg("X_WB"), py::arg("robot"),
           py::arg("instrument"), py::arg("tool"),
           "The shaft lies where its calibration says. Raises ConfigError where the robot has no "
           "capsules.")
      .def_readonly("name", &ArmShape::name)
      .def_property_readonly(
          "capsules", tuple_of(&ArmShape::capsules),
          "In the frames behind their joints; the instrument's behind the last one.")
      .def(
          "placed",
          [](const ArmShape& shape, const Array& q) {
            return from_matrix(placed(shape, to_joints(q, shape.chain.dof(), "q")));
          },
          py::arg("q"), "(n, 7): both ends in the world and radius [m] at joints q [rad].");
}

OtherArms to_others(const std::vector<OtherArm>& list) {
  if (list.size() > kMaxOtherArms) {
    throw py::value_error("others: at most " + std::to_string(kMaxOtherArms));
  }
  OtherArms others;
  std::copy(list.begin(), list.end(), others.begin());
  return others;
}

}  // namespace

void bind_capsules(py::module_& m) {
  py::class_<LinkCapsule>(m, "LinkCapsule", "All points within 'radius' of a segment of a link.")
      .def_readonly("name", &LinkCapsule::name)
      .def_readonly("joint", &LinkCapsule::joint,
                    "Index of the joint behind which it moves; -1: stands with the base. Those of "
                    "an\ninstrument are in its mount's frame.")
      .def_property_readonly(
          "a", [](const LinkCapsule& c) { return point(c.shape.a); }, "One end (3,) [m].")
      .def_property_readonly(
          "b", [](const LinkCapsule& c) { return point(c.shape.b); }, "The other end (3,) [m].")
      .def_property_readonly(
          "radius", [](const LinkCapsule& c) { return c.shape.radius; }, "[m]")
      .def_readonly("shaft", &LinkCapsule::shaft,
                    "The instrument's shaft, which enters the patient.");
  py::class_<Obstacle>(m, "Obstacle", "A fixed body in the world: a capsule or a half-space.")
      .def_readonly("name", &Obstacle::name)
      .def_readonly("half_space", &Obstacle::half_space)
      .def_property_readonly(
          "a", [](const Obstacle& o) { return point(o.half_space ? o.space.point : o.capsule.a); },
          "One end of the capsule, or a point of the half-space's surface (3,) [m].")
      .def_property_readonly(
          "b", [](const Obstacle& o) { return point(o.half_space ? o.space.normal : o.capsule.b); },
          "The other end [m], or the unit normal out of the half-space (3,).")
      .def_property_readonly(
          "radius", [](const Obstacle& o) { return o.capsule.radius; }, "[m] 0: half-space.");
  py::class_<CellClearance>(m, "CellClearance", "The distances that the arms of a cell keep.")
      .def_readonly("distance", &CellClearance::distance, "[m]")
      .def_readonly("shafts", &CellClearance::shafts, "[m] between two shafts; 0: they may touch.")
      .def_property_readonly("obstacles", tuple_of(&CellClearance::obstacles))
      .def_readonly("line", &CellClearance::line, "Of the section in cell.yaml; 0: defaults.");
}

void bind_clearance(py::module_& m) {
  bind_arm_shape(m);
  py::class_<OtherArm>(m, "OtherArm", "The latest joint state of another arm.")
      .def(py::init([](const Array& q, const Array& qd, double age) {
             const int n = static_cast<int>(q.size());
             if (n < 1 || n > kMaxJoints) throw py::value_error("q: 1 to 8 joints");
             return OtherArm{true, age, to_joints(q, n, "q"), to_joints(qd, n, "qd")};
           }),
           py::arg("q"), py::arg("qd"), py::arg("age") = 0.0,
           "Measured q, qd (n,) [rad, rad/s]; age [s] since they were received.");
  py::class_<ClearanceSetup>(m, "ClearanceSetup", "What one arm keeps its distance to.")
      .def(
          py::init([](double distance, double shafts, const ArmShape& own,
                      const std::vector<ArmShape>& others, const std::vector<Obstacle>& obstacles) {
            return ClearanceSetup{distance, shafts, own, others, obstacles};
          }),
          py::arg("distance"), py::arg("shafts"), py::arg("own"), py::arg("others"),
          py::arg("obstacles"), "distance, shafts [m] as in CellClearance.")
      .def_readonly("distance", &ClearanceSetup::distance)
      .def_readonly("shafts", &ClearanceSetup::shafts)
      .def_readonly("own", &ClearanceSetup::own)
      .def_property_readonly("others", tuple_of(&ClearanceSetup::others))
      .def_property_readonly("obstacles", tuple_of(&ClearanceSetup::obstacles))
      .def(
          "closest",
          [](const ClearanceSetup& setup, const Array& q, const std::vector<OtherArm>& others) {
            ClearanceGuard guard(setup, 0, 0.002);
            guard.sense(to_others(others));
            const Clearance found = guard.closest(to_joints(q, setup.own.chain.dof(), "q"));
            return py::make_tuple(found.distance, found.own, found.other);
          },
          py::arg("q"), py::arg("others") = std::vector<OtherArm>(),
          "Smallest distance [m] at joints q [rad], the own capsule and the body next to it. Two\n"
          "shafts do not count.");
}

}  // namespace surg::python
