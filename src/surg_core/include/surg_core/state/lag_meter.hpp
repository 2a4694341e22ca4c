// Measures the lag of a robot link from ordinary motion: dead time and each joint's servo.
#pragma once

#include <array>
#include <cmath>

#include "surg_core/types.hpp"

namespace surg {

/// A link that obeys velocity commands after a dead time, common to its joints, each joint with a
/// servo of the first order: q' = c'(t - dead_time) / (1 + servo s).
struct LinkLag {
  double dead_time = 0;  ///< [s]
  JointVector servo;     ///< [s] time constant of each joint
  /// [s] of the slowest joint.
  double slowest() const { return dead_time + (servo.size() > 0 ? servo.maxCoeff() : 0.0); }
};

/// Estimates a LinkLag by least squares over the recent past. The integrated commands c and the
/// measured positions q pass the same high-pass filter, which removes their constant difference.
/// For each dead time of a grid, and each joint i:
///
///   c_i(t - dead_time) - q_i = (m(t) + d_i) v_i
///
/// m(t) is what all joints are late at this moment, whatever it be: a link that is late for some
/// tens of milliseconds is late for all of them. It is taken out sample by sample, so it spoils
/// nothing. What is left tells how the joints' servos differ (d_i), which is what moves the pivot.
/// The dead time is the one that leaves the least. The mean of m(t) tells the lag of all joints.
/// The stated lags count like a little motion that was seen before, so nothing leaps when the arm
/// begins to move.
class LagMeter {
 public:
  /// stated [s]: the lag of each joint, taken for a servo's until the motion shows otherwise.
  explicit LagMeter(const JointVector& stated = {});

  /// Call it once per cycle. qd_command: sent in the previous cycle [rad/s]; q: measured now [rad];
  /// age: of q [s]; dt: since the previous cycle [s].
  void step(const JointVector& qd_command, const JointVector& q, double age, double dt);
  /// Call it in cycles in which the arm does not obey commands. The estimate is kept.
  void interrupt() { running_ = false; }
  /// Dead time and servos, from what was stated and what was measured.
  const LinkLag& link() const { return link_; }
  /// [s] measured, of all joints together; NaN before enough motion was seen.
  double lag() const;
  /// [s] measured, of each joint; NaN before enough motion was seen.
  JointVector joint_lag() const;

 private:
  static constexpr int kGrid = 24;                 // dead times: 0 to 46 ms
  static constexpr double kStep = 0.002;           // [s] from one to the next
  static constexpr int kHistory = 2 * kGrid + 48;  // [cycles] of at least half a step
  struct Command {
    double t;       // [s]
    JointVector c;  // [rad] integrated and filtered
  };
  using Sums = Eigen::Array<double, kMaxJoints, kGrid>;
  using SquareMatrix =
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxJoints, kMaxJoints>;

  void restart(const JointVector& q);
  void note_command(double keep);
  Sums leads(double age) const;
  void add(const Sums& lead, const JointVector& v, double dt);
  double likelihood(const Sums& lead, const JointVector& v) const;
  void estimate();
  void take_up_best();
  /// A value per dead time, at the estimated one.
  double at_dead_time(const Sums& sums, Eigen::Index joint) const;

  JointVector stated_;
  bool running_ = false;
  double t_ = 0, waited_ = 0;       // [s]; waited_: since the last cycle that counted
  JointVector commanded_, q_last_;  // [rad] since the last cycle that counted; measured there
  JointVector c_, q_;               // [rad] both, filtered
  std::array<Command, kHistory> history_;
  int newest_ = 0, known_ = 0;
  Sums lead_;           // [rad] c - q in the last cycle that counted
  Sums cross_;          // sum (c - q) v dt [rad^2]
  Sums differ_, left_;  // the same without m(t), and its square [rad^2 s]
  JointVector square_;  // sum v^2 dt [rad^2 / s]
  SquareMatrix apart_;  // sum (v_i v_j [i = j] - v_i^2 v_j^2 / |v|^2) dt [rad^2 / s]
  Sums servo_;          // [s] of each joint, and what each dead time leaves [rad^2 s]
  std::array<double, kGrid> cost_;
  int turn_ = 0;  // the dead time that is estimated next
  LinkLag link_;
};

}  // namespace surg
