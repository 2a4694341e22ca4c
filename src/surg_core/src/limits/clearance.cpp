#include "surg_core/limits/clearance.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "limits/joint_box.hpp"
#include "limits/limited_laws.hpp"

namespace surg {
namespace {

constexpr double kClosing = 1.0;    // [m/s^2] with which a closing speed is brought to zero
constexpr double kReserve = 0.002;  // [m] kept beyond the distance: lag, samples, bends of the path
constexpr double kStale = 0.1;      // [s] an older state says nothing about where an arm is
constexpr double kPostureFades = 0.05;  // [m] before the distance, over which the null space rests

}  // namespace

ArmShape arm_shape(const std::string& name, const Chain& chain, const Pose& X_WB,
                   const RobotConfig& robot, const InstrumentConfig& instrument,
                   const ToolCalibration& tool) {
  if (robot.capsules.empty()) {
    throw ConfigError(robot.file +
                      ": capsules: is missing; the clearance guard needs the shape of every link");
  }
  ArmShape shape{name, chain, X_WB, robot.capsules};
  mount(shape, robot, instrument, tool);
  return shape;
}

void mount(ArmShape& shape, const RobotConfig& robot, const InstrumentConfig& instrument,
           const ToolCalibration& tool) {
  shape.capsules.resize(robot.capsules.size());
  const auto put = [&](LinkCapsule capsule) {
    capsule.joint = shape.chain.dof() - 1;
    capsule.shape.a = shape.chain.X_LF() * capsule.shape.a;
    capsule.shape.b = shape.chain.X_LF() * capsule.shape.b;
    shape.capsules.push_back(capsule);
  };
  for (LinkCapsule capsule : instrument.capsules) {
    if (capsule.shaft) {
      const double length = (capsule.shape.b - capsule.shape.a).norm();
      const double bent = instrument.wrist ? instrument.wrist->geometry.length() : 0.0;
      capsule.shape.a = tool.p_FTip - length * tool.s_F;
      capsule.shape.b = tool.p_FTip - bent * tool.s_F;
      // The wrist may turn at any time, and another arm's guard does not know its joints.
      const Capsule ball{capsule.shape.b, capsule.shape.b, bent + capsule.shape.radius};
      if (instrument.wrist) put({"wrist", 0, ball, true});
    }
    put(capsule);
  }
}

// --- where the capsules are, and how they move ---------------------------------------------------

namespace {

/// The capsules of an arm in B, and its joints' axes there.
struct Placed {
  Placed(const ArmShape& arm, const Pose& X_BArm, const JointVector& q) : shape(arm) {
    Pose X = X_BArm;
    const auto put = [&](int joint) {
      for (std::size_t i = 0; i < arm.capsules.size(); ++i) {
        if (arm.capsules[i].joint != joint) continue;
        const Capsule& c = arm.capsules[i].shape;
        capsules[i] = {X * c.a, X * c.b, c.radius};
      }
    };
    put(-1);
    for (int i = 0; i < arm.chain.dof(); ++i) {
      const Joint& joint = arm.chain.joints()[i];
      X = X * joint.X_PJ;
      axis[i] = X.linear() * joint.axis;
      origin[i] = X.translation();
      X.linear() = X.linear() * Eigen::AngleAxisd(q[i], joint.axis).toRotationMatrix();
      put(i);
    }
  }

  const ArmShape& shape;
  std::array<Capsule, kMaxLinkCapsules> capsules;
  std::array<Vector3, kMaxJoints> axis, origin;
};

/// Velocities of all links of an arm at some joint velocities: v(p) = v0 + omega x p.
struct Twists {
  template <typename Axes>
  Twists(const Axes& axis, const Axes& origin, const JointVector& qd) {
    omega.fill(Vector3::Zero());
    v0.fill(Vector3::Zero());
    for (Eigen::Index i = 0; i < qd.size(); ++i) {
      omega[i + 1] = omega[i] + qd[i] * axis[i];
      v0[i + 1] = v0[i] + qd[i] * origin[i].cross(axis[i]);
    }
  }
  Vector3 at(int joint, const Vector3& p) const {
    return v0[joint + 1] + omega[joint + 1].cross(p);
  }
  /// Speed of the fastest point of a capsule.
  double fastest(int joint, const Capsule& c) const {
    return std::sqrt(std::max(at(joint, c.a).squaredNorm(), at(joint, c.b).squaredNorm()));
  }

