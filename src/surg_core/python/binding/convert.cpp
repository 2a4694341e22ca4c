#include "convert.hpp"

#include <algorithm>

namespace surg::python {
namespace {

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

Vector3 to_vector3(const Array& array, const char* name) { return to_vector<3>(array, name); }
Vector4 to_vector4(const Array& array, const char* name) { return to_vector<4>(array, name); }
Vector6 to_vector6(const Array& array, const char* name) { return to_vector<6>(array, name); }

Matrix3 to_matrix3(const Array& array, const char* name) {
  check_shape(array, {3, 3}, name);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(array.data());
}

JointVector to_joints(const Array& array, int size, const char* name) {
  check_shape(array, {size}, name);
  JointVector values(size);
  std::copy_n(array.data(), size, values.data());
  return values;
}

Jacobian to_jacobian(const Array& array, const char* name) {
  if (array.ndim() != 2 || array.shape(0) != 6 || array.shape(1) < 1 ||
      array.shape(1) > kMaxJoints) {
    throw py::value_error(std::string(name) + ": shape (6, n) with n up to " +
                          std::to_string(kMaxJoints) + " is needed, not " + shape_of(array));
  }
  Jacobian J(6, array.shape(1));
  for (int i = 0; i < 6; ++i) {
    for (Eigen::Index k = 0; k < J.cols(); ++k) J(i, k) = array.at(i, k);
  }
  return J;
}

Pose to_pose(const Array& array, const char* name) {
  check_shape(array, {4, 4}, name);
  const Eigen::Matrix4d M =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.data());
  const Matrix3 R = M.topLeftCorner<3, 3>();
  // Written so that a NaN fails as well.
  const bool rotation =
      (R * R.transpose() - Matrix3::Identity()).cwiseAbs().maxCoeff() < 1e-6 && R.determinant() > 0;
  if (!M.allFinite() || !rotation || M.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) {
    throw py::value_error(std::string(name) +
                          ": not a pose; a finite (4, 4) array with a rotation matrix in its upper "
                          "left 3 x 3 and 0 0 0 1 as its last row is needed");
  }
  Pose X = Pose::Identity();
  X.matrix() = M;
  return X;
}

Array from_pose(const Pose& X) { return from_matrix(X.matrix()); }

Array frozen(Array array) {
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

}  // namespace surg::python
