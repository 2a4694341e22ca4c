#include "surg_core/state/lag_meter.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <limits>

namespace surg {
namespace {

// Drift of q against c is no lag, nor is a command that was lost or repeated.
constexpr double kHighPass = 0.1;    // [s] time constant
constexpr double kLagMemory = 10.0;  // [s] of motion that the sums remember
// 0.1 rad/s of one joint for 0.5 s: the error of a position resolution of 1e-5 rad is then below
// 0.1 ms.
constexpr double kEnough = 0.005;   // [rad^2/s] sum of v^2 dt that an estimate needs
constexpr double kStated = 0.0001;  // [rad^2/s] so much the stated lags count for
constexpr double kLongest = 0.1;    // [s] of a servo
// What the estimate does not explain counts for less, and nothing is forgotten for it: a link that
// is late for a moment, a hand that pushes (weights of Cauchy's distribution).
constexpr double kLikelyError = 1e-4;  // [rad] of a joint; larger ones count for less
constexpr double kFirst = 0.05;  // [rad^2/s] sum of v^2 dt before which all motion counts alike
// Motion that leaves less than 1e-5 rad for a second does not tell 2 ms of dead time from a servo.
constexpr double kDeadTimePrior = 2.5e-5;  // [rad^2/s] per square of the dead time

}  // namespace

LagMeter::LagMeter(const JointVector& stated) : stated_(stated) {
  const Eigen::Index n = stated.size();
  commanded_ = q_last_ = c_ = q_ = square_ = JointVector::Zero(n);
  for (Command& command : history_) command = {0, c_};
  lead_.setZero();
  cross_.setZero();
  differ_.setZero();
  servo_.setZero();
  servo_.topRows(n).colwise() = stated.array();
  cost_.fill(0);
  left_.setZero();
  apart_.setZero(n, n);
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
  if (q.size() != stated_.size() || q.size() == 0) return;
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
  square_ *= remember;
  add(0.5 * (lead + lead_), v, waited_);  // in the middle of the cycle, as v
  lead_ = lead;
  waited_ = 0;
  estimate();
}

void LagMeter::add(const Sums& lead, const JointVector& v, double dt) {
  const Eigen::Index n = v.size();
  const JointVector squared = v.cwiseAbs2();
  const double all = squared.sum();
  if (!(all > 0)) return;
  square_ += dt * squared;
  const bool first = !(apart_.trace() > kFirst);
  const double weight = dt * (first ? 1.0 : likelihood(lead, v));
  const double remember = std::exp(-weight / kLagMemory);
  differ_ *= remember;
  left_ *= remember;
  apart_ *= remember;
  apart_.diagonal() += weight * squared;
  apart_ -= weight / all * squared * squared.transpose();
  for (int k = 0; k < kGrid; ++k) {
    const JointVector c = lead.col(k).head(n).matrix();
    const JointVector differs = c - v.dot(c) / all * v;
    cross_.col(k).head(n) += dt * v.array() * c.array();
    differ_.col(k).head(n) += weight * v.array() * differs.array();
    left_.col(k).head(n) += weight * differs.array().square();
  }
}

/// How likely the estimate makes this motion, in (0, 1].
double LagMeter::likelihood(const Sums& lead, const JointVector& v) const {
  double squares = 0, along = 0;
  for (Eigen::Index i = 0; i < v.size(); ++i) {
    const double error = at_dead_time(lead, i) - link_.servo[i] * v[i];
    squares += error * error;
    along += error * v[i];
  }
  const double apart = squares - along * along / v.squaredNorm();  // without what all are late
  return 1 / (1 + std::max(apart, 0.0) / (kLikelyError * kLikelyError));
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

/// One dead time of the grid per call; the best of them all is taken up after the last.
void LagMeter::estimate() {
  const Eigen::Index n = stated_.size();
  const double dead_time = kStep * turn_;
  const JointVector apart = stated_.array() - stated_.mean();  // as stated
  SquareMatrix known = apart_;
  known.diagonal().array() += kStated;
  const JointVector b = differ_.col(turn_).head(n).matrix();
  const JointVector d = known.llt().solve(b + kStated * apart);
  const double all = (cross_.col(turn_).head(n).sum() - square_.dot(d) +
                      n * kStated * (stated_.mean() - dead_time)) /
                     (square_.sum() + n * kStated);
  // A dead time longer than a joint's whole lag is none.
  const bool possible = turn_ == 0 || !((d.array() + all).minCoeff() < 0);
  servo_.col(turn_).head(n) = (d.array() + all).max(0.0).min(kLongest);
  cost_[turn_] = left_.col(turn_).sum() - d.dot(2 * b - apart_ * d) +
                 kStated * (d - apart).squaredNorm() + kDeadTimePrior * dead_time * dead_time;
  if (!possible) cost_[turn_] = std::numeric_limits<double>::infinity();
  turn_ = (turn_ + 1) % kGrid;
  if (turn_ == 0) take_up_best();
}

void LagMeter::take_up_best() {
  const int best = static_cast<int>(std::min_element(cost_.begin(), cost_.end()) - cost_.begin());
  double between = 0;  // steps from the best of the grid to the vertex of the parabola there
  if (best > 0 && best < kGrid - 1) {
    const double bend = cost_[best - 1] - 2 * cost_[best] + cost_[best + 1];
    if (bend > 0 && std::isfinite(bend))
      between = std::clamp(0.5 * (cost_[best - 1] - cost_[best + 1]) / bend, -0.5, 0.5);
  }
  link_.dead_time = kStep * (best + between);
  for (Eigen::Index i = 0; i < stated_.size(); ++i) link_.servo[i] = at_dead_time(servo_, i);
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
  JointVector lags = link_.dead_time + link_.servo.array();
  for (Eigen::Index i = 0; i < lags.size(); ++i) {
    if (!(square_[i] > kEnough)) lags[i] = std::numeric_limits<double>::quiet_NaN();
  }
  return lags;
}

}  // namespace surg
