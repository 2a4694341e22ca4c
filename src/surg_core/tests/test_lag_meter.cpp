// The measured lag of a link against plants whose lag is known in closed form.
#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <random>
#include <vector>

#include "support/controller_bench.hpp"
#include "surg_core/state/lag_meter.hpp"

namespace surg {
namespace {

constexpr double kT = 0.002;

/// Dead time of whole cycles, then a first-order servo; positions in steps of 'resolution'.
class Plant {
 public:
  Plant(int delay, double tau, double resolution)
      : pipeline_(delay, JointVector::Zero(6)), tau_(tau), resolution_(resolution) {}
  /// Of the discrete plant: sum of what the servo's velocity misses of a unit step.
  double lag() const {
    const double left = tau_ > 0 ? std::exp(-kT / tau_) : 0;
    return kT * (static_cast<double>(pipeline_.size()) + left / (1 - left));
  }
  void drive(const JointVector& qd_command) {
    pipeline_.push_back(qd_command);
    const double left = tau_ > 0 ? std::exp(-kT / tau_) : 0;
    qd_ = left * qd_ + (1 - left) * pipeline_.front();
    pipeline_.pop_front();
    q_ += kT * qd_;
  }
  JointVector measured() const {
    JointVector q = q_;
    if (resolution_ > 0) q = (q / resolution_).array().round() * resolution_;
    return q;
  }

 private:
  std::deque<JointVector> pipeline_;
  double tau_, resolution_;
  JointVector q_ = JointVector::Zero(6), qd_ = JointVector::Zero(6);
};

/// Sums of sines below 2 Hz, other ones for each joint.
class Motion {
 public:
  explicit Motion(unsigned seed) {
    std::mt19937 dice(seed);
    std::uniform_real_distribution<double> unit(0, 1);
    for (auto& joint : waves_) {
      for (Wave& wave : joint) {
        wave = {0.02 + 0.1 * unit(dice), 2 * M_PI * (0.1 + 1.9 * unit(dice)), 7 * unit(dice)};
      }
    }
  }
  JointVector at(double t) const {
    JointVector qd(6);
    for (int i = 0; i < 6; ++i) {
      qd[i] = 0;
      for (const Wave& wave : waves_[i]) qd[i] += wave.size * std::sin(wave.rate * t + wave.phase);
    }
    return qd;
  }