  std::array<Vector3, kMaxJoints + 1> omega, v0;
};

}  // namespace

Eigen::Matrix<double, Eigen::Dynamic, 7> placed(const ArmShape& shape, const JointVector& q) {
  const Placed here(shape, shape.X_WB, q);
  const auto n = static_cast<Eigen::Index>(shape.capsules.size());
  Eigen::Matrix<double, Eigen::Dynamic, 7> rows(n, 7);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Capsule& c = here.capsules[static_cast<std::size_t>(i)];
    rows.row(i) << c.a.transpose(), c.b.transpose(), c.radius;
  }
  return rows;
}

template <typename Visit>
void ClearanceGuard::each_pair(Visit visit) const {
  for (std::size_t i = 0; i < setup_.own.capsules.size(); ++i) {
    const LinkCapsule& own = setup_.own.capsules[i];
    if (own.joint < 0) continue;  // does not move
    if (!own.shaft) {             // the shaft enters the patient
      for (const Obstacle& obstacle : setup_.obstacles) {
        visit(i, Target{&obstacle, -1, -1, setup_.distance});
      }
    }
    for (std::size_t arm = 0; arm < setup_.others.size(); ++arm) {
      if (!others_[arm].valid) continue;
      const std::vector<LinkCapsule>& theirs = setup_.others[arm].capsules;
      for (std::size_t k = 0; k < theirs.size(); ++k) {
        const bool shafts = own.shaft && theirs[k].shaft;
        if (shafts && !(setup_.shafts > 0)) continue;
        visit(i, Target{nullptr, static_cast<int>(arm), static_cast<int>(k),
                        shafts ? setup_.shafts : setup_.distance});
      }
    }
  }
}

// --- the guard -----------------------------------------------------------------------------------

ClearanceGuard::ClearanceGuard(const ClearanceSetup& setup, double lag, double T, double held)
    : active_(setup.active()), lag_(lag), T_(T), held_(held), setup_(setup) {
  if (setup.others.size() > kMaxOtherArms) {
    throw ConfigError("clearance: at most " + std::to_string(kMaxOtherArms + 1) +
                      " arms of a cell can be guarded against each other");
  }
  const Pose X_BW = setup.own.X_WB.inverse();
  for (Obstacle& obstacle : setup_.obstacles) {
    obstacle.capsule.a = X_BW * obstacle.capsule.a;
    obstacle.capsule.b = X_BW * obstacle.capsule.b;
    obstacle.space.point = X_BW * obstacle.space.point;
    obstacle.space.normal = X_BW.linear() * obstacle.space.normal;
  }
  const auto check = [](const ArmShape& arm) {
    if (arm.capsules.size() <= kMaxLinkCapsules) return;
    throw ConfigError("clearance: arm " + arm.name + " has " + std::to_string(arm.capsules.size()) +
                      " capsules; allowed are " + std::to_string(kMaxLinkCapsules));
  };
  check(setup_.own);
  for (const ArmShape& other : setup_.others) {
    check(other);
    X_BOther_.push_back(X_BW * other.X_WB);
  }
}

void ClearanceGuard::mount(const RobotConfig& robot, const InstrumentConfig& instrument,
                           const ToolCalibration& tool) {
  if (active_) surg::mount(setup_.own, robot, instrument, tool);
}

bool ClearanceGuard::other_lost() const {
  for (std::size_t i = 0; i < setup_.others.size(); ++i) {
    if (!others_[i].valid || !(others_[i].age <= kStale)) return true;
  }
  return false;
}

