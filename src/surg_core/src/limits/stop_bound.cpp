#include "surg_core/limits/stop_bound.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

namespace surg {
namespace {

constexpr int kNewest = 4;          // commands on their way that are tried as the last one
constexpr int kApart = 4;           // [periods] between commands that have arrived and are tried
constexpr double kPart = 0.5;       // of the time for which a command that has arrived is held
constexpr double kNoise = 1e-3;     // [rad/s] of a measured velocity
constexpr double kUnsettled = 0.1;  // of the commands' range: measured beside a command that stands

using Columns = Eigen::Matrix<double, 3, kMaxJoints>;
using Square = Eigen::Matrix<double, kMaxJoints, kMaxJoints>;

/// One interval per joint.
struct Box {
  Joints low, high;
  Joints middle() const { return 0.5 * (low + high); }
  Joints half() const { return 0.5 * (high - low); }
  Joints most() const { return low.cwiseAbs().cwiseMax(high.cwiseAbs()); }
  void hold(const Joints& value) {
    low = low.cwiseMin(value);
    high = high.cwiseMax(value);
  }
  /// With the values a share of the way to those of another.
  Box towards(const Box& other, double share) const {
    return {low.cwiseMin(low + share * (other.low - low)),
            high.cwiseMax(high + share * (other.high - high))};
  }
};

/// Where a point gets by joint travels c + x: offset + J x, and at most bend(x) beside it.
struct Point {
  Vector3 offset;
  Columns J;
  Square bend;  // half of the second derivatives' norms [m/rad^2]

  double beside(const Joints& x) const { return x.dot(bend * x) * (1 + 0.5 * x.sum()); }
};

/// The farthest that the tip gets by joint travels in boxes round some middles.
class FarthestTip {
 public:
  explicit FarthestTip(const Point& point) : point_(point) {}

  void take(const Joints& half) {
    rough_ = point_.J.colwise().norm().dot(half);
    half_ = half;
    n_ = 0;
  }
  void reach(const Joints& middle) {
    const Vector3 centre = point_.offset + point_.J * middle;
    const double beside = point_.beside(middle.cwiseAbs() + half_);
    if (centre.norm() + rough_ + beside <= farthest) return;
    if (n_ == 0) find_corners();
    double most = 0;
    for (int i = 0; i < n_; ++i) {  // half of them; the others are opposite
      most = std::max(most, size_[i] + 2 * std::abs(centre.dot(corner_[i])));
    }
    farthest = std::max(farthest, std::sqrt(centre.squaredNorm() + most) + beside);
  }

  double farthest = 0;

 private:
  /// Of the box, seen as J x: walked along its edges, so that one joint changes at a time.
  void find_corners() {
    std::array<Vector3, kMaxJoints> edge;
    Vector3 at = Vector3::Zero();
    int edges = 0;
    for (int i = 0; i < kMaxJoints; ++i) {
      if (!(half_[i] > 0)) continue;
      edge[edges] = 2 * half_[i] * point_.J.col(i);
      at += 0.5 * edge[edges++];
    }
    n_ = edges > 0 ? 1 << (edges - 1) : 1;
    for (int i = 0; i < n_; ++i) {
      if (i > 0) {
        int flipped = 0;
        while (!(i >> flipped & 1)) ++flipped;
        const bool back = (i >> flipped >> 1 & 1) != 0;  // Gray code
        at += back ? edge[flipped] : Vector3(-edge[flipped]);
      }
      corner_[i] = at;
      size_[i] = at.squaredNorm();
    }
  }

  Point point_;
  Joints half_;
  double rough_ = 0;
  int n_ = 0;
  std::array<Vector3, 1 << (kMaxJoints - 1)> corner_;
  std::array<double, 1 << (kMaxJoints - 1)> size_;
};

/// The same for the shaft across itself, exactly: the box is a polygon there.
class FarthestShaft {
 public:
  FarthestShaft(const Point& point, const Vector3& s) : point_(point) {
    across_.row(0) = s.unitOrthogonal();
    across_.row(1) = s.cross(Vector3(across_.row(0)));
    J_ = across_ * point.J;
    offset_ = across_ * point.offset;
  }

