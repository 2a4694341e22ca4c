// One control cycle within all joint limits and on the pivot: from a requested motion to joint
// velocities. One factor alpha scales all joints and is also the rate of the set-point's clock.
// (Clamping joints one by one moved the pivot by 33 mm in a prototype.)
//
//   q_dot(alpha) = q_dot_0 + alpha q_dot_1      0: corrections, 1: motion along the path
//
// Velocity, acceleration and braking distance to the position limits leave an interval for alpha;
// look-ahead, singularity barrier and flange speed reduce it. The step is then computed without
// linearisation and checked. If it violates a limit, the interval shrinks and the step is repeated,
// a fixed number of times.
#pragma once

#include <array>
#include <cstdint>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"
#include "surg_core/law/exact.hpp"
#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/barrier.hpp"
#include "surg_core/limits/clearance.hpp"
#include "surg_core/motion/joint_trace.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Joint limits, never exceeded. The flange's speed is limited as far as joint accelerations allow.
struct JointLimits {
  JointVector position_min, position_max;  ///< [rad]
  JointVector velocity;                    ///< [rad/s]
  JointVector acceleration;                ///< [rad/s^2]
  double flange_velocity = INFINITY;       ///< [m/s] speed of the flange origin
  /// [rad] Within this distance of a position limit, speed towards it <= 5 /s times the distance
  /// (F20).
  double position_margin = 0;
};
JointLimits joint_limits(const RobotConfig& robot, const Limits& limits);

/// The path of the set-point: the goal at the end of this cycle if the set-point's clock advances
/// by t [s] from the cycle's beginning. A view of a caller's function object, which must outlive
/// it. A moving trocar is at its position at the end of this cycle for every t.
class PathView {
 public:
  PathView() = default;
  template <typename Path>
  explicit PathView(const Path& path)
      : path_(&path),
        call_([](const void* p, double t) { return (*static_cast<const Path*>(p))(t); }) {}
  template <typename Path>
  explicit PathView(const Path&&) = delete;
  explicit operator bool() const { return call_ != nullptr; }
  ShaftGoal operator()(double t) const { return call_(path_, t); }

 private:
  const void* path_ = nullptr;
  ShaftGoal (*call_)(const void*, double) = nullptr;
};

/// The motion requested for one cycle.
struct StepRequest {
  /// The exact form evaluates it for 0 <= t <= T, the look-ahead up to 'horizon'.
  PathView path;
  double horizon = 0;  ///< [s] of the set-point's clock that the preview looks ahead; 0: none
  /// Exact form: the trocar's velocity during this cycle [m/s]. A rotation of the shaft that it
  /// alone causes is no deviation from the path.
  Vector3 v_BRcm = Vector3::Zero();
  JointVector posture;  ///< [rad/s] wish for the null space of redundant arms; small ones only
  /// Exact form: additional flange speed of the follower compared with this step [m/s].
  double flange_lead = 0;
  /// Exact form: change of the follower's correction that waits for acceleration [rad/s]. The step
  /// leaves up to half of a joint's acceleration to it, in its direction.
  JointVector room;
  // Velocity form only: the flange twist is feedback + alpha forward.
  Vector6 feedback = Vector6::Zero();  ///< tip and roll feedback, lateral feedback, trocar velocity
  Vector6 forward = Vector6::Zero();   ///< the path's own motion; lateral velocity at the trocar 0
};

/// The result of a limited step.
struct Step {
  JointVector qd;               ///< [rad/s], inside every joint limit
  double alpha = 1;             ///< speed of the set-point's clock: advance it by alpha T
  const char* limited_by = "";  ///< static string, empty when alpha is 1
  /// 0: on the path. 1: on the pivot, the tip may leave the path and returns later. 2: braking, as
  /// near to the pivot as the joint limits allow.
  std::uint8_t tier = 0;
  bool held = false;  ///< the path wants to move and the arm cannot: a report, nothing latches
};

/// The limited step of one arm. Construct once; the methods are pure and allocate nothing.
class LimitedStep {
 public:
  static constexpr double kHorizon = 0.45;  ///< [s] of the clock that a preview looks ahead
  /// Of the flange's speed and of a joint's acceleration:
  static constexpr double kMostLead = 0.5;  ///< left to the follower's correction at most

  LimitedStep(const Chain& chain, const Tool& tool, const JointLimits& limits, double T);
  /// Keeps the distances of 'guard', which must outlive the step.
  void keep_clear(const ClearanceGuard& guard) { clearance_ = &guard; }

  /// Exact form: joints of the next pose on the constraint (exact.hpp), from an exactly known state
  /// (a virtual reference). If a limit has moved the tip off its path, the tip returns gradually
  /// while the pivot stays exact.
  ///
  /// q, qd_last: joint positions [rad] and last velocities [rad/s].
  Step exact(const JointVector& q, const JointVector& qd_last, const Home& home,
             const StepRequest& request) const;

  /// Velocity form at joint positions q (measured, or predicted for the command): the twist
  /// feedback + alpha forward. Only the look-ahead uses 'home'.
  Step velocity(const JointVector& q, const JointVector& qd_last, const Home& home,
                const Vector3& p_BRcm, const StepRequest& request) const;

  /// Follows the recorded trace backwards; 'back' [rad] of it has been retraced (JointTrace::at).
  /// 'rate' [rad/s]: speed without limits; the caller advances 'back' by alpha rate T. flange_lead:
  /// as in StepRequest.
  Step retrace(const JointVector& q, const JointVector& qd_last, const JointTrace& trace,
               double back, double rate, const Vector3& p_BRcm, double flange_lead = 0) const;

  void mount(const Tool& tool) { tool_ = tool; }

 private:
  struct Here;
  struct Affine;
  struct Node;
  struct Cap;
  class Box;
  class Law;
  class ExactLaw;
  class VelocityLaw;
  class RetraceLaw;
  class LookAhead;

  Here at(const JointVector& q, const JointVector& qd_last, double flange_lead,
          const JointVector& room = {}) const;
  Step run(const Law& law, const Here& here) const;
  Step run_with_room(const Law& law, const Here& here) const;

  Cap cap(const Law& law, const Here& here, const Affine& affine) const;
  void cap_sagitta(const Law& law, const Here& here, const Affine& affine, Cap& cap) const;
  void cap_approach(const Here& here, const Affine& affine, Cap& cap) const;
  void cap_unseen(const Law& law, const Here& here, const Affine& affine, Cap& cap) const;

  bool on_path(const Law& law, const Affine& affine, const Box& box, const Cap& cap,
               Step& step) const;
  bool on_path(const Law& law, const Affine& affine, const Box& box, const Cap& cap, double beta,
               Step& step) const;
  void off_path(const Law& law, const Here& here, const Affine& affine, const Box& box,
                const Cap& cap, bool too_fast, Step& step) const;
  bool on_rows(const Law& law, const Box& box, const JointVector& wanted, JointVector& qd) const;

  Chain chain_;
  Tool tool_;
  JointLimits limits_;
  Barrier barrier_;
  double reach_;  ///< [m] from any joint to the flange, at most
  double T_;
  const ClearanceGuard* clearance_ = nullptr;
};

}  // namespace surg
