#include "handle.hpp"

#include <Eigen/LU>
#include <cmath>

namespace surg_teleop {
namespace {

// Largest entry of R R^T - 1 that the library's rounding may leave.
constexpr double kRotationTolerance = 1e-3;

bool is_rotation(const Eigen::Matrix3d& R) {
  const Eigen::Matrix3d defect = R * R.transpose() - Eigen::Matrix3d::Identity();
  // Written so that NaN fails.
  return defect.cwiseAbs().maxCoeff() <= kRotationTolerance && R.allFinite() &&
         R.determinant() > 0.0;
}

}  // namespace

Handle::~Handle() {
  if (!open_) return;
  if (!lost_) {
    sdk_.set_force(0, 0, 0, 0, 0, 0, 0, id_);
    sdk_.enable_force(0, id_);
  }
  sdk_.stop(false, id_);
  sdk_.close(id_);
}

std::string Handle::open(int number) {
  const int id = number < 0 ? sdk_.open() : sdk_.open_id(static_cast<DeviceId>(number));
  if (id < 0) {
    return "no device: " + library_error() +
           "; plug it in and switch it on, end other programs that hold it, and allow its USB node "
           "(the vendor's udev rule)";
  }
  id_ = static_cast<DeviceId>(id);
  open_ = true;
  if (!sdk_.has_wrist(id_)) {
    return name() + " has no wrist: it gives positions only; a device that turns is needed";
  }
  has_gripper_ = sdk_.has_gripper(id_);
  // The angle of a left hand's gripper grows to the other side.
  gripper_sign_ = sdk_.is_left_handed(id_) ? -1.0 : 1.0;
  return "";
}

std::string Handle::initialize() {
  // Stop the regulation of auto-init, which would go on holding the handle.
  if (sdk_.auto_init(id_) < 0 || sdk_.stop(true, id_) < 0) {
    return name() + " did not find its reference: " + library_error() +
           "; hands off, nothing in its way";
  }
  return "";
}

std::string Handle::start(double max_force) {
  if (sdk_.set_gravity_compensation(1, id_) < 0 || sdk_.set_max_force(max_force, id_) < 0 ||
      sdk_.enable_force(1, id_) < 0) {
    return name() + " does not take its forces: " + library_error();
  }
  return "";
}

ReadResult Handle::command(const Eigen::Vector3d& f_M, ReadResult result) {
  if (lost_) return ReadResult::kLost;
  if (sdk_.set_force(f_M.x(), f_M.y(), f_M.z(), 0, 0, 0, 0, id_) < 0) {
    return lose("no force can be commanded");
  }
  return result;
}

ReadResult Handle::read(Reading* reading) {
  if (lost_) return ReadResult::kLost;
  double R[3][3];
  Reading now;
  const int pose = sdk_.get_pose(&now.p_MH.x(), &now.p_MH.y(), &now.p_MH.z(), R, id_);
  if (pose < 0) return lose("no pose");
  now.R_MH = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(&R[0][0]);
  if (has_gripper_) {
    if (sdk_.get_gripper_angle(&now.gripper, id_) < 0) return lose("no gripper angle");
    now.gripper *= gripper_sign_;
  }
  now.buttons = sdk_.get_buttons(id_);
  if (pose == kTimeGuard) return ReadResult::kOld;
  if (!now.p_MH.allFinite() || !std::isfinite(now.gripper) || !is_rotation(now.R_MH)) {
    lost_ = true;
    error_ =
        name() + ": its pose is not a number or not a rotation; switch it off and on, start again";
    return ReadResult::kLost;
  }
  *reading = now;
  return ReadResult::kNew;
}

std::string Handle::name() const {
  const char* name = open_ ? sdk_.system_name(id_) : nullptr;
  return name != nullptr ? name : "the device";
}

ReadResult Handle::lose(const std::string& what) {
  lost_ = true;
  error_ = name() + ": " + what + " (" + library_error() +
           "); plug it in, start this node again, then engage anew";
  return ReadResult::kLost;
}

std::string Handle::library_error() const {
  const char* text = sdk_.last_error();
  return text != nullptr ? text : "the library gave no reason";
}

}  // namespace surg_teleop