  void take(const Joints& half) {
    half_ = half;
    std::array<Plane, kMaxJoints> edge;
    n_ = 0;
    corner_[0].setZero();
    for (int i = 0; i < kMaxJoints; ++i) {
      Plane along = half[i] * J_.col(i);
      if (along.isZero(0)) continue;
      if (along.y() < 0 || (along.y() == 0 && along.x() < 0)) along = -along;
      corner_[0] -= along;
      int at = n_++;
      for (; at > 0 && turns_back(edge[at - 1], along); --at) edge[at] = edge[at - 1];
      edge[at] = along;
    }
    for (int i = 0; i < n_; ++i) corner_[i + 1] = corner_[i] + 2 * edge[i];
  }
  void reach(const Joints& middle) {
    const Plane centre = offset_ + J_ * middle;
    double most = 0;
    for (int i = 0; i <= n_; ++i) {
      const Plane& corner = corner_[i];  // half of them; the others are opposite
      most = std::max(
          most, centre.squaredNorm() + corner.squaredNorm() + 2 * std::abs(centre.dot(corner)));
    }
    const Joints x = middle.cwiseAbs() + half_;
    const double tilt = x.sum();  // of the shaft, at most: it is seen along its middle
    farthest = std::max(farthest, (std::sqrt(most) + point_.beside(x)) * (1 + 0.5 * tilt * tilt));
  }

  double farthest = 0;

 private:
  using Plane = Eigen::Vector2d;
  static bool turns_back(const Plane& a, const Plane& b) { return a.x() * b.y() < a.y() * b.x(); }

  Point point_;
  Eigen::Matrix<double, 2, 3> across_;
  Eigen::Matrix<double, 2, kMaxJoints> J_;
  Plane offset_;
  Joints half_;
  std::array<Plane, kMaxJoints + 1> corner_;
  int n_ = 0;
};

/// The arm at one posture: columns of the flange's Jacobian.
struct Posture {
  Posture(const Chain& chain, const Joints& q, const StopEstimator::Now& now) {
    const auto [X_BF, J] = chain.flange(JointVector(q.head(chain.dof())));
    p_BF = X_BF.translation();
    p_BTip = X_BF * now.tool.p_FTip;
    s = X_BF.linear() * now.tool.s_F;
    v.setZero();
    axis.setZero();
    v.leftCols(J.cols()) = J.topRows<3>();
    axis.leftCols(J.cols()) = J.bottomRows<3>();
  }
  Columns at(const Vector3& p) const {
    Columns moved;
    for (int i = 0; i < kMaxJoints; ++i) moved.col(i) = v.col(i) + cross(i, p - p_BF);
    return moved;
  }
  Vector3 cross(int joint, const Vector3& p) const { return Vector3(axis.col(joint)).cross(p); }

  Vector3 p_BF, p_BTip, s;
  Columns v, axis;
};

Point tip_point(const Posture& arm, const Vector3& from) {
  Point point;
  point.offset = arm.p_BTip - from;
  point.J = arm.at(arm.p_BTip);
  for (int j = 0; j < kMaxJoints; ++j) {
    for (int i = 0; i <= j; ++i) {
      point.bend(i, j) = point.bend(j, i) = 0.5 * arm.cross(i, point.J.col(j)).norm();
    }
  }
  return point;
}

/// The point of the shaft's line that is nearest to the trocar, from there.
Point shaft_point(const Posture& arm, const Vector3& p_BRcm) {
  const Vector3& s = arm.s;
  Point point;
  point.offset = arm.p_BTip - p_BRcm;
  const Vector3 near = arm.p_BTip - s.dot(point.offset) * s;
  point.offset = near - p_BRcm;
  const Columns moved = arm.at(near);
  point.J = moved - s * (s.transpose() * moved);
  for (int j = 0; j < kMaxJoints; ++j) {
    for (int i = 0; i <= j; ++i) {
      const Vector3 turn_i = arm.cross(i, s), turn_j = arm.cross(j, s);
      const Vector3 second = arm.cross(i, moved.col(j));
      const Vector3 bend =
          second - s * s.dot(second) - turn_i * s.dot(moved.col(j)) - turn_j * s.dot(moved.col(i));
      point.bend(i, j) = point.bend(j, i) = 0.5 * bend.norm();
    }
  }
  return point;
}

/// Tip and shaft as functions of the joints' travel, linear about one of its values.
struct View {
  View(const Chain& chain, const StopEstimator::Now& now, const Joints& about,
       const Vector3& p_BTip)
      : View(Posture(chain, padded(now.q) + about, now), now, about, p_BTip) {}

