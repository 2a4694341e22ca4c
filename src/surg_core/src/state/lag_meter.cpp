#include "surg_core/state/lag_meter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace surg {
namespace {

constexpr double kHighPass = 1.0;    // [s] time constant; slow drift of q against c is no lag
constexpr double kLagMemory = 10.0;  // [s] of motion that the sums remember
// 0.1 rad/s of one joint for 0.5 s: the error of a position resolution of 1e-5 rad is then below
// 0.1 ms.
constexpr double kEnough = 0.005;  // [rad^2/s] sum of v^2 dt that an estimate needs

}  // namespace

void LagMeter::restart(int joints) {
  q_last_ = lead_ = moved_ = JointVector::Zero(joints);
  if (square_.size() != joints) cross_ = square_ = JointVector::Zero(joints);
}

void LagMeter::step(const JointVector& qd_command, const JointVector& q, double age, double dt) {
  const bool fresh = running_ && q_last_.size() == q.size();
  if (!fresh) {
    restart(static_cast<int>(q.size()));
    q_last_ = q;
    running_ = true;
    return;
  }
  const double keep = std::exp(-dt / kHighPass), remember = std::exp(-dt / kLagMemory);
  cross_ *= remember;
  square_ *= remember;
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    const double dq = q[i] - q_last_[i];
    const double lead = keep * (lead_[i] + dt * qd_command[i] - dq);
    const double moved = keep * (moved_[i] + dq);
    // Half-way between command and motion, in the middle of the cycle: no bias from curvature.
    const double v = (moved - moved_[i] + 0.5 * (lead - lead_[i])) / dt;
    cross_[i] += (0.5 * (lead + lead_[i]) - age * v) * v * dt;
    square_[i] += v * v * dt;
    lead_[i] = lead;
    moved_[i] = moved;
  }
  q_last_ = q;
}

double LagMeter::lag_of(double cross, double square) {
  if (!(square > kEnough)) return std::numeric_limits<double>::quiet_NaN();
  return std::max(cross / square, 0.0);
}

JointVector LagMeter::joint_lag() const {
  JointVector lags(square_.size());
  for (Eigen::Index i = 0; i < lags.size(); ++i) lags[i] = lag_of(cross_[i], square_[i]);
  return lags;
}

}  // namespace surg
