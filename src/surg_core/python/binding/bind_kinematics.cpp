#include <pybind11/stl.h>

#include "convert.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/kinematics/ur_kinematics.hpp"

namespace surg::python {
namespace {

py::ssize_t check_rows(const Array& array, py::ssize_t cols, const char* name) {
  if (array.ndim() != 2 || array.shape(1) != cols) {
    throw py::value_error(std::string(name) + ": shape (m, " + std::to_string(cols) +
                          ") is needed, not " + shape_of(array));
  }
  return array.shape(0);
}

Array forward_batch(const Chain& chain, const Array& q) {
  const py::ssize_t n = check_rows(q, chain.dof(), "q");
  Array poses({n, py::ssize_t{4}, py::ssize_t{4}});
  const double* from = q.data();
  double* to = poses.mutable_data();
  {
    py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < n; ++i) {
      const JointVector row =
          Eigen::Map<const Eigen::VectorXd>(from + i * chain.dof(), chain.dof());
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(to + 16 * i) =
          chain.forward(row).matrix();
    }
  }
  return frozen(poses);
}

Array jacobian_batch(const Chain& chain, const Array& q) {
  const py::ssize_t n = check_rows(q, chain.dof(), "q"), dof = chain.dof();
  Array jacobians({n, py::ssize_t{6}, dof});
  const double* from = q.data();
  double* to = jacobians.mutable_data();
  {
    py::gil_scoped_release release;
    Pose X_BF;
    Jacobian J;
    for (py::ssize_t i = 0; i < n; ++i) {
      const JointVector row = Eigen::Map<const Eigen::VectorXd>(from + i * dof, dof);
      chain.forward(row, X_BF, J);
      for (int k = 0; k < 6; ++k) {
        for (py::ssize_t joint = 0; joint < dof; ++joint) *to++ = J(k, joint);
      }
    }
  }
  return frozen(jacobians);
}

}  // namespace

void bind_kinematics(py::module_& m) {
  py::class_<Joint>(m, "Joint",
                    "A revolute joint: its frame in the previous one at q = 0, its axis.")
      .def(py::init([](std::string name, const Array& X_PJ, const Array& axis) {
             return Joint{std::move(name), to_pose(X_PJ, "X_PJ"), to_vector3(axis, "axis")};
           }),
           py::arg("name"), py::arg("X_PJ"), py::arg("axis"),
           "name, X_PJ (4, 4), unit axis (3,) in the joint frame.")
      .def_readonly("name", &Joint::name)
      .def_property_readonly("X_PJ", array_of(&Joint::X_PJ))
      .def_property_readonly("axis", array_of(&Joint::axis));

  py::class_<Chain>(m, "Chain", "A serial chain of revolute joints with a fixed flange at its end.")
      .def(py::init([](std::vector<Joint> joints, const Array& X_LF) {
             return Chain(std::move(joints), to_pose(X_LF, "X_LF"));
           }),
           py::arg("joints"), py::arg("X_LF"),
           "joints in order from the base; X_LF (4, 4): flange in the last joint's frame.\n\n"
           "Raises ValueError for no joint, too many, a non-unit axis or a broken pose.")
      .def_property_readonly("dof", &Chain::dof)
      .def_property_readonly("joints", [](const Chain& chain) { return chain.joints(); })
      .def_property_readonly("X_LF", [](const Chain& c) { return frozen(from_pose(c.X_LF())); })
      .def(
          "forward",
          [](const Chain& chain, const Array& q) {
            return from_pose(chain.forward(to_joints(q, chain.dof(), "q")));
          },
          py::arg("q"), "X_BF (4, 4): the flange in the base at joint positions q (n,) [rad].")
      .def(
          "jacobian",
          [](const Chain& chain, const Array& q) {
            Pose X_BF;
            Jacobian J;
            chain.forward(to_joints(q, chain.dof(), "q"), X_BF, J);
            return from_matrix(J);
          },
          py::arg("q"),
          "Geometric Jacobian (6, n) of the flange origin in the base: rows v, then omega.")
      .def("forward_batch", &forward_batch, py::arg("q"),
           "X_BF (m, 4, 4), read-only, at m joint positions q (m, n) [rad]. Releases the GIL.")
      .def(
          "jacobian_batch", &jacobian_batch, py::arg("q"),
          "Jacobians (m, 6, n), read-only, at m joint positions q (m, n) [rad]. Releases the GIL.");
  py::class_<UrKinematics>(m, "UrKinematics", "A UR arm's own Denavit-Hartenberg parameters.")
      .def_readonly("file", &UrKinematics::file)
      .def_readonly("model", &UrKinematics::model)
      .def_readonly("serial", &UrKinematics::serial)
      .def_readonly("date", &UrKinematics::date);
  m.def("with_kinematics", &with_kinematics, py::arg("drawn"), py::arg("own"),
        "The chain with the arm's own axes and flange. Raises ValueError for another model's.");
}

}  // namespace surg::python