  void take(const Joints& half) {
    tip.take(half);
    shaft.take(half);
  }
  void reach(const Joints& travel) {
    tip.reach(travel - origin);
    shaft.reach(travel - origin);
  }

  Joints origin;
  FarthestTip tip;
  FarthestShaft shaft;

 private:
  View(const Posture& arm, const StopEstimator::Now& now, const Joints& about,
       const Vector3& p_BTip)
      : origin(about), tip(tip_point(arm, p_BTip)), shaft(shaft_point(arm, now.p_BRcm), arm.s) {}
};

/// All ways to rest of an arm in one state.
class Ways {
 public:
  using Commands = StopEstimator::Commands;

  Ways(const Chain& chain, const StopRanges& ranges, const Commands& sent,
       const StopEstimator::Now& now, double T)
      : sent_(sent),
        T_(T),
        held_(ranges.dead_man + T),
        lag_(std::max(now.lag, 1e-6)),
        lead_(ranges.deceleration),
        delay_(std::min(static_cast<int>(std::ceil((now.lag + now.age) / T)), kMost)),
        oldest_(std::min(delay_ + static_cast<int>(std::ceil(held_ / T)), Commands::kMost - 1)),
        qd_(padded(now.qd)),
        least_(Joints::Ones()),
        most_(Joints::Ones()) {
    least_.head(now.q.size()) = ranges.least;
    most_.head(now.q.size()) = ranges.most;
    sum_[0].setZero();
    for (int i = 0; i < delay_; ++i) sum_[i + 1] = sum_[i] + T * sent.ago(i + 1);
    waiting_ = {sum_[delay_], sum_[delay_ / 2], sum_[0]};
    const Vector3 p_BTip = Posture(chain, padded(now.q), now).p_BTip;
    const Joints& u = sent.ago(0);
    const Joints hold = held_ * u + sum_[delay_] + 0.5 * lag_ * (qd_ - u);
    for (const bool apart : {true, false}) {
      const int i = apart ? 0 : 1;
      const Joints stop = stopping({u, u}, apart).first;
      to_the_end_[i].emplace(chain, now, hold + stop, p_BTip);
      a_part_[i].emplace(chain, now, kPart * hold + stop, p_BTip);
      at_once_[i].emplace(chain, now, stopping({qd_, qd_}, apart).first, p_BTip);
    }
  }

  /// The last command to arrive is still on its way: held until the link stops the arm, or the
  /// robot stops as it arrives.
  void go_with_those_on_their_way() {
    const int stride = std::max(delay_ / (kNewest - 1), 1);
    for (int j = 0; j <= delay_; j += stride) {
      const Joints& u = sent_.ago(j);
      const Joints behind = lag_ * (qd_ - u);
      Box pending{qd_.cwiseMin(u), qd_.cwiseMax(u)};
      for (int i = j; i <= delay_; ++i) pending.hold(sent_.ago(i));
      visit(to_the_end_, held_ * u - sum_[j] + 0.5 * behind, 0.5 * behind.cwiseAbs(),
            Box{u, u}.towards(pending, std::exp(-held_ / lag_)), waiting_.size());
      const Box sudden{qd_.cwiseMin(u), qd_.cwiseMax(u)};
      visit(at_once_, -sum_[j], Joints::Zero(), sudden, waiting_.size());
    }
  }

