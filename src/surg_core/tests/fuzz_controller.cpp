// Random life against a simple plant, judged by oracles that do not use the code they judge:
//   fuzz_controller [--seed N] [--runs N] [--cycles N]
// Every run is an arm, a tool, a plant and a law drawn from its seed, and 'cycles' control cycles
// of commands of every kind, finite or not, with faults in between. On a failure it prints the seed
// and the command line that shows the same again. SURG_TEST_FULL=1: 1.2 million cycles.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <limits>
#include <random>
#include <string>

#include "support/results.hpp"
#include "support/test_arm.hpp"
#include "surg_core/controller.hpp"
#include "surg_core/law/exact_follower.hpp"

namespace surg {
namespace {

constexpr double kT = 0.002;
constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// --- random numbers, the same everywhere --------------------------------------------------------

class Dice {
 public:
  explicit Dice(std::uint64_t seed) : engine_(seed * 0x9E3779B97F4A7C15ULL + 1) {}
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
  }
  int integer(int low, int high) {
    return low + static_cast<int>(engine_() % static_cast<std::uint64_t>(high - low + 1));
  }
  bool one_in(int n) { return integer(1, n) == 1; }
  Vector3 vector(double size) {
    return {uniform(-size, size), uniform(-size, size), uniform(-size, size)};
  }

 private:
  std::mt19937_64 engine_;
};

// --- kinematics of its own: Denavit-Hartenberg matrices, columns of the Jacobian from the axes
// -----

struct Flange {
  Eigen::Matrix4d X = Eigen::Matrix4d::Identity();
  Eigen::Matrix<double, 6, 6> J;
};

Flange flange(const JointVector& q) {
  const double d[6] = {0.1625, 0, 0, 0.1333, 0.0997, 0.0996}, a[6] = {0, -0.425, -0.3922, 0, 0, 0},
               alpha[6] = {M_PI_2, 0, 0, M_PI_2, -M_PI_2, 0};
  Flange out;
  Vector3 z[6], o[6];
  for (int i = 0; i < 6; ++i) {
    z[i] = out.X.block<3, 1>(0, 2);
    o[i] = out.X.block<3, 1>(0, 3);
    const double ct = std::cos(q[i]), st = std::sin(q[i]), ca = std::cos(alpha[i]),
                 sa = std::sin(alpha[i]);
    Eigen::Matrix4d A;
    A << ct, -st * ca, st * sa, a[i] * ct, st, ct * ca, -ct * sa, a[i] * st, 0, sa, ca, d[i], 0, 0,
        0, 1;
    out.X = out.X * A;
  }
  const Vector3 p = out.X.block<3, 1>(0, 3);
  for (int i = 0; i < 6; ++i) {
    out.J.block<3, 1>(0, i) = z[i].cross(Vector3(p - o[i]));
    out.J.block<3, 1>(3, i) = z[i];
  }
  return out;
}

/// What the instrument does at q with joint velocities qd, by the matrices above.
struct Truth {
  Vector3 p_tip, s, v_tip;
  double depth, pivot_error, flange_speed;
};

Truth truth(const JointVector& q, const JointVector& qd, const ToolCalibration& tool,
            const Vector3& p_rcm) {
  const Flange at = flange(q);
  const Matrix3 R = at.X.block<3, 3>(0, 0);
  const Vector3 p = at.X.block<3, 1>(0, 3);
  const Vector6 twist = at.J * Vector6(qd);
  Truth out;
  out.s = R * tool.s_F;
  out.p_tip = p + R * tool.p_FTip;
  out.v_tip = twist.head<3>() + twist.tail<3>().cross(Vector3(R * tool.p_FTip));
  out.depth = out.s.dot(out.p_tip - p_rcm);
  out.pivot_error = (p_rcm - out.p_tip).cross(out.s).norm();
  out.flange_speed = twist.head<3>().norm();
  return out;
}

// --- what is allowed
// ---------------------------------------------------------------------------------

/// The plant of a run: it answers at once; or late, and the controller knows how late, or does not
/// ('link_lag' 0: nobody has measured it).
enum Plant { kIdeal, kLagKnown, kLagUnknown };
constexpr const char* kPlants[] = {"ideal plant", "lag known", "lag not known"};

/// [m] off the trocar while ENABLED, beyond where it began. With an unknown lag the fault level is
/// all that there is: what the joints cannot brake, the follower cannot put right in time.
constexpr double kPivot[] = {1e-4, 3e-4, 2e-3};
/// [m/s] of the tip besides set-point and follow-up, not tracked and tracked, and as a share of the
/// set-point's speed.
constexpr double kTip[][2] = {{3e-4, 2e-3}, {3e-4, 2e-3}, {5e-4, 2e-3}};
constexpr double kTipShare[] = {0.01, 0.01, 0.02};
/// [m/s] against a force above the soft limit, not tracked and tracked: a shaft that turns about a
/// moving trocar moves its tip.
constexpr double kIntoForce[][2] = {{2e-4, 1.5e-2}, {2e-4, 1.5e-2}, {5e-3, 1.5e-2}};
constexpr double kLag = 0.012;  // [s] of the lagging plant: two periods of delay, 8 ms first order
constexpr double kBend = 0.2;   // of what the tip's velocity changes over the lag
/// A stop may take the braking distance, what the set-point was ahead, this long [s] at the speed
/// it began with, and this far [m].
constexpr double kStopDelay[] = {0.01, 0.04, 0.04}, kStopSlack = 1e-3;

// --- figures over all runs
// --------------------------------------------------------------------------

struct Figures {
  long cycles = 0, enabled = 0, moving = 0, tip_checked = 0, accepted = 0, refused = 0, faults = 0;
  long stops = 0;
  long late = 0, gaps = 0, dead_man = 0, ramps = 0, measured = 0;
  double worst_measured = 0;  // of the arm, ratio to the limit
  double worst_flange = 0;    // [m/s] commanded
  double worst_stop[3] = {};  // share of the bound, by plant
  // By plant, and whether the trocar is tracked.
  double worst_pivot[3][2] = {};         // [m] ENABLED, beyond where it began
  double worst_tip_velocity[3][2] = {};  // [m/s] residual of the oracle
  double worst_into_force[3][2] = {};    // [m/s]
};

struct Failure {
  std::string oracle, text;
};

template <typename... T>
std::string text(const char* format, T... values) {
  char buffer[400];
  std::snprintf(buffer, sizeof buffer, format, values...);
  return buffer;
}

// --- one run
// ----------------------------------------------------------------------------------------

class Run {
 public:
  Run(std::uint64_t seed, Figures& figures)
      : dice_(seed),
        figures_(figures),
        lagging_(dice_.one_in(3)),
        robot_(robot()),
        tool_(tool()),
        options_(options()),
        controller_(test::ur5e_chain(), robot_, robot_.limits, test::instrument(), tool_,
                    options_) {
    q_ = robot_.home;
    if (dice_.one_in(2)) {
      for (int i = 0; i < 6; ++i) q_[i] += dice_.uniform(-0.2, 0.2);
    }
    qd_ = last_ = JointVector::Zero(6);
    tighten_joints();
    pipeline_.assign(lagging_ ? 2 : 0, qd_);
    const int timing = dice_.integer(0, 9);
    timing_ = timing < 5 ? kOnTime : timing < 7 ? kSomeLate : timing < 9 ? kDrawn : kFreezes;
    dead_man_ = dice_.one_in(2) ? 10 : 50;
    const Truth at = truth(q_, qd_, tool_, Vector3::Zero());
    p_taught_ = at.p_tip - dice_.uniform(0.06, 0.16) * at.s;
    p_rcm_ = p_taught_;
  }

