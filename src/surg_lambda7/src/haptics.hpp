// Force feedback to a hand: faded, limited, and passive. No ROS, no clock. A measured force passes,
// in this order: a limit of its size, a limit of its rate, a gate that fades to zero when anything
// is silent or not allowed, and a passivity controller for each axis, which has the last word.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <limits>

namespace surg_teleop {

/// One axis of a force that is fed back. Time-domain passivity observer and controller after
/// Hannaford and Ryu, IEEE Transactions on Robotics and Automation 18(1), 2002, one step ahead.
///
/// The hand sees a force that answers its own position late; such a loop can give out more energy
/// than it took in, and then it swings. The observer counts the energy that the hand has put in,
/// exactly, since the force is constant between two samples: E(n) = sum of -f(k - 1) (x(k) - x(k -
/// 1)). The controller adds damping whenever the next step would take more than is there. While the
/// force gives out energy that is not there, its share falls; it comes back slowly. Below a floor
/// it gives out none at all. Damping alone would switch the force at every sign of a small,
/// quantised speed, and that noise carries energy, too.
class PassivityChannel {
 public:
  /// Largest damping [N s/m] and largest force [N] that are given out.
  PassivityChannel(double largest_damping, double largest_force)
      : largest_damping_(largest_damping), largest_force_(largest_force) {}

  /// The force that may be given out until the next step [N], of a wanted one [N] at a place of the
  /// hand [m]; dt [s] is the time since the last step.
  double step(double wanted, double position, double dt);

  /// Gives out nothing until the next step; energy is not kept, debt is.
  void rest(double position);

  /// That the hand has put in [J].
  double energy() const { return energy_; }

 private:
  double largest_damping_;
  double largest_force_;
  double energy_ = 0.0;
  double position_ = std::numeric_limits<double>::quiet_NaN();  // before the first step
  double force_ = 0.0;
  double share_ = 1.0;
};

/// What a hand may feel.
struct HapticLimits {
  double scale = 1.0;           ///< force on the hand over force at the tip
  double max_force = 5.0;       ///< [N] on the hand
  double max_rate = 200.0;      ///< [N/s] growth or turn of that force
  double silent_after = 0.020;  ///< [s] age of a silent measurement; ends with fade_out within 0.05
  double fade_out = 0.025;      ///< [s] from all to nothing
  double fade_in = 0.5;         ///< [s] and back
  double damping = 30.0;        ///< [N s/m] largest of the passivity controller
};

/// The force on one hand. It begins faded out.
class HapticFeedback {
 public:
  explicit HapticFeedback(const HapticLimits& limits);

  /// Forgets everything: no force, no energy.
  void reset();

  /// The force on the hand until the next step [N], in the frame of the inputs: the newest force of
  /// the world on the tip [N], its age [s], the hand's place [m], whether feedback is switched on,
  /// engaged and not paused, and the time since the last step [s].
  Eigen::Vector3d step(const Eigen::Vector3d& force, double age, const Eigen::Vector3d& position,
                       bool allowed, double dt);

  /// That the hand has put into an axis [J].
  double energy(std::size_t axis) const { return axes_[axis].energy(); }

  /// Share of the force that is let through, 0 to 1.
  double gate() const { return gate_; }

 private:
  HapticLimits limits_;
  std::array<PassivityChannel, 3> axes_;
  Eigen::Vector3d smooth_ = Eigen::Vector3d::Zero();
  double gate_ = 0.0;
};

}  // namespace surg_teleop
