// Set-point of a wrist's drive, beside that of the wrist centre (setpoint.hpp): the same kinds of
// motion, filters and delays, on the same clock. A plain value. Without a wrist it does nothing.
#pragma once

#include <optional>

#include "surg_core/config.hpp"
#include "surg_core/motion/profiler.hpp"
#include "surg_core/motion/stream.hpp"
#include "surg_core/motion/stream_input.hpp"

namespace surg {

class WristMotion {
 public:
  WristMotion() = default;
  /// tuning: delays and tremor of streams, duration of moves.
  WristMotion(const std::optional<WristConfig>& wrist, const Tuning& tuning);

  bool exists() const { return exists_; }
  const WristConfig& config() const { return config_; }
  const WristGeometry& geometry() const { return config_.geometry; }
  bool rolls() const { return exists_ && config_.rolls(); }
  /// See WristGeometry::turn; known from 'home' on.
  void set_turn(double turn) { config_.geometry.turn = turn; }

  /// Takes the measured joints [rad], not finite without a measurement, and the time [s] since the
  /// last ones. Until the first measurement the wrist gets no command.
  void sense(const DriveJoints& measured, double elapsed);
  /// Whether the drive has not followed its commands for a while.
  bool blocked() const { return away_ > kBlockedTime; }

  /// Comes to rest; at rest already, begins at the measured joints if somebody has turned them.
  void start();
  void stop();
  /// A sample of a stream; see Setpoint::add_stream_sample.
  void stream(const DriveJoints& target, double age, std::int64_t stamp_ns);
  void set_velocity(const DriveJoints& rates);
  /// The rates [rad/s] at which the joints go now if these are asked for: slower towards an end.
  DriveJoints allowed(const DriveJoints& rates) const;
  void move_to(const DriveJoints& target);

  /// Whether all joints are inside their ranges.
  bool reaches(const DriveJoints& joints) const;
  DriveJoints nearest(const DriveJoints& joints) const;

  /// Advances real time; see Setpoint::elapse and begin_cycle. delay [s]: of the centre's stream.
  void elapse(double T, bool heard, double delay);
  void begin_cycle(double period, double rest);
  /// Advances the set-point by dt of its own clock, which is the centre's.
  void advance(double dt);

  DriveJoints set() const { return {dofs_[0].x, dofs_[1].x, dofs_[2].x}; }  ///< [rad]
  DriveJoints goal() const { return goal_; }                                ///< [rad]
  bool at_rest() const { return mode_ == Mode::kRest; }
  /// What the drive shall be told, so that it is where the arm is: arm_lag [s] is the arm's. Not a
  /// number until measured.
  DriveJoints command(double arm_lag) const;

 private:
  static constexpr int kJoints = 3;            // see DriveJoints
  static constexpr double kBlockedTime = 0.3;  // [s] away from where the drive should be
  enum class Mode { kRest, kStream, kVelocity, kProfile, kStopping };
  using Values = StreamInput::Values;

  DofLimits limits() const;
  void restart_filters();
  void step(double dt);
  void advance_velocity(double dt);
  void advance_stopping(double dt);

  bool exists_ = false;
  WristConfig config_{};
  double duration_ = 0;  ///< [s] of a move, at least
  Mode mode_ = Mode::kRest;
  bool known_ = false;  ///< measured once
  StreamInput input_;
  Profiler profiler_;
  std::array<StreamFilter, kJoints> filters_{};
  std::array<Kinematic, kJoints> dofs_{};
  DriveJoints goal_ = DriveJoints::Zero(), rates_ = DriveJoints::Zero();
  DriveJoints measured_ = DriveJoints::Zero();
  DriveJoints expected_ = DriveJoints::Zero();  ///< where a drive that lags as stated is
  double away_ = 0;                             ///< [s] that the drive has been elsewhere
  double period_ = 0;
};

}  // namespace surg