  /// One cycle; an empty oracle is a pass.
  Failure cycle() {
    ++k_;
    between();
    Inputs in = sense();
    command(in);
    const Outputs& out = controller_.step(in);
    const Failure failure = judge(in, out);
    before_ = out;
    had_before_ = true;
    const Failure harder = plant(out);
    return failure.oracle.empty() ? harder : failure;
  }

 private:
  // --- what is drawn
  // -------------------------------------------------------------------------------

  RobotConfig robot() {
    return test::robot_behind(test::good_robot(), lagging_ && dice_.one_in(2) ? 0.012 : 0.0);
  }

  ToolCalibration tool() {
    ToolCalibration tool = test::offset_tool();
    if (dice_.one_in(3)) tool.p_FTip.x() = 0;
    if (dice_.one_in(3)) {
      const Vector3 axis = Vector3(dice_.uniform(-1, 1), dice_.uniform(-1, 1), 0).normalized();
      const Matrix3 R = Eigen::AngleAxisd(dice_.uniform(0, 0.17), axis).toRotationMatrix();
      tool.s_F = R * tool.s_F;
      tool.p_FTip = Vector3(tool.p_FTip.x(), 0, 0) + 0.3 * tool.s_F;
    }
    return tool;
  }

  Controller::Options options() {
    Controller::Options options;
    options.dt = kT;
    const int law = dice_.integer(0, 9);
    options.law = law == 0 ? Law::kPaper : law < 4 ? Law::kExact : Law::kVelocity;
    options.track_rcm = dice_.one_in(4);  // and on time
    return options;
  }

  /// Sometimes a joint's limit is close by.
  void tighten_joints() {
    if (!dice_.one_in(4)) return;
    const int i = dice_.integer(0, 5);
    if (dice_.one_in(2)) {
      robot_.position_max[i] = q_[i] + dice_.uniform(0.02, 0.2);
    } else {
      robot_.position_min[i] = q_[i] - dice_.uniform(0.02, 0.2);
    }
    controller_.~Controller();
    new (&controller_)
        Controller(test::ur5e_chain(), robot_, robot_.limits, test::instrument(), tool_, options_);
  }

  /// Periods until the next cycle.
  int periods() {
    switch (timing_) {
      case kOnTime:
        return 1;
      case kSomeLate:
        return dice_.one_in(100) ? dice_.integer(2, 20) : 1;
      case kDrawn:
        return dice_.integer(1, dice_.one_in(3) ? 5 : 2);
      case kFreezes:
        return dice_.one_in(300) ? dice_.integer(2, 200) : 1;
    }
    return 1;
  }

  // --- calls between the steps
  // -----------------------------------------------------------------------

  void between() {
    called_ = false;
    enabled_by_request_ = false;
    if (k_ == 1) controller_.set_rcm(p_taught_);
    if (k_ == 3) request(StateCommand::kHome);
    if (k_ == 4) request(StateCommand::kEnable);
    if (k_ < 5) return;
    const bool idle = had_before_ && before_.state != State::kEnabled;
    if (idle && dice_.one_in(25)) {
      request(before_.state == State::kPaused ? StateCommand::kResume : StateCommand::kEnable);
    }
    if (idle && dice_.one_in(60)) request(StateCommand::kHome);
    const bool in_ramp = idle && before_.qd_command.norm() > 1e-3;
    if (dice_.one_in(in_ramp ? 8 : 400)) request(static_cast<StateCommand>(dice_.integer(0, 5)));
    if (in_ramp && dice_.one_in(8)) teach();
    if (dice_.one_in(1500)) {
      controller_.pause(Reason::kOverrun);
      called_ = true;
    }
    if (dice_.one_in(3000)) {
      controller_.fault(Reason::kMasterLost);
      called_ = true;
    }
    if (dice_.one_in(1000)) controller_.claim(static_cast<std::uint32_t>(dice_.integer(1, 3)));
    if (dice_.one_in(700)) teach();
  }

  void request(StateCommand command) {
    const Reason answer = controller_.request(command);
    called_ = true;
    const bool enables = command == StateCommand::kEnable || command == StateCommand::kResume;
    if (answer == Reason::kNone && enables) enabled_by_request_ = true;
  }

  void teach() {
    Vector3 p = p_rcm_;
    switch (dice_.integer(0, 4)) {
      case 0:
        p[dice_.integer(0, 2)] = poison();
        break;
      case 1:
        p += dice_.vector(0.1);
        break;
      default: {  // on the shaft, as a careful user would
        const Truth at = truth(q_, qd_, tool_, p_rcm_);
        p = at.p_tip - dice_.uniform(0.05, 0.15) * at.s;
      }
    }
    if (controller_.set_rcm(p) == Reason::kNone) p_rcm_ = p_taught_ = p;
    called_ = true;
  }

  // --- the link
  // ----------------------------------------------------------------------------------------

  double poison() {
    const double values[] = {kNan, kInf, -kInf, 1e308, -1e308, 1e200, 5e-324};
    return values[dice_.integer(0, 6)];
  }

