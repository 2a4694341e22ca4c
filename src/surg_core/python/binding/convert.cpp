#include "convert.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/kinematics/kinematics.hpp"

namespace surg::python {
namespace {

constexpr double kUnitTolerance = 1e-3;  // of a quaternion's norm

template <int n>
Eigen::Matrix<double, n, 1> to_vector(const Array& array, const char* name) {
  check_shape(array, {n}, name);
  return Eigen::Map<const Eigen::Matrix<double, n, 1>>(array.data());
}

std::string text_of(const py::ssize_t* begin, std::size_t n) {
  std::string text = "(";
  for (std::size_t i = 0; i < n; ++i) {
    text += std::to_string(begin[i]) + (n == 1 ? "," : i + 1 < n ? ", " : "");
  }
  return text + ")";
}

}  // namespace

std::string shape_of(const Array& array) { return text_of(array.shape(), array.ndim()); }

void check_shape(const Array& array, std::initializer_list<py::ssize_t> shape, const char* name) {
  const bool same = array.ndim() == static_cast<py::ssize_t>(shape.size()) &&
                    std::equal(shape.begin(), shape.end(), array.shape());
  if (!same) {
    throw py::value_error(std::string(name) + ": shape " + text_of(shape.begin(), shape.size()) +
                          " is needed, not " + shape_of(array));
  }
}

Eigen::Vector2d to_vector2(const Array& array, const char* name) {
  return to_vector<2>(array, name);
}
Vector3 to_vector3(const Array& array, const char* name) { return to_vector<3>(array, name); }
Vector3 to_drive(const Array& array, const char* name) {
  if (array.size() == 3) return to_vector3(array, name);
  return (Vector3() << to_vector2(array, name), 0).finished();
}
Vector4 to_vector4(const Array& array, const char* name) { return to_vector<4>(array, name); }

Eigen::Quaterniond to_unit_quaternion(const Array& array, const char* name) {
  const Eigen::Quaterniond q(to_vector4(array, name));
  // What is not finite passes: the controller answers it with a FAULT.
  if (!q.coeffs().allFinite()) return q;
  if (!(std::abs(q.norm() - 1) <= kUnitTolerance)) {
    throw py::value_error(std::string(name) + ": has norm " + std::to_string(q.norm()) +
                          "; a unit quaternion x, y, z, w is needed, (0, 0, 0, 1) for no rotation");
  }
  return q;
}

JointVector to_joints(const Array& array, int size, const char* name) {
  check_shape(array, {size}, name);
  JointVector values(size);
  std::copy_n(array.data(), size, values.data());
  return values;
}

namespace {

Pose checked_pose(const Eigen::Matrix4d& M, const std::string& name) {
  const bool rotation = is_rotation(M.topLeftCorner<3, 3>());
  if (!M.allFinite() || !rotation || M.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) {
    throw py::value_error(name +
                          ": not a pose; a finite (4, 4) array with a rotation matrix in its upper "
                          "left 3 x 3 and 0 0 0 1 as its last row is needed");
  }
  Pose X = Pose::Identity();
  X.matrix() = M;
  return X;
}

Pose pose_of_seven(const double* v, const std::string& name) {
  const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  const Vector3 p(v[0], v[1], v[2]);
  if (!p.allFinite() || !(std::abs(q.norm() - 1.0) <= kUnitTolerance)) {
    throw py::value_error(name + ": a finite position and a unit quaternion x, y, z, w are needed");
  }
  Pose X = Pose::Identity();
  X.linear() = q.normalized().toRotationMatrix();
  X.translation() = p;
  return X;
}

}  // namespace

Pose to_pose(const Array& array, const char* name) {
  check_shape(array, {4, 4}, name);
  return checked_pose(Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.data()),
                      name);
}

std::vector<Pose> to_poses(const Array& array, const char* name) {
  const bool matrices = array.ndim() == 3 && array.shape(1) == 4 && array.shape(2) == 4;
  const bool sevens = array.ndim() == 2 && array.shape(1) == 7;
  if (!matrices && !sevens) {
    throw py::value_error(std::string(name) + ": shape (n, 4, 4) or (n, 7) is needed, not " +
                          shape_of(array));
  }
  std::vector<Pose> poses(array.shape(0));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const std::string one = std::string(name) + "[" + std::to_string(i) + "]";
    if (sevens) {
      poses[i] = pose_of_seven(array.data() + 7 * i, one);
    } else {
      const double* begin = array.data() + 16 * i;
      poses[i] =
          checked_pose(Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(begin), one);
    }
  }
  return poses;
}

Array from_pose(const Pose& X) { return from_matrix(X.matrix()); }

Array frozen(Array array) {
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

}  // namespace surg::python