/// The cap of one cycle: all pairs of points, each with its closing speed.
class ClearanceGuard::Approach {
 public:
  Approach(const ClearanceGuard& guard, const JointVector& q, const JointVector& qd0,
           const JointVector& back, const JointVector& qd1, const JointVector& acceleration)
      : guard_(guard),
        own_(guard.setup_.own, Pose::Identity(), q),
        still_(own_.axis, own_.origin, qd0),
        moving_(own_.axis, own_.origin, qd1),
        braking_(clock_braking(qd1, acceleration)) {
    if (!back.isZero(0)) waiting_.emplace(own_.axis, own_.origin, qd0 - back);
    const ClearanceSetup& setup = guard.setup_;
    for (std::size_t i = 0; i < setup.own.capsules.size(); ++i) {
      const int joint = setup.own.capsules[i].joint;
      double waiting = still_.fastest(joint, own_.capsules[i]);
      if (waiting_) waiting = std::max(waiting, waiting_->fastest(joint, own_.capsules[i]));
      speed_[i] = moving_.fastest(joint, own_.capsules[i]) + waiting;
    }
    for (std::size_t i = 0; i < setup.others.size(); ++i) {
      others_[i].emplace(setup.others[i], guard.X_BOther_[i], guard.others_[i].q);
      theirs_[i].emplace(others_[i]->axis, others_[i]->origin, guard.others_[i].qd);
      last_seen_[i] = guard.others_[i].age <= kStale ? -INFINITY : nearest(*others_[i]);
    }
  }

  void keep_clear(std::size_t i, const Target& target) {
    const int joint = own_.shape.capsules[i].joint;
    const Capsule& capsule = own_.capsules[i];
    // Farther away than it takes to stop from the present speed, no pair limits anything.
    const double far = std::max(speed_[i] * speed_[i] / kClosing, speed_[i] / braking_) +
                       speed_[i] * held_ + kReserve + target.required;
    if (target.arm >= 0) {
      keep_clear_of_arm(joint, capsule, far, target);
    } else if (target.obstacle->half_space) {
      for (const Gap& gap : gaps(capsule, target.obstacle->space)) {
        if (gap.distance < far) keep(joint, gap, gap.distance - target.required - kReserve);
      }
    } else if (distance_at_least(capsule, target.obstacle->capsule) < far) {
      for (const Gap& gap : gaps(capsule, target.obstacle->capsule)) {
        keep(joint, gap, gap.distance - target.required - kReserve);
      }
    }
  }

  double alpha() const { return alpha_; }

 private:
  /// The other arm counts as closing at its measured speed until the command takes effect. What is
  /// left then is shared.
  void keep_clear_of_arm(int joint, const Capsule& capsule, double far, const Target& target) {
    const Twists& theirs = *theirs_[target.arm];
    const Capsule& other = others_[target.arm]->capsules[target.capsule];
    const int their_joint = others_[target.arm]->shape.capsules[target.capsule].joint;
    const double age = guard_.others_[target.arm].age;
    const double late = guard_.lag_ + guard_.T_ + age;
    const double they = late * theirs.fastest(their_joint, other);
    if (age <= kStale && distance_at_least(capsule, other) > 2 * far + they) return;
    for (const Gap& gap : gaps(capsule, other)) {
      const double opening = -gap.away.dot(theirs.at(their_joint, gap.p_other));
      const double left = gap.distance - target.required - kReserve + late * std::min(opening, 0.0);
      keep(joint, gap, std::min(0.5 * left, gap.distance - last_seen_[target.arm]));
    }
  }

  /// Limits the speed with which this arm closes a gap of which 'left' [m] may be used.
  void keep(int joint, const Gap& gap, double left) {
    const double closing = -gap.away.dot(moving_.at(joint, gap.p));
    if (!(closing > 0)) return;  // away
    const double a = std::min(kClosing, braking_ * closing);
    // 'back' may be taken or wait: where it leads away, nothing is gained by it.
    double already = -gap.away.dot(still_.at(joint, gap.p));
    if (waiting_) already = std::max(already, -gap.away.dot(waiting_->at(joint, gap.p)));
    // From here the arm comes to rest before the gap is used up, whatever stops it.
    const double fastest = approach_speed(left, a, 0, held_);
    alpha_ = std::min(alpha_, std::max((fastest - already) / closing, 0.0));
  }