  Inputs sense() {
    Inputs in;
    in.state_valid = true;
    in.elapsed = elapsed_ * kT;
    in.q = measured();
    in.qd = qd_;
    in.jaw = jaw_;
    blind_ = false;
    tool_blind_ = false;
    if (blind_for_ > 0) {
      --blind_for_;
      in.state_age = robot_.tuning.link_timeout + kT;
      blind_ = true;
    } else if (dice_.one_in(2500)) {
      blind_ = true;
      switch (dice_.integer(0, 5)) {
        case 0:
          in.state_valid = false;
          break;
        case 1:
          in.q[dice_.integer(0, 5)] = dice_.one_in(2) ? kNan : kInf;
          break;
        case 2:
          in.qd[dice_.integer(0, 5)] = dice_.one_in(2) ? kNan : -kInf;
          break;
        case 3:
          in.q = JointVector::Zero(dice_.one_in(2) ? 5 : 7);
          break;
        case 4:
          in.state_age = kNan;
          break;
        default:
          in.state_age = robot_.tuning.link_timeout + kT;
          blind_for_ = dice_.integer(0, 50);
      }
    }
    if (tool_blind_for_ > 0 || dice_.one_in(3000)) {
      tool_blind_for_ = tool_blind_for_ > 0 ? tool_blind_for_ - 1 : dice_.integer(1, 100);
      in.jaw_age = dice_.one_in(5) ? kNan : 0.3;
      tool_blind_ = true;
    }
    if (dice_.one_in(500)) in.jaw = poison();
    sense_forces(in);
    if (options_.track_rcm && timing_ == kOnTime) track(in);
    return in;
  }

  /// F25: now and then a contact, sometimes a hard one or a broken sensor.
  void sense_forces(Inputs& in) {
    if (push_for_ == 0 && dice_.one_in(1500)) {
      push_for_ = dice_.integer(1, 120);
      push_ = dice_.uniform(1, 7) * dice_.vector(1).normalized();
    }
    in.tip_force.valid = !dice_.one_in(1000);
    if (push_for_ > 0) {
      --push_for_;
      in.tip_force.f_B = push_;
    }
    if (dice_.one_in(5000)) in.tip_force.f_B = dice_.one_in(2) ? push_ * kNan : Vector3(9, 0, 0);
    if (dice_.one_in(5000)) {
      in.trocar_force = {true, dice_.one_in(2) ? Vector3(0, kInf, 0) : Vector3(0, 0, 20)};
    }
    const Vector3& f = in.tip_force.f_B;
    force_halt_ = (in.tip_force.valid && !(f.norm() <= robot_.limits.tip_force_hard)) ||
                  (in.trocar_force.valid && !in.trocar_force.f_B.allFinite());
  }

  JointVector measured() const {
    if (!lagging_) return q_;
    JointVector q = q_;
    for (int i = 0; i < 6; ++i) q[i] = 1e-5 * std::round(q[i] / 1e-5);
    return q;
  }

  /// A breathing trocar, sampled at 50 Hz; sometimes silent, far off or not a number.
  void track(Inputs& in) {
    const double w = 2 * M_PI * 0.25, size = 0.003;
    p_rcm_ = p_taught_ + Vector3(0, 0, size * (1 - std::cos(w * k_ * kT)) / 2);
    in.track_valid = true;
    in.track_age = kT * (k_ % 10);
    const double then = w * kT * (k_ - k_ % 10);
    in.p_BTrack = p_taught_ + Vector3(0, 0, size * (1 - std::cos(then)) / 2);
    in.v_BTrack = Vector3(0, 0, size * w * std::sin(then) / 2);
    if (!dice_.one_in(4000)) return;
    switch (dice_.integer(0, 3)) {
      case 0:
        in.track_age = 1;
        break;
      case 1:
        in.p_BTrack += Vector3(0.05, 0, 0);
        break;
      case 2:
        in.v_BTrack.x() = poison();
        break;
      default:
        in.p_BTrack.y() = poison();
    }
  }

  /// The arm's own time until the next cycle, and how hard it accelerates in it.
  Failure plant(const Outputs& out) {
    // A late cycle makes up for the time in which a fade could not be sent.
    if ((blind_ || force_halt_) && timing_ != kOnTime) faded_late_for_ = 50;
    elapsed_ = periods();
    figures_.late += elapsed_ > 2;
    figures_.gaps += elapsed_ > 5;
    figures_.ramps += called_ && before_.state != State::kEnabled && qd_.norm() > 1e-3;
    double hardest = 0;
    for (int i = 0; i < elapsed_; ++i) {
      const JointVector before = qd_;
      plant_period(out, i);
      for (int j = 0; j < 6; ++j) {
        const double change = std::abs(qd_[j] - before[j]) / (robot_.acceleration[j] * kT);
        hardest = std::max(hardest, change);
      }
    }
    if (std::isfinite(out.jaw_set)) jaw_ += 0.3 * (out.jaw_set - jaw_);
    last_ = out.qd_command;
    if (options_.law == Law::kPaper) return {};
    faded_late_for_ = std::max(faded_late_for_ - elapsed_, 0);
    if (faded_late_for_ > 0) return {};
    ++figures_.measured;
    figures_.worst_measured = std::max(figures_.worst_measured, hardest);
    if (hardest <= 1 + 1e-6) return {};
    return {"measured acceleration", text("%.4g times the limit, %d periods", hardest, elapsed_)};
  }

  void plant_period(const Outputs& out, int silent) {
    JointVector wanted = out.qd_command;
    if (silent >= dead_man_) {  // the link stops the arm by itself
      figures_.dead_man += silent == dead_man_;
      const JointVector most = kT * robot_.acceleration;
      wanted = obeyed_ - obeyed_.cwiseMax(-most).cwiseMin(most);
      for (JointVector& waiting : pipeline_) waiting = wanted;
    } else if (!pipeline_.empty()) {
      pipeline_.push_back(wanted);
      wanted = pipeline_.front();
      pipeline_.pop_front();
    }
    obeyed_ = wanted;
    if (lagging_) wanted = qd_ + (1 - std::exp(-kT / 0.008)) * (wanted - qd_);
    q_ += kT * 0.5 * (lagging_ ? JointVector(qd_ + wanted) : JointVector(2 * wanted));
    qd_ = wanted;
  }

  // --- commands
  // ------------------------------------------------------------------------------------------

  void command(Inputs& in) {
    if (k_ < 5 || !had_before_) return;
    if (phase_-- <= 0) new_phase();
    const bool stream = is_servo(kind_);
    if ((stream && k_ % every_ == 0) || (!stream && phase_ == 0)) add(in, next_command());
    if (dice_.one_in(300)) add(in, wild_command());
    if (dice_.one_in(100)) {
      MotionCommand jaw;
      jaw.motion = dice_.one_in(2) ? Motion::kJawServoJp : Motion::kJawMoveJp;
      jaw.source = source_;
      jaw.jaw = dice_.uniform(-0.5, 1.5);
      add(in, jaw);
    }
    if (dice_.one_in(5000)) {
      while (in.n_commands < kMaxCommands) add(in, wild_command());
    }
    if (dice_.one_in(5000)) in.n_commands = dice_.one_in(2) ? -5 : 1000;
  }

