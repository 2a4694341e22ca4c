// Set-point of the instrument, driven by the latest kind of command. Four degrees of freedom in the
// rcm frame: x, y, z, roll (Cartesian) or yaw, pitch, insertion, roll (spherical). A plain value:
// the controller advances a copy and keeps the one whose step the limits allow. Virtual fixtures
// (in the rcm frame) are arguments, because copies must stay small.
#pragma once

#include <array>

#include "surg_core/config.hpp"
#include "surg_core/limits/slide.hpp"
#include "surg_core/motion/profiler.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_input.hpp"
#include "surg_core/types.hpp"

namespace surg {

enum class Space { kCartesian, kSpherical };

/// Position and velocity of the four degrees of freedom in one space.
using Dofs = std::array<Kinematic, Profiler::kDof>;

/// The same tip motion in the other space; accelerations are dropped. The tip must be off the
/// trocar.
Dofs to_spherical(const Dofs& cartesian);
Dofs to_cartesian(const Dofs& spherical);

class Setpoint {
 public:
  enum class Mode { kRest, kStream, kVelocity, kProfile, kStopping };

  struct Options {
    double profiler_duration = 0.5;  ///< [s]
    /// Every stream follows the paper's quintic of fixed duration, re-planned each cycle. The
    /// options below do nothing then.
    bool paper = false;
    double stream_delay = 0;  ///< [s] see StreamDelay
    double tremor = 0;        ///< [Hz] see TremorEstimate; 0: off
    double held = 0;          ///< [s] see Slide
  };

  Setpoint() = default;
  Setpoint(const Limits& limits, const Options& options);

  /// Resets to rest at a tip position [m] in the rcm frame, with unit shaft direction s_R and roll
  /// [rad].
  void reset(const Vector3& p_RTip, const Vector3& s_R, double roll);
  /// Takes a sample of a pose stream (servo_cp, servo_jp) that arrived 'age' seconds ago, with the
  /// stamp of its sender (0: none).
  void add_stream_sample(Space space, const std::array<double, 4>& target, double age = 0,
                         std::int64_t stamp_ns = 0);
  /// Takes a velocity to keep (servo_cv, servo_jv).
  void set_velocity(Space space, const std::array<double, 4>& rate);
  /// Moves to a discrete target (interpolate_*, move_*): a quintic to rest there. If its overshoot
  /// from the present motion would leave the workspace or enter a fixture, the tip stops first.
  /// Returns false and changes nothing if the way from rest does so as well.
  bool move_to(Space space, const std::array<double, 4>& target,
               const Fixtures& fixtures = Fixtures::none());
  /// Moves straight along the shaft to a depth [m], which may lie above the trocar, with at most
  /// 'speed' [m/s]. The workspace is not checked. From rest only.
  void move_along(const Vector3& s_R, double depth, double speed);
  /// Decelerates the tip along its present direction.
  void stop();

  /// Restarts from rest at the present position: a limit has stopped the arm, and a velocity kept
  /// in the filter would point at the limit for ever. The target stays.
  void restart_from_rest(const Fixtures& fixtures = Fixtures::none());

  /// Whether the motion (a stop or a velocity) has no path to keep.
  bool has_no_path() const { return mode_ == Mode::kStopping || mode_ == Mode::kVelocity; }
  /// For a motion without a path: continues from the tip's true position and velocity. A change
  /// harder than the joints can follow would otherwise leave the tip behind.
  void resync(const Vector3& p_RTip, const Vector3& v_RTip);

  /// Whether the motion is planned from cycle to cycle, without a profile.
  bool is_reactive() const { return mode_ == Mode::kStream || has_no_path(); }
  /// For such a motion: goes on at constant velocity, as the arm does while no command comes.
  void coast(double dt, const Fixtures& fixtures = Fixtures::none());

  /// Sets the unit direction of the force on the tip, zero for none. Streams and velocities no
  /// longer move against it; a profile that does is stopped (F25).
  void yield_to(const Vector3& push_R);
  /// Moves the set-point by by_R [m] at once; a profile is stopped.
  void shift(const Vector3& by_R);

