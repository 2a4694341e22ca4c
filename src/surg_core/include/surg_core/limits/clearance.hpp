// Keeps one arm's distance to the other arms, the table and the patient. All are capsules or
// half-spaces. The guard caps the clock's rate alpha (limited_step.hpp), so the arm slows down on
// its path and stops before the distance is used up. Motion away is never limited.
//
// With s the distance left, the closing speed of every pair of points stays below sqrt(2 a s). Two
// arms share what is left: each counts half of it as its own. Each may therefore stop by itself,
// whatever the other does within the same rule. The other arm is known by its measured joints,
// which are late: it counts as closing at its measured speed until this arm's command takes effect.
#pragma once

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/limits/capsule.hpp"
#include "surg_core/types.hpp"

namespace surg {

constexpr int kMaxOtherArms = 3;      ///< other arms that one arm can be guarded against
constexpr int kMaxLinkCapsules = 33;  ///< capsules of one arm, its instrument and its wrist

/// One arm with its instrument, as capsules.
struct ArmShape {
  std::string name;
  Chain chain;
  Pose X_WB = Pose::Identity();
  std::vector<LinkCapsule> capsules;
};

/// Builds the shape of an arm. The shaft lies where its calibration says, the other capsules where
/// the YAML files say. Round the centre of a wrist lies a ball that holds the tip however the wrist
/// is bent. Throws ConfigError where the robot's YAML has no 'capsules'.
ArmShape arm_shape(const std::string& name, const Chain& chain, const Pose& X_WB,
                   const RobotConfig& robot, const InstrumentConfig& instrument,
                   const ToolCalibration& tool);

/// Puts another instrument on an arm: its capsules replace those that follow the robot's.
void mount(ArmShape& shape, const RobotConfig& robot, const InstrumentConfig& instrument,
           const ToolCalibration& tool);

/// The capsules at joint positions q, one row each: both ends in W and the radius [m].
Eigen::Matrix<double, Eigen::Dynamic, 7> placed(const ArmShape& shape, const JointVector& q);

/// What one arm keeps its distance to. Without others and obstacles: no guard.
struct ClearanceSetup {
  double distance = 0;  ///< [m] that the surfaces stay apart
  double shafts = 0;    ///< [m] between two shafts; 0: they may touch
  ArmShape own;
  std::vector<ArmShape> others;
  std::vector<Obstacle> obstacles;  ///< in W
  bool active() const { return !others.empty() || !obstacles.empty(); }
};

/// The latest joint state of another arm.
struct OtherArm {
  bool valid = false;  ///< a state has been received
  double age = 0;      ///< [s] since it was received (0 in lock-step)
  JointVector q, qd;   ///< measured [rad, rad/s]
};
using OtherArms = std::array<OtherArm, kMaxOtherArms>;

/// The smallest distance at one moment, and what is so close.
struct Clearance {
  double distance = INFINITY;  ///< [m]; infinite: nothing to measure
  std::string own, other;      ///< names of the capsules or obstacles, for people
};

/// The guard of one arm. Construct once; nothing allocates but 'closest' and 'mount'.
class ClearanceGuard {
 public:
  ClearanceGuard() = default;
  /// lag [s]: from a command of this arm to its motion. T [s]: control period. held [s]: longest
  /// time for which its link goes on. Throws ConfigError for too many arms or capsules.
  ClearanceGuard(const ClearanceSetup& setup, double lag, double T, double held = 0);

  bool active() const { return active_; }
  /// Another instrument on this arm.
  void mount(const RobotConfig& robot, const InstrumentConfig& instrument,
             const ToolCalibration& tool);
  /// Takes the other arms' states, in the order of ClearanceSetup::others.
  void sense(const OtherArms& others) { others_ = others; }
  /// Whether another arm's state is missing or too old. The arm may then only move away from where
  /// that arm was last seen.
  bool other_lost() const;

  /// The largest alpha for joint velocities qd0 + alpha qd1 [rad/s] at joint positions q; infinite:
  /// no limit. back [rad/s]: part of qd0 that the step may leave out. acceleration [rad/s^2]: of
  /// the joints, with which the arm brakes.
  double cap(const JointVector& q, const JointVector& qd0, const JointVector& back,
             const JointVector& qd1, const JointVector& acceleration) const;
  /// Smallest distance at joint positions q [m]. Two shafts do not count.
  double distance(const JointVector& q) const;
  /// The same with names.
  Clearance closest(const JointVector& q) const;
  /// Share in [0, 1] of the null space motion that is left 'distance' [m] away from the nearest.
  double posture_share(double distance) const;

  /// Serializes what a step reads (snapshot.hpp).
  template <typename Archive>
  void serialize(Archive& archive) {
    for (OtherArm& other : others_) archive(other.valid, other.age, other.q, other.qd);
  }

 private:
  /// A body that a capsule of the own arm keeps clear of: an obstacle, or another arm's capsule.
  struct Target {
    const Obstacle* obstacle = nullptr;
    int arm = -1, capsule = -1;  // of the others
    double required = 0;         // [m]
  };
  class Approach;
  struct Nearest {
    double distance = INFINITY;
    int own = -1;
    Target target;
  };
  Nearest measure(const JointVector& q) const;

  /// Calls visit(index of the own capsule, target) for every pair that must keep a distance.
  template <typename Visit>
  void each_pair(Visit visit) const;

  bool active_ = false;
  double lag_ = 0, T_ = 0, held_ = 0;
  ClearanceSetup setup_;        // obstacles in B
  std::vector<Pose> X_BOther_;  // bases of the other arms in B
  OtherArms others_;
};

}  // namespace surg
