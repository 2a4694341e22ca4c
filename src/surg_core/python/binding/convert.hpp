// numpy <-> Eigen for the binding. Every shape is checked here: Eigen itself would not, in a
// Release build.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <initializer_list>
#include <string>
#include <type_traits>
#include <vector>

#include "surg_core/types.hpp"

namespace surg::python {

namespace py = pybind11;

/// float64, C order; made from whatever numpy understands.
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

std::string shape_of(const Array& array);
/// Throws ValueError naming the argument unless the array has this shape.
void check_shape(const Array& array, std::initializer_list<py::ssize_t> shape, const char* name);

Eigen::Vector2d to_vector2(const Array& array, const char* name);
Vector3 to_vector3(const Array& array, const char* name);
/// (3,), or (2,) of a drive without a roll.
Vector3 to_drive(const Array& array, const char* name);
Vector4 to_vector4(const Array& array, const char* name);
/// Of x, y, z, w. Raises ValueError for a norm other than 1, as the controller node refuses it.
Eigen::Quaterniond to_unit_quaternion(const Array& array, const char* name);
/// (n,) with n == size.
JointVector to_joints(const Array& array, int size, const char* name);
/// (4, 4) homogeneous, with a rotation in it and 0 0 0 1 below.
Pose to_pose(const Array& array, const char* name);
/// (n, 4, 4), or (n, 7): x, y, z and a quaternion x, y, z, w as on the wire.
std::vector<Pose> to_poses(const Array& array, const char* name);

Array from_pose(const Pose& X);

/// A new array of the matrix's own shape: (n,) for a vector, (rows, cols) otherwise.
template <typename Derived>
Array from_matrix(const Eigen::MatrixBase<Derived>& matrix) {
  if constexpr (Derived::ColsAtCompileTime == 1) {
    Array array(matrix.rows());
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) array.mutable_at(i) = matrix(i);
    return array;
  } else {
    Array array({matrix.rows(), matrix.cols()});
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      for (Eigen::Index k = 0; k < matrix.cols(); ++k) array.mutable_at(i, k) = matrix(i, k);
    }
    return array;
  }
}

/// The array, no longer writeable: for the attributes of frozen objects.
Array frozen(Array array);

/// Getter of a vector, matrix or pose: a read-only copy.
template <typename T, typename M>
auto array_of(M T::*member) {
  return [member](const T& self) {
    if constexpr (std::is_same_v<M, Pose>)
      return frozen(from_pose(self.*member));
    else
      return frozen(from_matrix(self.*member));
  };
}

/// Getter of a sequence, as a tuple; its file includes pybind11/stl.h.
template <typename T, typename M>
auto tuple_of(M T::*member) {
  return [member](const T& self) { return py::tuple(py::cast(self.*member)); };
}

/// One row per observation, (n, cols): filled without the GIL, read-only when taken.
class Rows {
 public:
  Rows(py::ssize_t n, py::ssize_t cols) : array_({n, cols}), data_(array_.mutable_data()) {}
  template <typename Derived>
  void set(py::ssize_t i, const Eigen::MatrixBase<Derived>& row) {
    for (Eigen::Index k = 0; k < row.size(); ++k) data_[i * row.size() + k] = row(k);
  }
  Array take() { return frozen(std::move(array_)); }

 private:
  Array array_;
  double* data_;
};

// One per file of the binding; 'm' is surg_core._core.
void bind_kinematics(py::module_& m);
void bind_rcm(py::module_& m);
void bind_config(py::module_& m);
void bind_operating_state(py::module_& m);
void bind_capsules(py::module_& m);
void bind_clearance(py::module_& m);
void bind_controller(py::module_& m);
void bind_calibration(py::module_& m);
void bind_motion(py::module_& m);
void bind_fixtures(py::module_& m);
void bind_wrist(py::module_& m);
void bind_files(py::module_& m);

}  // namespace surg::python