  /// Advances real time by T: the age of stream samples and their delay. heard: samples could
  /// arrive; otherwise a stream is not overdue for it.
  void elapse(double T, bool heard = true);
  double stream_delay() const { return input_.delay(); }  ///< [s] see StreamLateness
  /// A control cycle begins. period [s]: at which they come, if they are late: a stream is followed
  /// more softly then; rest [s]: since the last whole period.
  void begin_cycle(double period, double rest) {
    period_ = period;
    input_.begin_cycle(rest);
  }
  /// Time [s] that the joints need to come to rest together. A velocity is braked before a wall as
  /// early as they need it.
  void set_rest_time(double time) { rest_time_ = time; }
  /// Advances the set-point by dt <= T of its own clock. Streams, velocities and stops slide along
  /// the fixtures; a profile is planned clear of them.
  void advance(double dt, const Fixtures& fixtures = Fixtures::none());
  /// Whether the rest of the present profile stays clear of the fixtures, or goes no deeper into
  /// them than the tip is.
  bool way_is_clear(const Fixtures& fixtures) const;

  /// Tip position and roll, as needed by the look-ahead.
  struct TipAndRoll {
    Vector3 p_RTip;
    double roll;
  };
  /// The result of advance(dt), without changing the set-point.
  TipAndRoll after(double dt, const Fixtures& fixtures = Fixtures::none()) const;
  /// Predicted position in t [s] of its own clock: along its profile, or at constant velocity for
  /// streams and velocities. For the look-ahead only.
  TipAndRoll predict(double t) const;

  Mode mode() const { return mode_; }
  Space space() const { return space_; }
  /// Whether it moves or rests along the shaft line (move_along): only depth and roll may change.
  bool axial() const { return axial_; }
  /// Whether a newer sample of the stream than one with this stamp has been taken.
  bool overtaken(std::int64_t stamp_ns) const { return input_.clock().overtaken(stamp_ns); }
  /// Whether the workspace boundary stopped the last advance.
  bool at_wall() const { return at_wall_; }
  /// Whether a fixture changed the last advance.
  bool at_fixture() const { return at_fixture_; }
  /// How the fixtures limit the tip from here.
  Slide slide(const Fixtures& fixtures) const;
  Vector3 p_RTip() const;
  Vector3 v_RTip() const;
  /// Unit shaft direction from the trocar to the tip; the last one where the tip is near the trocar
  /// or above it.
  Vector3 s_R() const;
  /// Yaw, pitch, insertion, roll.
  Vector4 joints() const;
  double roll() const { return dofs_[3].x; }

 private:
  /// Of four degrees of freedom in the present space.
  Vector3 tip_of(double x, double y, double z) const;
  void switch_space(Space space);
  bool plan(Space space, const std::array<double, 4>& target, const Fixtures& fixtures);
  void come_to_rest(const Fixtures& fixtures);
  Dofs target_clear_of(const Fixtures& fixtures, const Dofs& target);
  void keep_to(const Slide& slide, const Vector3& p_before, double dt);
  void place(const Vector3& p, const Vector3& v, const Vector3& a);
  void advance_freely(double dt, const Fixtures& fixtures);
  void advance_stream(double dt, const Fixtures& fixtures);
  void advance_velocity(double dt, const Fixtures& fixtures);
  void advance_stopping(double dt, const Fixtures& fixtures);
  bool plan_leaves_workspace() const;
  void restrict_step(const Vector3& p_before);
  void place_tip(const Vector3& p_RTip);
  bool stop_leaves_workspace(const std::array<StreamFilter, 4>& filters) const;
  bool leaves_workspace(const Vector3& to) const;
  bool farther_outside(const Vector3& p_RTip) const;
  std::array<DofLimits, 4> dof_limits(Space space) const;

  Limits limits_{};
  bool paper_ = false;
  double base_duration_ = 0.5;
  double held_ = 0;
  StreamInput input_;
  Mode mode_ = Mode::kRest;
  Space space_ = Space::kCartesian;
  Dofs dofs_{};
  bool axial_ = false;
  bool at_wall_ = false;
  bool at_fixture_ = false;
  Vector3 axis_R_ = Vector3::UnitZ();  ///< while axial
  Vector3 push_R_ = Vector3::Zero();   ///< of the force at the tip
  std::array<StreamFilter, 4> filters_{};
  std::array<double, 4> rate_{};
  std::array<double, 4> target_{};
  Space target_space_ = Space::kCartesian;
  double tick_ = 0;              ///< the control period [s]
  double period_ = 0;            ///< at which late cycles come [s]
  double rest_time_ = 0;         ///< of the joints [s]
  double clock_rate_ = 1;        ///< the set-point's time per real time in the last advance
  double profile_duration_ = 0;  ///< base duration of the present profile [s]
  Profiler profiler_;
  bool move_after_stop_ = false;  ///< go to target_ once stopped
};

}  // namespace surg
