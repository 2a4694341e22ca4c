#include "limits/look_ahead.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "limits/joint_box.hpp"

namespace surg {
namespace {

// The plan takes less than the limits, so that the step has reserves to follow it.
constexpr double kPlanVelocity = 0.995;  // of each joint's velocity limit
constexpr double kSpacingGrowth = 1.4;   // of the spacing from node to node
constexpr double kSmallestArc = 1e-5;    // [rad] a path that cannot be followed this far ends here
constexpr double kShorter = 0.4;         // of the way to a node that could not be reached

/// A x + B y <= c.
struct Row {
  double A, B, c;
};
/// Two for each joint.
using Rows = std::array<Row, 2 * kMaxJoints>;

/// x where the row meets y = Y, as 'largest_x' computes it.
double on_edge(const Row& row, double Y) {
  const double size = std::hypot(row.A, row.B);
  const double ux = row.B / size, uy = -row.A / size;
  const double fx = row.A / size * (row.c / size), fy = row.B / size * (row.c / size);
  return fx + (Y - fy) / uy * ux;
}

/// Largest x with all n rows, 0 <= x <= X, 0 <= y <= Y; the origin must be inside. Seidel's
/// incremental method: each row that the optimum so far breaks becomes the line on which the new
/// one lies.
double largest_x(const Rows& rows, int n, double X, double Y) {
  double x = X, y = Y;
  for (int i = 0; i < n; ++i) {
    const Row& row = rows[i];
    if (row.A * x + row.B * y <= row.c + 1e-12 * row.c) continue;
    const double size = std::hypot(row.A, row.B);
    if (!(size > 0)) return 0;
    // The line: foot of the origin, then along (B, -A).
    const double ux = row.B / size, uy = -row.A / size;
    const double fx = row.A / size * (row.c / size), fy = row.B / size * (row.c / size);
    double from = -INFINITY, to = INFINITY;
    const auto keep = [&](double A, double B, double c) {
      const double rate = A * ux + B * uy, rest = c - A * fx - B * fy;
      if (std::abs(rate) < 1e-15 * (std::abs(A) + std::abs(B))) return;
      if (rate > 0) {
        to = std::min(to, rest / rate);
      } else {
        from = std::max(from, rest / rate);
      }
    };
    keep(1, 0, X);
    keep(-1, 0, 0);
    keep(0, 1, Y);
    keep(0, -1, 0);
    for (int k = 0; k < i; ++k) keep(rows[k].A, rows[k].B, rows[k].c);
    if (!(from <= to)) return 0;  // rounding only: the origin is inside
    const double s = ux >= 0 ? to : from;
    x = fx + s * ux;
    y = fy + s * uy;
  }
  return std::clamp(x, 0.0, X);
}

}  // namespace

LimitedStep::LookAhead::LookAhead(const LimitedStep& self, const Law& law, const Here& here,
                                  const Affine& affine)
    : self_(self),
      n_(here.n),
      horizon_(law.horizon()),
      flange_velocity_(here.flange_velocity),
      spacing_(self.T_),
      arc_(kFirstArc) {
  node_ = {here.q, affine.tangent, affine.measures,
           flange_twist(here.J, affine.tangent).head<3>().norm()};
  const JointLimits& limits = self.limits_;
  for (Eigen::Index j = 0; j < n_; ++j) {
    const double a = limits.acceleration[j], v = limits.velocity[j];
    acceleration_[j] = a;
    velocity_[j] = v;
    position_min_[j] = limits.position_min[j];
    position_max_[j] = limits.position_max[j];
    far_[j] = (1 + 1e-9) * (a * limits.position_margin + v * (v + 2 * a * self.T_));
  }
  most_[0] = fastest();
  // [s] of the clock to a stop, if the joints stayed as fast as here.
  const double enough = most_[0] / (2 * clock_braking(affine.tangent, self.limits_.acceleration));
  for (bool more = true; more;) {
    more = advance(law, here);
    if (more) {
      more = last_ < kNodes && evaluations_ < 2 * kNodes && t_[last_] < horizon_;
      if (more && t_[last_] < enough) continue;
    } else if (by_[0] == 'p') {
      by_ = "unreachable";
    }
    if (plan()) return;
  }
}

/// One node more, at first as far as the spacing allows; false where there is none.
bool LimitedStep::LookAhead::advance(const Law& law, const Here& here) {
  const double speed = largest(node_.direction);
  double dt = std::min(spacing_, horizon_ - t_[last_]);
  if (speed * dt > arc_) dt = arc_ / speed;
  for (; evaluations_ < 2 * kNodes; dt *= kShorter) {
    if (speed * dt < kSmallestArc && dt < 1e-4) return false;
    ++evaluations_;
    const double t = t_[last_] + dt;
    Node node;
    if (!law.node(t, node_.q + dt * node_.direction, speed * dt, node)) continue;
    if (!passes(node.measures)) {
      by_ = "singularity";
      continue;
    }
    if (!inside_positions(node.q, here.q)) {
      by_ = "joint_limit";
      continue;
    }
    const double way = t - t_[last_];
    const Joints bend = (node.direction - node_.direction) / way;
    const Joints along = 0.5 * (node.direction + node_.direction) / way;
    from_[last_] = 0.5 * (bend - along);
    to_[last_] = 0.5 * (bend + along);
    node_ = node;
    t_[++last_] = t;
    most_[last_] = fastest();
    spacing_ = std::min(spacing_, 2 * dt) * kSpacingGrowth;
    arc_ *= kSpacingGrowth;
    return true;
  }
  return false;
}

/// Whether a node may follow the last one: neither through a singularity nor, on the way there,
/// closer than the barrier allows.
bool LimitedStep::LookAhead::passes(const SingularityMeasures& to) const {
  const double phi_min = self_.barrier_.phi_min();
  const SingularityMeasures& from = node_.measures;
  for (int i = 0; i < std::min(from.n, to.n); ++i) {
    const double before = std::abs(from.phi[i]), after = std::abs(to.phi[i]);
    if (to.phi[i] * from.phi[i] <= 0) return false;
    if (after < phi_min && after < before) return false;
  }
  return true;
}

/// Within the position limits, or not further beyond one than 'from'.
bool LimitedStep::LookAhead::inside_positions(const Joints& q, const Joints& from) const {
  const JointLimits& limits = self_.limits_;
  for (Eigen::Index i = 0; i < n_; ++i) {
    if (q[i] > std::max(limits.position_max[i], from[i])) return false;
    if (q[i] < std::min(limits.position_min[i], from[i])) return false;
  }
  return true;
}

/// The clock's squared speed at the last node that flange and joints allow there, in the margin
/// before a position limit as well.
double LimitedStep::LookAhead::fastest() const {
  const JointLimits& limits = self_.limits_;
  const double top = kPlanVelocity * flange_velocity_ / std::max(node_.flange, 1e-9);
  double most = std::min(1.0, top * top);
  // Far from every limit no joint needs its approach.
  const Joints left = (position_max_ - node_.q).cwiseMin(node_.q - position_min_);
  if ((acceleration_.cwiseProduct(left) - far_).minCoeff() > 0) {
    const Joints v = velocity_.array() * (kPlanVelocity / node_.direction.array().abs().max(1e-9));
    return std::min(most, v.cwiseAbs2().minCoeff());
  }
  for (Eigen::Index j = 0; j < n_; ++j) {
    const double speed = node_.direction[j];
    const double left =
        speed > 0 ? limits.position_max[j] - node_.q[j] : node_.q[j] - limits.position_min[j];
    const double v = approach_speed(limits.velocity[j], left, limits.acceleration[j],
                                    limits.position_margin, self_.T_) *
                     (kPlanVelocity / std::max(std::abs(speed), 1e-9));
    most = std::min(most, v * v);
  }
  return most;
}

/// From standstill at the last node backwards to here: q_ddot = u q'' + u' q' / 2 with u the
/// squared clock speed, in the middle of each interval, within the joints' accelerations. Where a
/// node's speed is what a shorter plan found, so is that of all before it. Returns whether a node
/// beyond this cycle may be passed as fast as it allows: what lies behind only adds room.
bool LimitedStep::LookAhead::plan() {
  const Joints most = kPlanAcceleration * acceleration_;
  square_[last_] = 0;
  const int known = std::exchange(planned_, last_);
  bool settled = false;
  for (int i = last_ - 1; i >= 0; --i) {
    const double before = std::exchange(square_[i], fastest_before(i, most));
    settled |= i > 0 && !(t_[i] < self_.T_) && square_[i] == most_[i];
    if (i < known && square_[i] == before) break;
  }
  return settled;
}

/// What the joints can brake from, or speed up from, in the interval before the node after i.
double LimitedStep::LookAhead::fastest_before(int i, const Joints& most) const {
  const Joints &A = from_[i], &B = to_[i];
  const double X = most_[i], Y = square_[i + 1];
  // Most often nothing binds at Y, or one joint alone: where all others are clear of it,
  // 'largest_x' ends on that joint's row.
  double alone = INFINITY;
  Eigen::Index hardest = 0;
  for (Eigen::Index j = 0; j < n_; ++j) {
    const double x = (most[j] - std::copysign(Y, A[j]) * B[j]) / std::abs(A[j]);
    if (!(x < alone)) continue;
    alone = x;
    hardest = j;
  }
  Joints others = A * std::min(alone, X) + B * Y;
  if (alone < X) others[hardest] = 0;
  if ((others.cwiseAbs().array() < (1 - 1e-9) * most.array()).all()) {
    if (!(alone < X)) return X;
    const Row row{std::abs(A[hardest]), std::copysign(1, A[hardest]) * B[hardest], most[hardest]};
    if (alone > 0 && alone < (1 - 1e-9) * X && row.B < 0) return on_edge(row, Y);
  }
  Rows rows;
  int n = 0;
  for (Eigen::Index j = 0; j < n_; ++j) {
    if (std::abs(A[j]) + std::abs(B[j]) < 1e-12) continue;
    rows[n++] = {A[j], B[j], most[j]};
    rows[n++] = {-A[j], -B[j], most[j]};
  }
  return largest_x(rows, n, X, Y);
}

/// alpha^2 below the curve here and after alpha T.
double LimitedStep::LookAhead::alpha() const {
  const double T = self_.T_;
  const int n = last_ + 1;
  double alpha = std::min(1.0, std::sqrt(square_[0]));
  for (int pass = 0; pass < 4; ++pass) {
    const double at = alpha * T;
    int k = 0;
    while (k + 2 < n && t_[k + 1] <= at) ++k;
    if (n < 2) return 0;
    const double slope = (square_[k + 1] - square_[k]) / std::max(t_[k + 1] - t_[k], 1e-15);
    if (slope >= 0 && k == 0) return alpha;
    // alpha^2 = square_k + slope (alpha T - t_k), for a falling line the larger root.
    const double free = std::max(square_[k] - slope * t_[k], 0.0);
    const double b = 0.5 * slope * T;
    const double root = b + std::sqrt(b * b + free);
    const double next = std::clamp(root, 0.0, alpha);
    if (!(next < alpha * (1 - 1e-9))) return alpha;
    alpha = next;
  }
  return alpha;
}

}  // namespace surg
