// A stand-in for the Force Dimension library: what a test writes into a shared file is what the
// device says, and what is commanded is what the test reads there. Built by the test.
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>

namespace {

// Mirrored field by field in tests/helpers/teleop/lambda7.py.
struct State {
  double p[3];
  double R[9];
  double gripper;
  double force[7];
  double max_force;
  char error[128];
  std::int64_t poses;   // readings asked for
  std::int64_t forces;  // forces commanded
  std::int64_t nonzero_forces;
  std::int32_t present, left_handed, wrist, has_gripper, initialised, init_works;
  std::int32_t fail_pose, fail_gripper, fail_force;  // 1: the call returns -1
  std::int32_t old;                                  // 1: every pose is that of before
  std::uint32_t buttons;
  std::int32_t n_calls;
  std::int32_t calls[64];  // first letters of what was called, without the cycle's own
};

State* state() {
  static State* shared = [] {
    const char* path = std::getenv("LAMBDA7_STUB");
    const int fd = open(path, O_RDWR);
    void* memory = mmap(nullptr, sizeof(State), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    return static_cast<State*>(memory);
  }();
  return shared;
}

void note(char what) {
  if (state()->n_calls < 64) state()->calls[state()->n_calls++] = what;
}

}  // namespace

extern "C" {

int drdOpen() {
  note('o');
  return state()->present ? 0 : -1;
}
int drdOpenID(signed char id) {
  note('O');
  return state()->present && id == 0 ? 0 : -1;
}
int drdClose(signed char) {
  note('c');
  return 0;
}
int drdStop(bool keep_forces, signed char) {
  note(keep_forces ? 'S' : 's');
  return 0;
}
bool drdIsInitialized(signed char) { return state()->initialised != 0; }
int drdAutoInit(signed char) {
  note('i');
  if (!state()->init_works) return -1;
  state()->initialised = 1;
  return 0;
}
bool dhdHasWrist(signed char) {
  note('w');
  return state()->wrist != 0;
}
bool dhdHasGripper(signed char) {
  note('g');
  return state()->has_gripper != 0;
}
bool dhdIsLeftHanded(signed char) {
  note('l');
  return state()->left_handed != 0;
}
int dhdSetGravityCompensation(int on, signed char) {
  note(on ? 'G' : 'x');
  return 0;
}
int dhdSetMaxForce(double limit, signed char) {
  note('m');
  state()->max_force = limit;
  return 0;
}
int dhdEnableForce(unsigned char on, signed char) {
  note(on ? 'F' : 'f');
  return 0;
}
int dhdGetPositionAndOrientationFrame(double* x, double* y, double* z, double (*R)[3],
                                      signed char) {
  State* s = state();
  ++s->poses;
  if (s->fail_pose || !s->present) return -1;
  *x = s->p[0];
  *y = s->p[1];
  *z = s->p[2];
  std::memcpy(R, s->R, sizeof s->R);
  return s->old ? 1 : 0;
}
int dhdGetGripperAngleRad(double* angle, signed char) {
  *angle = state()->gripper;
  return state()->fail_gripper ? -1 : 0;
}
unsigned int dhdGetButtonMask(signed char) { return state()->buttons; }
int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty,
                                        double tz, double grip, signed char) {
  State* s = state();
  const double force[7] = {fx, fy, fz, tx, ty, tz, grip};
  ++s->forces;
  for (int i = 0; i < 7; ++i) {
    s->force[i] = force[i];
    s->nonzero_forces += force[i] != 0.0;
  }
  return s->fail_force ? -1 : 0;
}
const char* dhdErrorGetLastStr() { return state()->error; }
const char* dhdGetSystemName(signed char) { return "Lambda.7"; }
}