  void add(Inputs& in, const MotionCommand& command) {
    if (in.n_commands < kMaxCommands) in.commands[in.n_commands++] = command;
  }

  void new_phase() {
    const Motion kinds[] = {Motion::kServoCp, Motion::kServoCp,       Motion::kServoJp,
                            Motion::kServoCv, Motion::kServoCv,       Motion::kServoJv,
                            Motion::kServoJr, Motion::kInterpolateCp, Motion::kMoveCp,
                            Motion::kMoveCp,  Motion::kMoveJp,        Motion::kMoveJr,
                            Motion::kHold,    Motion::kInterpolateJp, Motion::kNone,
                            Motion::kInsert,  Motion::kWithdraw,      Motion::kRetrace};
    kind_ = kinds[dice_.integer(0, dice_.one_in(4) ? 17 : 14)];
    const bool out_of_patient = before_.depth < robot_.limits.depth_slow - 1e-3;
    if (out_of_patient && dice_.one_in(2)) kind_ = Motion::kInsert;
    const int rates[] = {1, 1, 5, 17};
    every_ = rates[dice_.integer(0, 3)];
    phase_ = is_servo(kind_) ? dice_.integer(50, 700) : dice_.integer(1, 400);
    if (dice_.one_in(6)) source_ = static_cast<std::uint32_t>(dice_.integer(1, 3));
    const double speed = dice_.one_in(4) ? 0.3 : 0.08;
    v_ = dice_.vector(speed);
    roll_rate_ = dice_.uniform(-1.5, 1.5);
    goal_ = p_RSet();
    roll_goal_ = before_.roll_set;
    rates_ = Vector4(dice_.uniform(-1, 1), dice_.uniform(-1, 1), dice_.uniform(-0.1, 0.1),
                     dice_.uniform(-1, 1));
  }

  Vector3 p_RSet() const { return controller_.X_BR().inverse() * before_.p_set; }

  MotionCommand next_command() {
    MotionCommand command;
    command.motion = kind_;
    command.source = source_;
    const double dt = every_ * kT;
    if (dice_.one_in(40)) v_ = dice_.vector(0.12);
    goal_ += dt * v_;
    // Stay in the neighbourhood: a source turns round where it would leave it.
    const Vector3 middle(0, 0, 0.11);
    if ((goal_ - middle).norm() > 0.07) v_ = -v_.norm() * (goal_ - middle).normalized();
    roll_goal_ += dt * roll_rate_;
    if (std::abs(roll_goal_) > 1) roll_rate_ = -std::copysign(std::abs(roll_rate_), roll_goal_);
    const bool discrete = !is_servo(kind_);
    const Vector3 p = discrete ? Vector3(middle + dice_.vector(0.06)) : goal_;
    const Eigen::Vector2d angles = shaft_angles(p.normalized());
    command.p = kind_ == Motion::kServoCv ? v_ : p;
    command.roll_rate = roll_rate_;
    command.rotation =
        controller_.tool_orientation(controller_.X_BR().linear() * p.normalized(), roll_goal_);
    command.joints = Vector4(angles[0], angles[1], p.norm(), roll_goal_);
    if (kind_ == Motion::kServoJv) command.joints = rates_;
    if (kind_ == Motion::kServoJr) command.joints = dt * 0.3 * rates_;
    if (kind_ == Motion::kMoveJr) command.joints = 0.2 * rates_;
    return command;
  }

  /// Nobody's idea of a sensible command.
  MotionCommand wild_command() {
    MotionCommand command;
    command.motion =
        static_cast<Motion>(dice_.one_in(20) ? dice_.integer(17, 255) : dice_.integer(0, 16));
    command.source = static_cast<std::uint32_t>(dice_.integer(0, 3));
    const double size = std::pow(10.0, dice_.uniform(-3, 2));
    command.p = dice_.vector(size);
    command.joints = Vector4(dice_.uniform(-size, size), dice_.uniform(-size, size),
                             dice_.uniform(-size, size), dice_.uniform(-size, size));
    command.roll_rate = dice_.uniform(-size, size);
    command.jaw = dice_.uniform(-size, size);
    command.rotation.coeffs() = Vector4(dice_.uniform(-1, 1), dice_.uniform(-1, 1),
                                        dice_.uniform(-1, 1), dice_.uniform(-1, 1));
    switch (dice_.integer(0, 9)) {
      case 0:
        command.p[dice_.integer(0, 2)] = poison();
        break;
      case 1:
        command.joints[dice_.integer(0, 3)] = poison();
        break;
      case 2:
        command.roll_rate = poison();
        break;
      case 3:
        command.jaw = poison();
        break;
      case 4:
        command.rotation.coeffs()[dice_.integer(0, 3)] = poison();
        break;
      case 5:
        command.rotation.coeffs().setZero();
        break;
      default:
        break;
    }
    return command;
  }

  // --- oracles
  // -------------------------------------------------------------------------------------------

  Failure judge(const Inputs& in, const Outputs& out) {
    count(in, out);
    for (const auto& oracle :
         {&Run::finite, &Run::bookkeeping, &Run::states, &Run::joints, &Run::stillness, &Run::pivot,
          &Run::tip_velocity, &Run::workspace, &Run::stopping, &Run::jaw}) {
      Failure failure = (this->*oracle)(in, out);
      if (!failure.oracle.empty()) return failure;
    }
    return {};
  }

  void count(const Inputs& in, const Outputs& out) {
    ++figures_.cycles;
    figures_.enabled += out.state == State::kEnabled;
    figures_.moving += out.qd_command.size() == 6 && out.qd_command.norm() > 1e-4;
    figures_.faults += out.state == State::kFault && before_.state != State::kFault;
    for (int i = 0; i < out.n_verdicts; ++i) {
      const bool accepted = out.verdicts[i].reason == Reason::kNone;
      ++(accepted ? figures_.accepted : figures_.refused);
      if (!accepted) continue;
      const Motion motion = out.verdicts[i].motion;
      // After 'insert' the arm rests on its line until something else moves it.
      if (motion == Motion::kInsert || motion == Motion::kWithdraw) {
        axial_ = true;
      } else if (!is_jaw(motion) && motion != Motion::kHold && motion != Motion::kRetrace) {
        axial_ = false;
      }
    }
    at_ = truth(measured(), out.qd_command.size() == 6 ? out.qd_command : last_, tool_, p_rcm_);
    v_slow_ += std::min(1.0, robot_.tuning.rcm_gain * kT) * (out.v_set - v_slow_);
    (void)in;
  }

