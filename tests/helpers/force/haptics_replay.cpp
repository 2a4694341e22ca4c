// Steps surg_teleop::HapticFeedback: each line of the input has the force (3), its age, the hand's
// place (3), allowed (0 or 1) and dt; each line of the output has the force on the hand (3).
#include <cstdio>

#include "haptics.hpp"

int main(int argc, char** argv) {
  surg_teleop::HapticLimits limits;
  if (argc == 3) {
    std::sscanf(argv[1], "%lf", &limits.max_force);
    std::sscanf(argv[2], "%lf", &limits.scale);
  }
  surg_teleop::HapticFeedback feedback(limits);
  Eigen::Vector3d force, position;
  double age, dt;
  int allowed;
  while (std::scanf("%lf %lf %lf %lf %lf %lf %lf %d %lf", &force[0], &force[1], &force[2], &age,
                    &position[0], &position[1], &position[2], &allowed, &dt) == 9) {
    const Eigen::Vector3d out = feedback.step(force, age, position, allowed != 0, dt);
    std::printf("%.17g %.17g %.17g\n", out[0], out[1], out[2]);
  }
  return 0;
}