  /// It has arrived, and the link has been silent since. The arm's velocity tells which it can be.
  void go_with_one_that_has_arrived() {
    for (int j = delay_ + 1; j <= oldest_; j += kApart) {
      const Joints& u = sent_.ago(j);
      const double since = (j - delay_) * T_, rest = std::max(held_ - since, 0.0);
      const double seen = std::exp(-since / lag_) + kUnsettled;
      Box before{u, u};
      for (int i = j; i <= std::min(j + 2 * delay_, oldest_); ++i) before.hold(sent_.ago(i));
      const Joints apart = seen * (before.high - before.low) + Joints::Constant(kNoise);
      if (((u - qd_).cwiseAbs().array() > apart.array()).any()) continue;
      const Joints behind = std::min(lag_, rest) * (qd_ - u);
      visit(a_part_, rest * u + 0.5 * behind - waiting_[0], 0.5 * behind.cwiseAbs(),
            Box{u, u}.towards({qd_, qd_}, std::exp(-rest / lag_)), 1);
    }
  }

  StopBound farthest() const {
    StopBound bound{0, 0};
    for (const Views* both : {&to_the_end_, &a_part_, &at_once_}) {
      for (const std::optional<View>& view : *both) {
        bound.tip = std::max(bound.tip, view->tip.farthest);
        bound.pivot = std::max(bound.pivot, view->shaft.farthest);
      }
    }
    return bound;
  }

 private:
  static constexpr int kMost = Commands::kMost / 2;  // [periods] of delay
  using Views = std::array<std::optional<View>, 2>;  // joints by themselves, or together

  /// One way: travel until the stop begins, with 'lag' either way, and the velocity then.
  void visit(Views& to, const Joints& travel, const Joints& lag, const Box& v, std::size_t delays) {
    for (const bool apart : {true, false}) {
      const auto [middle, half] = stopping(v, apart);
      View& view = *to[apart ? 0 : 1];
      view.take(half + lag);
      for (std::size_t i = 0; i < delays; ++i) view.reach(travel + middle + waiting_[i]);
    }
  }

  /// Middle and half width of the way on which the joints come to rest from velocities v [rad]:
  /// each with a deceleration of its own, or together, no later than the slowest joint.
  std::pair<Joints, Joints> stopping(const Box& v, bool apart) const {
    if (!apart) {
      const Joints fast = v.most();
      const double time = std::max(fast.cwiseQuotient(least_).maxCoeff(), fast.maxCoeff() / lead_);
      return {0.5 * time * v.middle(), 0.5 * time * v.half()};
    }
    Box way;
    for (int i = 0; i < kMaxJoints; ++i) {
      const double low = v.low[i] * std::abs(v.low[i]), high = v.high[i] * std::abs(v.high[i]);
      way.low[i] = 0.5 * low / (low > 0 ? most_[i] : least_[i]);
      way.high[i] = 0.5 * high / (high > 0 ? least_[i] : most_[i]);
    }
    return {way.middle(), way.half()};
  }

  const Commands& sent_;
  double T_, held_, lag_, lead_;
  int delay_, oldest_;  // [periods] of the link at most; of the commands that count
  Joints qd_, least_, most_;
  std::array<Joints, kMost + 1> sum_;  // [rad] of the commands before the newest
  std::array<Joints, 3> waiting_;      // [rad] that the most delay, half of it, or none keeps back
  // Linear about the ends of likely ways: the newest command held to the end, a part of it, or not.
  Views to_the_end_, a_part_, at_once_;
};

}  // namespace

void StopEstimator::add(const JointVector& qd_command) {
  commands_.newest = (commands_.newest + 1) % Commands::kMost;
  commands_.sent[commands_.newest] = padded(qd_command);
}

StopBound StopEstimator::bound(const Chain& chain, const Now& now) const {
  Ways ways(chain, ranges_, commands_, now, T_);
  ways.go_with_those_on_their_way();
  ways.go_with_one_that_has_arrived();
  return ways.farthest();
}

}  // namespace surg