  Failure finite(const Inputs&, const Outputs& out) {
    if (out.qd_command.size() != 6) return {"finite", "qd_command has a wrong size"};
    const std::pair<const char*, bool> fields[] = {
        {"qd_command", out.qd_command.allFinite()},
        {"twist_command", out.twist_command.allFinite()},
        {"X_BF", out.X_BF.matrix().allFinite()},
        {"p_BTip", out.p_BTip.allFinite() && out.s_B.allFinite() && out.v_BTip.allFinite()},
        {"p_BRcm", out.p_BRcm.allFinite()},
        {"p_set", out.p_set.allFinite() && out.v_set.allFinite() && std::isfinite(out.roll_set)},
        {"goal", out.p_goal.allFinite() && std::isfinite(out.roll_goal)},
        {"roll", std::isfinite(out.roll)},
        {"depth", std::isfinite(out.depth) && std::isfinite(out.rcm_error)},
        {"virtual_q", out.virtual_q.allFinite()},
        {"virtual_qd", out.virtual_qd.allFinite()},
        {"virtual_set", out.virtual_set.allFinite()},
        {"scale", std::isfinite(out.scale) && out.limited_by != nullptr}};
    for (const auto& [field, good] : fields) {
      if (!good) return {"finite", text("%s is not finite, law %d", field, int(options_.law))};
    }
    return {};
  }

  Failure bookkeeping(const Inputs& in, const Outputs& out) {
    const int n = std::clamp(in.n_commands, 0, kMaxCommands);
    if (out.n_verdicts != n) return {"verdicts", "not one verdict per command"};
    const std::uint32_t handled = out.accepted + out.refused;
    if (had_before_ && handled - before_.accepted - before_.refused != std::uint32_t(n)) {
      return {"verdicts", "accepted and refused do not add up"};
    }
    std::uint32_t holder = 0;
    for (int i = 0; i < n; ++i) {
      const Verdict& verdict = out.verdicts[i];
      const MotionCommand& command = in.commands[i];
      if (verdict.reason != Reason::kNone || verdict.motion == Motion::kHold) continue;
      if (holder != 0 && verdict.source != holder) {
        return {"authority", "two senders were obeyed in one cycle"};
      }
      holder = verdict.source;
      const bool numbers = command.p.allFinite() && command.joints.allFinite() &&
                           command.rotation.coeffs().allFinite() && std::isfinite(command.jaw) &&
                           std::isfinite(command.roll_rate);
      if (!numbers) return {"gate", "a command that is not finite was accepted"};
      if (static_cast<int>(command.motion) > 16) {
        return {"gate", text("unknown motion %d was accepted", static_cast<int>(command.motion))};
      }
    }
    return {};
  }

  Failure states(const Inputs&, const Outputs& out) {
    const bool enabled = out.state == State::kEnabled;
    if (enabled && had_before_ && before_.state != State::kEnabled && !enabled_by_request_) {
      return {"state", "ENABLED without being asked"};
    }
    if (!had_before_ && enabled) return {"state", "ENABLED at the start"};
    if (enabled && blind_) return {"state", "ENABLED without a joint state"};
    return {};
  }

  Failure joints(const Inputs& in, const Outputs& out) {
    if (options_.law == Law::kPaper) return {};  // open loop, for comparison in simulation only
    double& excess = excess_;
    excess = 0;
    for (int i = 0; i < 6; ++i) {
      const double qd = out.qd_command[i];
      if (!(std::abs(qd) <= robot_.velocity[i] * (1 + 1e-9))) {
        return {"joint velocity", text("joint %d: %.6g rad/s", i + 1, qd)};
      }
      // Behind a gap, and where the arm does not do what it is told, it goes on from what is
      // measured.
      const double from_last = std::abs(qd - last_[i]), from_measured = std::abs(qd - in.qd[i]);
      const bool taken_up = (timing_ != kOnTime || out.reason == Reason::kNotFollowing) &&
                            !blind_ && from_measured < from_last;
      excess =
          std::max(excess, (taken_up ? from_measured : from_last) / (robot_.acceleration[i] * kT));
      // Nobody stops a joint between two cycles.
      const double to = q_[i];
      const double slack = 1e-4 + (timing_ == kOnTime ? 0.0 : robot_.velocity[i] * kT * elapsed_);
      if (!(to <= robot_.position_max[i] + slack && to >= robot_.position_min[i] - slack)) {
        return {"joint position", text("joint %d at %.6g of %.6g to %.6g rad", i + 1, to,
                                       robot_.position_min[i], robot_.position_max[i])};
      }
    }
    // Of the command, at the joints that the controller was told.
    figures_.worst_flange = std::max(figures_.worst_flange, at_.flange_speed);
    // A late arm may find itself where its joint velocities are faster: it can only brake.
    double most = robot_.limits.flange_velocity * (1 + 1e-6);
    if (timing_ != kOnTime) {
      most = 1.02 * std::max({most, truth(measured(), last_, tool_, p_rcm_).flange_speed,
                              truth(measured(), qd_, tool_, p_rcm_).flange_speed});
    }
    if (!(at_.flange_speed <= most)) {
      return {"flange velocity", text("%.6g m/s", at_.flange_speed)};
    }
    const bool fades_late = faded_late_for_ > 0 || ((blind_ || force_halt_) && timing_ != kOnTime);
    if (!fades_late && excess > 1 + 1e-6) {
      return {"joint acceleration", text("%.4g times the limit, limited_by '%s', scale %.4g",
                                         excess, out.limited_by, out.scale)};
    }
    return {};
  }

  Plant plant_kind() const {
    return !lagging_ ? kIdeal : robot_.tuning.link_lag > 0 ? kLagKnown : kLagUnknown;
  }

  /// All joints have braked together by what the fastest one may.
  bool faded(const Outputs& out) const {
    const JointVector most = kT * robot_.acceleration;
    const double cycles = std::max(1.0, (last_.array().abs() / most.array()).maxCoeff());
    return (out.qd_command - (1 - 1 / cycles) * last_).norm() < 1e-9;
  }

