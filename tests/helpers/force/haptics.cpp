// surg_teleop::PassivityChannel and HapticFeedback for ctypes: see haptics.py beside this file.
#include "haptics.hpp"

#include <algorithm>

using surg_teleop::HapticFeedback;
using surg_teleop::PassivityChannel;

extern "C" {

PassivityChannel* channel_new(double damping, double force) {
  return new PassivityChannel(damping, force);
}
double channel_step(PassivityChannel* channel, double wanted, double position, double dt) {
  return channel->step(wanted, position, dt);
}
double channel_energy(const PassivityChannel* channel) { return channel->energy(); }

HapticFeedback* feedback_new(double scale, double max_force, double max_rate) {
  surg_teleop::HapticLimits limits;
  limits.scale = scale;
  limits.max_force = max_force;
  limits.max_rate = max_rate;
  return new HapticFeedback(limits);
}
void feedback_step(HapticFeedback* feedback, const double* force, double age, const double* place,
                   bool allowed, double dt, double* out) {
  const Eigen::Vector3d felt =
      feedback->step(Eigen::Map<const Eigen::Vector3d>(force), age,
                     Eigen::Map<const Eigen::Vector3d>(place), allowed, dt);
  std::copy_n(felt.data(), 3, out);
}
double feedback_energy(const HapticFeedback* feedback, int axis) { return feedback->energy(axis); }
double feedback_gate(const HapticFeedback* feedback) { return feedback->gate(); }
}
