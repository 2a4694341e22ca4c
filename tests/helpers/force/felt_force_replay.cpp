// Runs surg_teleop::FeltForce on the times of its input. Each line has a word and the time [s]:
// `take` with a force on the tip (3) and whether it may be felt (0 or 1), or `step` with the
// handle's place (3), for which the output has a line with the force on the handle (3).
#include <cstdio>
#include <cstring>

#include "felt_force.hpp"

int main() {
  surg_teleop::FeltForce felt(surg_teleop::HapticLimits(), Eigen::Matrix3d::Identity());
  char word[8];
  double now;
  Eigen::Vector3d v;
  while (std::scanf("%7s %lf %lf %lf %lf", word, &now, &v[0], &v[1], &v[2]) == 5) {
    if (std::strcmp(word, "take") == 0) {
      int allowed;
      if (std::scanf("%d", &allowed) != 1) return 1;
      felt.take(v, allowed != 0, now);
    } else {
      const Eigen::Vector3d out = felt.step(v, now);
      std::printf("%.17g %.17g %.17g\n", out[0], out[1], out[2]);
    }
  }
  return 0;
}