 private:
  struct Wave {
    double size, rate, phase;
  };
  std::array<std::array<Wave, 3>, 6> waves_;
};

TEST(LagMeter, FindsTheLagOfEveryPlantWithinHalfAMillisecond) {
  std::mt19937 dice(20);
  double worst = 0;
  for (unsigned seed = 0; seed < 60; ++seed) {
    const int delay = static_cast<int>(dice() % 8);
    const double tau = 0.001 * static_cast<double>(dice() % 16);
    Plant plant(delay, tau, seed % 2 ? 1e-5 : 0);
    const Motion motion(seed);
    LagMeter meter(JointVector::Constant(6, 0.012));
    JointVector sent = JointVector::Zero(6);
    for (int k = 0; k < 2500; ++k) {
      meter.step(sent, plant.measured(), 0, kT);
      sent = motion.at(k * kT);
      plant.drive(sent);
    }
    const double error = std::abs(meter.lag() - plant.lag());
    EXPECT_LT(error, 5e-4) << "delay " << delay << ", tau " << tau << ": " << meter.lag();
    worst = std::max(worst, error);
  }
  std::printf("60 plants: largest error %.3f ms\n", 1e3 * worst);
}

TEST(LagMeter, FindsTheLagOfEachJoint) {
  std::mt19937 dice(21);
  double worst = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    std::vector<Plant> joints;
    for (int i = 0; i < 6; ++i) {
      joints.emplace_back(static_cast<int>(dice() % 8), 0.001 * static_cast<double>(dice() % 12),
                          seed % 2 ? 1e-5 : 0);
    }
    const Motion motion(seed);
    LagMeter meter(JointVector::Constant(6, 0.012));
    JointVector sent = JointVector::Zero(6), q = sent;
    for (int k = 0; k < 10000; ++k) {
      for (int i = 0; i < 6; ++i) q[i] = joints[i].measured()[i];
      meter.step(sent, q, 0, kT);
      sent = motion.at(k * kT);
      if (k < 500) sent[5] = 0;  // a joint that begins later
      if (k == 499) EXPECT_TRUE(std::isnan(meter.joint_lag()[5]));
      for (Plant& joint : joints) joint.drive(sent);
    }
    for (int i = 0; i < 6; ++i) {
      worst = std::max(worst, std::abs(meter.joint_lag()[i] - joints[i].lag()));
    }
  }
  std::printf("40 arms of 6 joints: largest error %.3f ms\n", 1e3 * worst);
  EXPECT_LT(worst, 3e-4);
}

/// 12 ms more for 0.2 s in every second: late commands are no lag of one joint.
TEST(LagMeter, ALinkThatIsLateForAMomentTeachesNothing) {
  std::deque<JointVector> sent(12, JointVector::Zero(6));
  const Motion motion(5);
  LagMeter meter(JointVector::Constant(6, 0.012));
  const double left = std::exp(-kT / 0.008);
  JointVector q = JointVector::Zero(6), qd = q;
  double wrong = 0;
  for (int k = 0; k < 10000; ++k) {
    meter.step(sent.front(), q, 0, kT);
    sent.push_front(motion.at(k * kT));
    sent.pop_back();
    qd = left * qd + (1 - left) * sent[k % 500 < 400 ? 1 : 7];
    q += kT * qd;
    if (k < 5000) continue;
    const JointVector& servo = meter.link().servo;
    wrong = std::max(wrong, servo.maxCoeff() - servo.minCoeff());
  }
  std::printf("servos apart by %.2f ms\n", 1e3 * wrong);
  EXPECT_LT(wrong, 4e-4) << "0.56 ms where all motion counts alike";
}

TEST(LagMeter, TheAgeOfTheStateIsNoLag) {
  Plant plant(2, 0.008, 0);
  const Motion motion(3);
  LagMeter meter(JointVector::Constant(6, 0.012));
  std::deque<JointVector> late(4, JointVector::Zero(6));  // 8 ms on their way
  JointVector sent = JointVector::Zero(6);
  for (int k = 0; k < 2500; ++k) {
    late.push_back(plant.measured());
    meter.step(sent, late.front(), 4 * kT, kT);
    late.pop_front();
    sent = motion.at(k * kT);
    plant.drive(sent);
  }
  EXPECT_NEAR(meter.lag(), plant.lag(), 5e-4);
}

TEST(LagMeter, NeedsMotionAndSurvivesInterruptions) {
  LagMeter meter(JointVector::Constant(6, 0.012));
  Plant plant(3, 0.004, 1e-5);
  const Motion motion(8);
  JointVector sent = JointVector::Zero(6);
  for (int k = 0; k < 500; ++k) meter.step(sent, plant.measured(), 0, kT);
  EXPECT_TRUE(std::isnan(meter.lag()));
  JointVector by_hand = JointVector::Zero(6);  // moved with the brakes open
  for (int k = 0; k < 5000; ++k) {
    if (k % 1000 == 999) {
      meter.interrupt();
      by_hand.array() += 0.3;
    }
    meter.step(sent, plant.measured() + by_hand, 0, kT);
    sent = motion.at(k * kT);
    plant.drive(sent);
  }
  EXPECT_NEAR(meter.lag(), plant.lag(), 5e-4);
}

TEST(LagMeter, TheControllerReportsTheLagWhateverItIsTold) {
  for (const Law law : {Law::kExact, Law::kVelocity}) {
    for (const double told : {0.0, 0.012, 0.03}) {
      test::Bench bench({law}, 2, 0.008, told);
      EXPECT_TRUE(std::isnan(bench.out().link_lag));
      const Vector3 p0 = bench.tip_in_R();
      for (int k = 0; k < 3000; ++k) {
        const double t = k * kT;
        bench.servo_cp(p0 + 0.02 * Vector3(std::sin(3 * t), 1 - std::cos(2 * t), 0));
        bench.tick();
      }
      ASSERT_EQ(bench.out().state, State::kEnabled);
      const double left = std::exp(-kT / 0.008);
      EXPECT_NEAR(bench.out().link_lag, kT * (2 + left / (1 - left)), 1e-3) << told;
    }
  }
}

}  // namespace
}  // namespace surg