  Failure stillness(const Inputs& in, const Outputs& out) {
    const bool still = out.qd_command.norm() == 0 && out.twist_command.norm() == 0;
    if (!still && !out.homed) return {"halt", "moves without home"};
    // A starved controller withholds its command: nothing new reaches the arm.
    const bool slower = still || out.withheld || out.qd_command.norm() < last_.norm();
    if ((blind_ || force_halt_) && !(timing_ == kOnTime ? faded(out) : slower)) {
      return {"fade", blind_ ? "does not fade without a joint state"
                             : "does not fade against a hard or unknown force"};
    }
    const bool load =
        in.trocar_force.valid && !(in.trocar_force.f_B.norm() <= robot_.limits.trocar_force_fault);
    if (out.state == State::kEnabled && (force_halt_ || load)) {
      return {"force", "ENABLED above a fault level"};
    }
    still_for_ = out.state == State::kEnabled ? 0 : still_for_ + 1;
    if (still_for_ > 1000 && out.qd_command.norm() != 0) {
      return {"stillness", text("moves 2 s after leaving ENABLED, %s", name(out.state))};
    }
    return {};
  }

  Failure pivot(const Inputs&, const Outputs& out) {
    if (options_.law == Law::kPaper || blind_) return {};
    // The trocar as the arm knows it: a track has its own error.
    // After a trocar that left the shaft the stop keeps to the pivot it began on.
    if (out.state == State::kFault && out.reason == Reason::kRcmError) return {};
    const double error = (out.p_BRcm - at_.p_tip).cross(at_.s).norm();
    if (std::abs(error - out.rcm_error) > 1e-9) {
      return {"pivot", text("reported %.9g m, true %.9g m", out.rcm_error, error)};
    }
    late_ago_ = elapsed_ > 1 ? 0 : late_ago_ + elapsed_;
    if (!out.homed || out.state != State::kEnabled) return {};
    if (error > robot_.limits.rcm_error_fault) {
      return {"pivot", text("ENABLED %.6g m off the trocar", error)};
    }
    // A point taught beside the shaft is where the arm starts, within the fault level. From there
    // the error gets smaller, critically damped.
    const auto begin = [&] {
      pivot_start_ = error;
      pivot_since_ = 0;
    };
    if (called_ || !had_before_ || before_.state != State::kEnabled) begin();
    pivot_since_ += kT * 5;
    const auto left = [&] { return pivot_start_ * (1 + pivot_since_) * std::exp(-pivot_since_); };
    // An arm that a limit slows down cannot follow a trocar that moves.
    const bool left_behind = options_.track_rcm && out.scale < 1;
    if (left_behind && error > left()) begin();
    if (late_ago_ < 1000) {  // test_cycle_time has the bounds
      if (error > left()) begin();
      return {};
    }
    const double allowed = kPivot[plant_kind()] + left();
    double& worst = figures_.worst_pivot[plant_kind()][options_.track_rcm];
    worst = std::max(worst, error - left());
    if (error > allowed) return {"pivot", text("%.6g m, allowed %.6g", error, allowed)};
    return {};
  }

  /// Mean velocity of the tip over the cycle. The velocity form states it where the arm is now, the
  /// exact form on its way to the end of the cycle.
  Vector3 v_tip(const Outputs& out) const {
    return options_.law == Law::kExact ? v_tip_in(0.5 * kT, out) : at_.v_tip;
  }

  /// Velocity of the tip with the joint velocities of now, where the arm is in 'ahead' seconds.
  Vector3 v_tip_in(double ahead, const Outputs& out) const {
    return truth(measured() + ahead * out.qd_command, out.qd_command, tool_, p_rcm_).v_tip;
  }

  /// What is left of 'rest' beside a pull towards the set-point and some of 'late'.
  static Vector3 beyond(const Vector3& rest, const Vector3& error, const Vector3& late) {
    const auto share = [](const Vector3& v, const Vector3& of, double most) {
      return of.squaredNorm() > 0 ? std::clamp(v.dot(of) / of.squaredNorm(), 0.0, most) : 0.0;
    };
    double g = 0, h = 0;
    for (int i = 0; i < 5; ++i) {
      g = share(rest - h * late, error, 1 / kT);
      h = share(rest - g * error, late, 1);
    }
    return rest - g * error - h * late;
  }

  /// [m/s] with which the exact form puts right a lag L that it does not know: e' = L a - K e for
  /// the part of the error that comes from it, beside what a limit may have left. Of that
  /// K e = L K (v - v behind a low-pass of 1 / K).
  Vector3 late_correction(const Outputs& out) const {
    const double K = robot_.tuning.rcm_gain;
    const bool unknown = plant_kind() == kLagUnknown && options_.law == Law::kExact;
    return unknown ? Vector3(kLag * K * (out.v_set - v_slow_)) : Vector3(Vector3::Zero());
  }

  /// The tip moves as the set-point does, plus towards the set-point: v - v_set = g (p_set - p_tip)
  /// with some 0 <= g <= 1/T. Holds for every form of the law; one with a wrong vector fails.
  Failure tip_velocity(const Inputs& in, const Outputs& out) {
    const bool plain =
        timing_ == kOnTime && options_.law != Law::kPaper && plant_kind() != kLagKnown &&
        !called_ && had_before_ && out.homed && out.state == State::kEnabled &&
        before_.state == State::kEnabled && out.scale == 1 && out.tier == 0 && !blind_ &&
        at_.depth > robot_.limits.depth_slow + 1e-4 && !axial_ && out.motion != Motion::kRetrace;
    // After a limit the pivot is put right first, and the tip pays for it.
    limited_ago_ = out.scale < 1 || out.tier > 0 || called_ ? 0 : limited_ago_ + 1;
    const double into_before = into_;
    into_ = 0;
    if (in.tip_force.valid && in.tip_force.f_B.norm() > robot_.limits.tip_force_soft) {
      const double into = into_ = -at_.v_tip.dot(in.tip_force.f_B.normalized());
      // A joint that brakes as hard as it can is no fault.
      if (!plain || (excess_ > 1 - 1e-6 && into < into_before)) return {};
      double& worst = figures_.worst_into_force[plant_kind()][options_.track_rcm];
      worst = std::max(worst, into);
      if (into > kIntoForce[plant_kind()][options_.track_rcm]) {
        return {"force", text("goes on at %.4g m/s against it", into)};
      }
      return {};
    }
    if (!plain || limited_ago_ < 100) return {};
    const Vector3 error = before_.p_set - at_.p_tip, rest = v_tip(out) - out.v_set;
    const double residual = beyond(rest, error, late_correction(out)).norm();
    ++figures_.tip_checked;
    double& worst = figures_.worst_tip_velocity[plant_kind()][options_.track_rcm];
    worst = std::max(worst, residual);
    // A tip beside its set-point goes on beside it by the same angle: the shaft turns for both.
    const double beside = options_.law == Law::kExact ? error.norm() / at_.depth : 0.0;
    const double share = kTipShare[plant_kind()] + beside;
    double bound = kTip[plant_kind()][options_.track_rcm] + share * out.v_set.norm();
    // What the exact form does not know to lag behind is put right joint by joint, on a straight
    // line: the tip's path bends between.
    if (lagging_ && options_.law == Law::kExact) {
      bound += kBend * (v_tip_in(kLag, out) - at_.v_tip).norm();
    }
    if (residual <= bound) return {};
    return {"tip velocity", text("set-point %.5g m/s, tip %.5g m/s, residual %.5g of %.5g m/s",
                                 out.v_set.norm(), at_.v_tip.norm(), residual, bound)};
  }

