#include "felt_force.hpp"

namespace surg_teleop {
namespace {

constexpr double kNever = 1e9;  // age of a force that may not be felt [s]

}  // namespace

void FeltForce::take(const Eigen::Vector3d& f_V, bool allowed, double now) {
  const std::lock_guard<std::mutex> lock(mutex_);
  f_V_ = f_V;
  allowed_ = allowed;
  received_ = now;
}

Eigen::Vector3d FeltForce::step(const Eigen::Vector3d& p_MH, double now) {
  const double dt = now - before_;  // of the first step: not a number, which gives no force
  before_ = now;
  const std::lock_guard<std::mutex> lock(mutex_);
  const double age = allowed_ ? now - received_ : kNever;
  return R_VM_.transpose() * feedback_.step(f_V_, age, R_VM_ * p_MH, allowed_, dt);
}

}  // namespace surg_teleop
