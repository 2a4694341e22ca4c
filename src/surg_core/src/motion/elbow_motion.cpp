#include "surg_core/motion/elbow_motion.hpp"

#include <algorithm>

#include "kinematics/jacobian_inverse.hpp"

namespace surg {
namespace {

constexpr double kGain = 2;                 // [1/s] of the elbow's error, and of a joint's room
constexpr double kFastest = 0.3;            // [rad/s] of the elbow
constexpr double kVelocityShare = 0.045;    // of each joint's velocity limit
constexpr double kAccelerationShare = 0.1;  // of each joint's acceleration limit
constexpr double kReserve = 0.06;           // [rad] to a joint's limit; the tip's motion may use it
constexpr double kStill = 2e-3;             // [rad/s] slower than that the elbow is held
constexpr double kFullTurn = 0.3;           // [rad/rad] of the elbow; below it slower
constexpr double kSlowest = 0.05;           // share of the speed at the least turn
constexpr double kWalk = 0.03;              // [rad] of the elbow between two postures of the check

}  // namespace

struct ElbowMotion::Here {
  JointVector q;
  Pose X_BF;
  Jacobian J;
  ElbowTurn turn;
};

ElbowMotion::ElbowMotion(const Chain& chain, const JointLimits& limits, double preferred, double T)
    : chain_(chain), limits_(limits), barrier_(chain), preferred_(preferred), T_(T) {
  limits_.position_min.array() += kReserve;
  limits_.position_max.array() -= kReserve;
}

void ElbowMotion::home() {
  goal_ = preferred_;
  rate_ = 0;
  commanded_ = stopping_ = busy_ = false;
  limited_by_ = kNobody;
}

void ElbowMotion::hold() {
  if (!has_goal()) return;
  commanded_ = stopping_ = true;
  busy_ = false;
}

ElbowMotion::Here ElbowMotion::at(const JointVector& q) const {
  Here here;
  here.q = q;
  chain_.forward(q, here.X_BF, here.J);
  here.turn = elbow_turn(chain_, q, here.J);
  return here;
}

/// Walks to the goal with the flange at rest, the shorter way round.
Reason ElbowMotion::go_to(double angle, const JointVector& q, int& by) {
  by = chain_.dof();
  if (!(std::abs(angle) <= M_PI)) return Reason::kElbowOutOfReach;
  Here here = at(q);
  const Pose X_BFGoal = here.X_BF;
  const double way = here.turn.regular ? wrapped(angle - here.turn.angle) : 0.0;
  for (int i = 0; i * kWalk < 2 * M_PI && here.turn.regular; ++i) {
    const double left = i == 0 ? way : wrapped(angle - here.turn.angle);
    const bool there = std::abs(left) < 0.5 * kTolerance || left * way < 0;
    const Range allowed = range(here, 1.0);
    // At the goal as well: a joint may enter its reserve in the last step of the walk.
    if ((way > 0 ? allowed.high : -allowed.low) < kStill && !(there && i == 0)) {
      by = way > 0 ? allowed.high_by : allowed.low_by;
      return Reason::kElbowOutOfReach;
    }
    if (there) {
      goal_ = angle;
      commanded_ = busy_ = true;
      stopping_ = false;
      return Reason::kNone;
    }
    const JointVector next = here.q + std::clamp(left, -kWalk, kWalk) * here.turn.per_angle;
    const auto [X_BF, J] = chain_.flange(next);
    const Inverse inverse(J);
    here = at(next + inverse(displacement(X_BF, X_BFGoal)).head(next.size()));
  }
  by = chain_.dof();
  return Reason::kElbowOutOfReach;
}

/// Rates within which every joint keeps away from its limit, and the arm from singularities. A
/// joint inside the reserve turns the elbow back.
ElbowMotion::Range ElbowMotion::range(const Here& here, double fastest) const {
  Range range{-fastest, fastest, kNobody, kNobody};
  limit_joints(here, range);
  limit_approach(here, range);
  range.high = std::max(range.high, -fastest);
  range.low = std::min(range.low, fastest);
  if (range.low > range.high) range.low = range.high = 0;
  return range;
}

void ElbowMotion::limit_joints(const Here& here, Range& range) const {
  for (int i = 0; i < here.q.size(); ++i) {
    const double share = std::abs(here.turn.per_angle[i]);
    if (share < 1e-6) continue;
    double up = kGain * (limits_.position_max[i] - here.q[i]) / share;
    double down = kGain * (here.q[i] - limits_.position_min[i]) / share;
    if (here.turn.per_angle[i] < 0) std::swap(up, down);
    range.limit_up(up, i);
    range.limit_down(down, i);
  }
}

void ElbowMotion::limit_approach(const Here& here, Range& range) const {
  const double h = 1e-4 / here.turn.per_angle.cwiseAbs().maxCoeff();
  const auto [X_BF, J] = chain_.flange(JointVector(here.q + h * here.turn.per_angle));
  const SingularityMeasures now = barrier_.measures(here.X_BF, here.J);
  const SingularityMeasures soon = barrier_.measures(X_BF, J);
  for (int i = 0; i < now.n; ++i) {
    const double slope = (std::abs(soon.phi[i]) - std::abs(now.phi[i])) / h;
    if (std::abs(slope) < 1e-9) continue;
    const double allowed = barrier_.fastest_approach(now.phi[i]) / std::abs(slope);
    if (slope < 0) range.limit_up(allowed, chain_.dof());
    if (slope > 0) range.limit_down(allowed, chain_.dof());
  }
}

double ElbowMotion::wanted_rate(const Here& here, double fastest, double acceleration) {
  const double left = wrapped(goal_ - here.turn.angle), far = std::abs(left);
  const double rate = std::min({kGain * far, std::sqrt(acceleration * far), fastest});
  const Range allowed = range(here, fastest);
  const double towards = left > 0 ? allowed.high : -allowed.low;
  const bool held = far > kTolerance && towards < kStill;
  limited_by_ = !held ? kNobody : left > 0 ? allowed.high_by : allowed.low_by;
  if (far <= kTolerance || held) busy_ = false;
  return std::clamp(std::copysign(rate, left), allowed.low, allowed.high);
}

JointVector ElbowMotion::advance(const JointVector& q, bool may_turn) {
  const JointVector none = JointVector::Zero(q.size());
  if (!has_goal()) return none;
  const Here here = at(q);
  if (!here.turn.regular) {
    rate_ = 0;
    limited_by_ = chain_.dof();
    busy_ = false;
    return none;
  }
  double fastest = kFastest, acceleration = INFINITY;
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    const double share = std::max(std::abs(here.turn.per_angle[i]), 1e-9);
    fastest = std::min(fastest, kVelocityShare * limits_.velocity[i] / share);
    acceleration = std::min(acceleration, kAccelerationShare * limits_.acceleration[i] / share);
  }
  // Gently to where the null space turns the elbow no more.
  const double turns = 1 / here.turn.per_angle.norm();
  fastest *=
      std::clamp((turns - ElbowTurn::kLeast) / (kFullTurn - ElbowTurn::kLeast), kSlowest, 1.0);
  double wanted = 0;
  if (may_turn && !stopping_) wanted = wanted_rate(here, fastest, acceleration);
  rate_ += std::clamp(wanted - rate_, -acceleration * T_, acceleration * T_);
  if (stopping_ && rate_ == 0) {
    goal_ = here.turn.angle;
    stopping_ = false;
  }
  return rate_ * here.turn.per_angle;
}

}  // namespace surg