  Failure workspace(const Inputs&, const Outputs& out) {
    if (options_.law == Law::kPaper || out.state != State::kEnabled || !out.homed) return {};
    if (timing_ != kOnTime) return {};
    if (out.p_BRcm != p_taught_ || lagging_) return {};  // it is the taught point's workspace
    const Vector3 p = controller_.X_BR().inverse() * before_.p_set;
    const Limits& limits = robot_.limits;
    const bool along = before_.motion == Motion::kInsert || before_.motion == Motion::kWithdraw ||
                       at_.depth < limits.depth_min + 1e-3;
    const double outside =
        std::max(at_.depth - limits.depth_max,
                 along ? -1.0 : at_.depth * std::cos(limits.cone) - (p.z() + 0.004));
    // Where the arm was taught and homed it starts, inside or not; it may not get further out.
    if (called_ || before_.state != State::kEnabled || !had_before_) outside_start_ = outside;
    if (outside > std::max(0.004, outside_start_ + 0.004)) {
      return {"workspace", text("%.5g m outside", outside)};
    }
    return {};
  }

  /// From the cycle in which the arm stops being led, the tip goes no further than its braking
  /// distance, what the set-point was ahead, and the follow-up of the feedback.
  Failure stopping(const Inputs&, const Outputs& out) {
    if (options_.law == Law::kPaper || timing_ != kOnTime) return {};
    bool led = out.state == State::kEnabled && had_before_ && before_.state == State::kEnabled;
    for (int i = 0; i < out.n_verdicts; ++i) {
      if (out.verdicts[i].motion == Motion::kHold && out.verdicts[i].reason == Reason::kNone) {
        led = false;
      }
    }
    if (out.motion != Motion::kNone) led = led && true;
    if (led && out.motion != Motion::kNone) stop_from_ = -1;
    if (!led && stop_from_ < 0 && out.homed && had_before_) {
      stop_from_ = k_;
      p_stop_ = at_.p_tip;
      p_rcm_stop_ = p_rcm_;
      const double speed = std::max({before_.v_set.norm(), before_.v_BTip.norm(), v_tip_before_});
      const double ahead = (out.p_set - at_.p_tip).norm();
      // All joints together brake at this rate at least [1/s]: the tip needs v / (2 rate).
      double rate = 1e3;
      for (int i = 0; i < before_.qd_command.size(); ++i) {
        const double qd = std::max(std::abs(before_.qd_command[i]), 1e-6);
        rate = std::min(rate, ExactFollower::kReferenceShare * robot_.acceleration[i] / qd);
      }
      const double braking =
          std::max(speed * speed / (2 * robot_.limits.stop_deceleration), speed / (2 * rate));
      stop_bound_ = braking + ahead + speed * kStopDelay[plant_kind()] + kStopSlack;
      ++figures_.stops;
    }
    v_tip_before_ = at_.v_tip.norm();
    if (stop_from_ < 0 || !out.homed) return {};
    // A joint at its limit cannot turn the shaft: the tip then goes with the tracked trocar.
    const double travel =
        std::max((at_.p_tip - p_stop_).norm() - (p_rcm_ - p_rcm_stop_).norm(), 0.0);
    double& worst = figures_.worst_stop[plant_kind()];
    worst = std::max(worst, travel / stop_bound_);
    if (travel > stop_bound_) {
      return {"stop distance",
              text("%.5g m, allowed %.5g, %ld cycles after, %s", travel, stop_bound_,
                   static_cast<long>(k_ - stop_from_), name(out.state))};
    }
    return {};
  }

  /// F31: only an accepted jaw command of an ENABLED arm moves the jaw, at its rate.
  Failure jaw(const Inputs&, const Outputs& out) {
    for (int i = 0; i < out.n_verdicts; ++i) {
      if (is_jaw(out.verdicts[i].motion) && out.verdicts[i].reason == Reason::kNone) {
        jaw_asked_ = true;
      }
    }
    const bool may = out.state == State::kEnabled && !tool_blind_;
    if (!may) jaw_asked_ = false;
    const double was = had_before_ ? before_.jaw_set : kNan, is = out.jaw_set;
    if (std::isnan(was)) return {};
    const auto instrument = test::instrument();
    if (!(is >= instrument.jaw_min && is <= instrument.jaw_max)) {
      return {"jaw", text("set to %.6g rad", is)};
    }
    if (is != was && !jaw_asked_) {
      return {"jaw", text("moved from %.6g to %.6g rad unasked, %s", was, is, name(out.state))};
    }
    if (std::abs(is - was) > instrument.jaw_velocity * kT * (1 + 1e-9)) {
      return {"jaw", text("jumped from %.6g to %.6g rad", was, is)};
    }
    return {};
  }

 public:
  long k() const { return k_; }
  /// Law, tool, plant and the last cycle, for the message of a failure.
  std::string description() const {
    return text(
        "law %d, tool %.3f m aside, %s plant, link_lag %.3f s%s, timing %d; %s, motion %d, depth "
        "%.4f m, "
        "scale %.4g %s",
        static_cast<int>(options_.law), tool_.p_FTip.x(), lagging_ ? "lagging" : "ideal",
        robot_.tuning.link_lag, options_.track_rcm ? ", tracked trocar" : "",
        static_cast<int>(timing_), name(before_.state), static_cast<int>(before_.motion), at_.depth,
        before_.scale, before_.limited_by);
  }