  /// Smallest distance to another arm [m].
  double nearest(const Placed& other) const {
    double least = INFINITY;
    for (std::size_t i = 0; i < own_.shape.capsules.size(); ++i) {
      for (std::size_t k = 0; k < other.shape.capsules.size(); ++k) {
        if (own_.shape.capsules[i].joint < 0) continue;
        if (own_.shape.capsules[i].shaft && other.shape.capsules[k].shaft) continue;
        least = std::min(least, surg::distance(own_.capsules[i], other.capsules[k]));
      }
    }
    return least;
  }

  const ClearanceGuard& guard_;
  Placed own_;
  Twists still_, moving_;
  double held_ = std::max(guard_.T_, guard_.held_);
  std::optional<Twists> waiting_;  // without 'back', where there is any
  double braking_;                 // [1/s] of the clock: what the joints can do all together
  double alpha_ = INFINITY;
  std::array<double, kMaxLinkCapsules> speed_;  // of the fastest point of each capsule
  /// [m] from where a lost arm was last seen: its distance may not become smaller.
  std::array<double, kMaxOtherArms> last_seen_;
  std::array<std::optional<Placed>, kMaxOtherArms> others_;
  std::array<std::optional<Twists>, kMaxOtherArms> theirs_;
};

double ClearanceGuard::cap(const JointVector& q, const JointVector& qd0, const JointVector& back,
                           const JointVector& qd1, const JointVector& acceleration) const {
  for (std::size_t i = 0; i < setup_.others.size(); ++i) {
    if (!others_[i].valid) return 0;  // it may be anywhere
  }
  Approach approach(*this, q, qd0, back, qd1, acceleration);
  each_pair([&](std::size_t i, const Target& target) { approach.keep_clear(i, target); });
  return approach.alpha();
}

double ClearanceGuard::distance(const JointVector& q) const { return measure(q).distance; }

Clearance ClearanceGuard::closest(const JointVector& q) const {
  const Nearest nearest = measure(q);
  Clearance out;
  out.distance = nearest.distance;
  if (nearest.own < 0) return out;
  out.own = setup_.own.capsules[nearest.own].name;
  const Target& target = nearest.target;
  if (target.obstacle) {
    out.other = target.obstacle->name;
  } else {
    const ArmShape& arm = setup_.others[target.arm];
    out.other = arm.name + " " + arm.capsules[target.capsule].name;
  }
  return out;
}

ClearanceGuard::Nearest ClearanceGuard::measure(const JointVector& q) const {
  const Placed own(setup_.own, Pose::Identity(), q);
  std::array<std::optional<Placed>, kMaxOtherArms> others;
  for (std::size_t i = 0; i < setup_.others.size(); ++i) {
    if (others_[i].valid) others[i].emplace(setup_.others[i], X_BOther_[i], others_[i].q);
  }
  Nearest nearest;
  each_pair([&](std::size_t i, const Target& target) {
    const Capsule& capsule = own.capsules[i];
    double apart = INFINITY;
    if (target.obstacle && target.obstacle->half_space) {
      apart = surg::distance(capsule, target.obstacle->space);
    } else {
      const Capsule& other =
          target.obstacle ? target.obstacle->capsule : others[target.arm]->capsules[target.capsule];
      const bool shafts = !target.obstacle && setup_.own.capsules[i].shaft &&
                          setup_.others[target.arm].capsules[target.capsule].shaft;
      if (shafts || distance_at_least(capsule, other) >= nearest.distance) return;
      apart = surg::distance(capsule, other);
    }
    if (apart < nearest.distance) nearest = {apart, static_cast<int>(i), target};
  });
  return nearest;
}

double ClearanceGuard::posture_share(double distance) const {
  if (!active_) return 1;
  return std::clamp((distance - setup_.distance - kReserve) / kPostureFades, 0.0, 1.0);
}

}  // namespace surg
