#include "surg_core/state/lag_meter.hpp"

#include <algorithm>
#include <limits>

namespace surg {
namespace {

constexpr double kHighPass = 1.0;    // [s] time constant; slow drift of q against c is no lag
constexpr double kLagMemory = 10.0;  // [s] of motion that the sums remember
// 0.1 rad/s of one joint for 0.5 s: the error of a position resolution of 1e-5 rad is then below
// 0.1 ms.
constexpr double kEnough = 0.005;   // [rad^2/s] sum of v^2 dt that an estimate needs
constexpr double kStated = 0.0005;  // [rad^2/s] so much the stated lags count for
// Motion that leaves less than 1e-5 rad for a second does not tell 2 ms of dead time from a servo.
constexpr double kDeadTimePrior = 2.5e-5;  // [rad^2/s] per square of the dead time

}  // namespace

LagMeter::LagMeter(const JointVector& stated) : stated_(stated) {
  const Eigen::Index n = stated.size();
  commanded_ = q_last_ = c_ = q_ = square_ = JointVector::Zero(n);
  for (Command& command : history_) command = {0, c_};
  lead_.setZero();
  cross_.setZero();
  left_.setZero();
  link_.servo = stated;
}

void LagMeter::restart(const JointVector& q) {
  q_last_ = q;
  commanded_.setZero();
  c_.setZero();
  q_.setZero();
  lead_.setZero();
  t_ = waited_ = 0;
  known_ = newest_ = 0;
  history_[0] = {0, c_};
  running_ = true;
}

void LagMeter::step(const JointVector& qd_command, const JointVector& q, double age, double dt) {
  if (q.size() != stated_.size()) return;
  if (!running_) return restart(q);
  waited_ += dt;
  commanded_ += dt * qd_command;
  if (waited_ < 0.5 * kStep) return;
  const double keep = std::exp(-waited_ / kHighPass), remember = std::exp(-waited_ / kLagMemory);
  note_command(keep);
  const JointVector q_before = q_;
  q_ = keep * (q_ + q - q_last_);
  q_last_ = q;
  const JointVector v = (q_ - q_before) / waited_;
  const Sums lead = leads(age);
  cross_ *= remember;
  left_ *= remember;
  square_ *= remember;
  for (Eigen::Index i = 0; i < v.size(); ++i) {
    const auto between = 0.5 * (lead.row(i) + lead_.row(i));  // in the middle of the cycle, as v
    cross_.row(i) += waited_ * v[i] * between;
    left_.row(i) += waited_ * between.square();
    square_[i] += waited_ * v[i] * v[i];
  }
  lead_ = lead;
  waited_ = 0;
  estimate();
}

void LagMeter::note_command(double keep) {
  t_ += waited_;
  c_ = keep * (c_ + commanded_);
  commanded_.setZero();
  newest_ = (newest_ + 1) % kHistory;
  known_ = std::min(known_ + 1, kHistory - 1);
  history_[newest_] = {t_, c_};
}

/// c - q of each joint for each dead time; the commands stand between two cycles.
LagMeter::Sums LagMeter::leads(double age) const {
  Sums lead = Sums::Zero();
  int back = 0;
  for (int k = 0; k < kGrid; ++k) {
    const double t = t_ - age - kStep * k;
    while (back + 1 < known_ && history_[(newest_ + kHistory - back - 1) % kHistory].t > t) ++back;
    const Command& after = history_[(newest_ + kHistory - back) % kHistory];
    const Command& before = history_[(newest_ + kHistory - back - 1) % kHistory];
    const double share = std::clamp((after.t - t) / (after.t - before.t), 0.0, 1.0);
    lead.col(k).head(q_.size()) = (after.c + share * (before.c - after.c) - q_).array();
  }
  return lead;
}

void LagMeter::estimate() {
  const Eigen::Index n = stated_.size();
  std::array<double, kGrid> cost;
  Sums servo = Sums::Zero();
  for (int k = 0; k < kGrid; ++k) {
    const double dead_time = kStep * k;
    cost[k] = kDeadTimePrior * dead_time * dead_time;
    for (Eigen::Index i = 0; i < n; ++i) {
      const double tau = std::max(
          (cross_(i, k) + kStated * (stated_[i] - dead_time)) / (square_[i] + kStated), 0.0);
      servo(i, k) = tau;
      cost[k] += left_(i, k) - tau * (2 * cross_(i, k) - tau * square_[i]);
    }
  }
  const int best = static_cast<int>(std::min_element(cost.begin(), cost.end()) - cost.begin());
  double between = 0;  // steps from the best of the grid to the vertex of the parabola there
  if (best > 0 && best < kGrid - 1) {
    const double bend = cost[best - 1] - 2 * cost[best] + cost[best + 1];
    if (bend > 0) between = std::clamp(0.5 * (cost[best - 1] - cost[best + 1]) / bend, -0.5, 0.5);
  }
  link_.dead_time = kStep * (best + between);
  for (Eigen::Index i = 0; i < n; ++i) link_.servo[i] = at_dead_time(servo, i);
}

double LagMeter::at_dead_time(const Sums& sums, Eigen::Index joint) const {
  const double grid = link_.dead_time / kStep;
  const int k = std::min(static_cast<int>(grid), kGrid - 2);
  return sums(joint, k) + (grid - k) * (sums(joint, k + 1) - sums(joint, k));
}

double LagMeter::lag() const {
  const double square = square_.sum();
  if (!(square > kEnough)) return std::numeric_limits<double>::quiet_NaN();
  double cross = 0;
  for (Eigen::Index i = 0; i < square_.size(); ++i) cross += at_dead_time(cross_, i);
  return std::max(link_.dead_time + cross / square, 0.0);
}

JointVector LagMeter::joint_lag() const {
  JointVector lags(square_.size());
  for (Eigen::Index i = 0; i < lags.size(); ++i) {
    lags[i] = square_[i] > kEnough
                  ? std::max(link_.dead_time + at_dead_time(cross_, i) / square_[i], 0.0)
                  : std::numeric_limits<double>::quiet_NaN();
  }
  return lags;
}

}  // namespace surg