 private:
  Dice dice_;
  Figures& figures_;
  bool lagging_;
  RobotConfig robot_;
  ToolCalibration tool_;
  Controller::Options options_;
  Controller controller_;
  enum Timing { kOnTime, kSomeLate, kDrawn, kFreezes } timing_ = kOnTime;
  int elapsed_ = 1, dead_man_ = 50;  // [periods]
  int faded_late_for_ = 0;
  long late_ago_ = 1000;
  JointVector obeyed_ = JointVector::Zero(6);
  JointVector q_, qd_, last_;
  std::deque<JointVector> pipeline_;
  Vector3 p_taught_, p_rcm_;
  double jaw_ = 0.3;
  long k_ = 0;
  Outputs before_;
  bool had_before_ = false;
  Truth at_{};

  Motion kind_ = Motion::kNone;
  int phase_ = 0, every_ = 1;
  std::uint32_t source_ = 1;
  Vector3 v_ = Vector3::Zero(), goal_ = Vector3::Zero();
  double roll_rate_ = 0, roll_goal_ = 0;
  Vector4 rates_ = Vector4::Zero();

  bool called_ = false, enabled_by_request_ = false, blind_ = false, tool_blind_ = false;
  int limited_ago_ = 0;
  bool jaw_asked_ = false, axial_ = false, force_halt_ = false;
  int push_for_ = 0;
  Vector3 push_ = Vector3::Zero();
  int blind_for_ = 0, tool_blind_for_ = 0;
  long still_for_ = 0, stop_from_ = -1;
  Vector3 p_stop_ = Vector3::Zero(), p_rcm_stop_ = Vector3::Zero();
  double excess_ = 0;                 // of the command over the joints' acceleration limits
  double into_ = 0;                   // [m/s] against the force
  Vector3 v_slow_ = Vector3::Zero();  // [m/s] of the set-point
  double stop_bound_ = 0, v_tip_before_ = 0, pivot_start_ = 0, pivot_since_ = 0;
  double outside_start_ = 0;
};

struct Arguments {
  long seed = 1, runs = 0, cycles = 4000;
};

Arguments parse(int argc, char** argv) {
  const char* full = std::getenv("SURG_TEST_FULL");
  Arguments arguments;
  arguments.runs = full && std::strcmp(full, "1") == 0 ? 300 : 30;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (i + 1 < argc && word == "--seed") {
      arguments.seed = std::atol(argv[++i]);
    } else if (i + 1 < argc && word == "--runs") {
      arguments.runs = std::atol(argv[++i]);
    } else if (i + 1 < argc && word == "--cycles") {
      arguments.cycles = std::atol(argv[++i]);
    } else {
      std::fprintf(stderr, "usage: fuzz_controller [--seed N] [--runs N] [--cycles N]\n");
      std::exit(2);
    }
  }
  return arguments;
}

void write_results(const Figures& f) {
  test::Results results("fuzz", "fuzz_controller.cpp", "Fuzz of the whole controller");
  std::string happened = "Counts: ";
  const auto count = [&happened](const char* what, long n) {
    happened += test::cell("%ld %s, ", n, what);
  };
  count("cycles", f.cycles);
  count("ENABLED", f.enabled);
  count("in motion", f.moving);
  count("later than two periods", f.late);
  count("later than five", f.gaps);
  count("stops by the link's own dead-man", f.dead_man);
  count("state commands in a ramp", f.ramps);
  count("faults", f.faults);
  count("stops", f.stops);
  count("commands accepted", f.accepted);
  count("refused", f.refused);
  count("judged for the tip's velocity", f.tip_checked);
  results.table("What the oracles saw",
                "Kinematics of their own judge every cycle. Stop: braking distance, lead of the "
                "set-point, its way in 10 ms (lag: 40 ms) and 1 mm are allowed.",
                {"oracle", "worst", "allowed"});
  results.row({"flange speed of the command", test::cell("%.6f m/s", f.worst_flange),
               "its limit, 0.25 m/s"});
  for (const Plant plant : {kIdeal, kLagKnown, kLagUnknown}) {
    for (const bool tracked : {false, true}) {
      const std::string where = std::string(", ") + kPlants[plant] + (tracked ? ", tracked" : "");
      const double pivot = f.worst_pivot[plant][tracked],
                   tip = f.worst_tip_velocity[plant][tracked];
      results.row({"pivot while ENABLED" + where, test::cell("%.0f µm", 1e6 * pivot),
                   test::cell("%.0f µm", 1e6 * kPivot[plant])});
      if (plant == kLagKnown) continue;  // what is ahead by the lag is no measure of the command
      results.row(
          {"tip velocity beside the set-point" + where, test::cell("%.2f mm/s", 1e3 * tip),
           test::cell("%.1f mm/s + %.0f %%", 1e3 * kTip[plant][tracked], 100 * kTipShare[plant])});
      results.row({"against a soft force limit" + where,
                   test::cell("%.2f mm/s", 1e3 * f.worst_into_force[plant][tracked]),
                   test::cell("%.1f mm/s", 1e3 * kIntoForce[plant][tracked])});
    }
    results.row({std::string("stop distance / allowed, ") + kPlants[plant],
                 test::cell("%.2f", f.worst_stop[plant]), "1"});
  }
  results.row({"share of the measured acceleration",
               test::cell("%.3g in %ld cycles", f.worst_measured, f.measured), "1"});
  results.text(happened +
               "exact in every cycle: finite outputs, limits, zero without a joint state, home or "
               "known force, one holder, poison refused.");
}

int fuzz(const Arguments& arguments) {
  Figures figures;
  for (long i = 0; i < arguments.runs; ++i) {
    const long seed = arguments.seed + i;
    Run run(static_cast<std::uint64_t>(seed), figures);
    for (long k = 0; k < arguments.cycles; ++k) {
      const Failure failure = run.cycle();
      if (failure.oracle.empty()) continue;
      std::printf(
          "FAILED %s, seed %ld, cycle %ld: %s\n  (%s)\n  again: fuzz_controller --seed %ld --runs "
          "1\n",
          failure.oracle.c_str(), seed, run.k(), failure.text.c_str(), run.description().c_str(),
          seed);
      return 1;
    }
  }
  write_results(figures);
  // A fuzz that nothing happens in proves nothing.
  const bool lively = figures.enabled > figures.cycles / 3 && figures.moving > figures.cycles / 8 &&
                      figures.tip_checked > figures.cycles / 40;
  if (arguments.runs >= 20 && !lively) {
    std::printf("FAILED: too little happens\n");
    return 1;
  }
  std::printf("[  PASSED  ] 1 test.\n");  // counted like a test program's
  return 0;
}

}  // namespace
}  // namespace surg

int main(int argc, char** argv) { return surg::fuzz(surg::parse(argc, argv)); }
