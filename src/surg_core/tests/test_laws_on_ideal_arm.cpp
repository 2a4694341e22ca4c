// What the laws can do at best: an arm that goes exactly where it is told, moving through straight
// lines in joint space between the samples. Writes docs/results/law.md.
#include <functional>
#include <vector>

#include "support/law_scene.hpp"
#include "support/results.hpp"
#include "support/test_support.hpp"

namespace surg {
namespace {

using test::cell;
using test::kDegrees;
using test::kPeriod;
using test::kT;
using test::number;
using test::Scene;
using test::Series;

test::Results& results() {
  static test::Results page("law", "src/surg_core/tests/test_laws_on_ideal_arm.cpp",
                            "The law on an ideal arm");
  return page;
}

constexpr double kGain = 30;      // [1/s] rcm_gain, as shipped
constexpr double kTipGain = 10;   // [1/s]
constexpr double kRollGain = 10;  // [1/s]
constexpr double kPosture = 1;    // [1/s]

/// Joints at t + T from joints at t.
using Step = std::function<JointVector(const JointVector& q, double t)>;

struct Named {
  std::string name;
  Step step;
};

JointVector pull(const Scene& scene, const JointVector& q, double gain) {
  return gain * (scene.q_home - q);
}

Step exact_law(const Scene& scene, double posture) {
  return [&scene, posture](const JointVector& q, double t) -> JointVector {
    const Vector3 p_BTip = scene.X_BR * test::lissajous(t + kT);
    const ShaftGoal goal = tip_goal(scene.p_BRcm(), p_BTip, 0, scene.home.s_B);
    return scene.next(q, goal, kT * pull(scene, q, posture));
  };
}

JointVector follow(const Scene& scene, const JointVector& q, const Jacobian& J,
                   const Vector6& twist) {
  return q + kT * inverse_velocity(J, twist, pull(scene, q, kPosture)).qd;
}

/// The mean tip velocity that the coming cycle asks for.
Vector3 wanted_velocity(const Scene& scene, double t) {
  return scene.X_BR.linear() * (test::lissajous(t + kT) - test::lissajous(t)) / kT;
}

Step velocity_law(const Scene& scene) {
  return [&scene](const JointVector& q, double t) -> JointVector {
    const auto [X_BF, J] = scene.chain.flange(q);
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm());
    const Vector3 behind = scene.X_BR * test::lissajous(t) - shaft.p_BTip;
    const Vector3 v = wanted_velocity(scene, t) + kTipGain * behind;
    const Vector3 s_dot = (v - shaft.s * shaft.s.dot(v) - kGain * shaft.e) / shaft.depth;
    const double about =
        -kRollGain * scene.roll(q) + roll_holonomy_rate(scene.home.s_B, shaft.s, s_dot);
    return follow(scene, q, J, rcm_twist(shaft, v, about, Vector3::Zero(), kGain, 0.02));
  };
}

Step paper_law(const Scene& scene) {
  return [&scene](const JointVector& q, double t) -> JointVector {
    const auto [X_BF, J] = scene.chain.flange(q);
    const Vector3 p_tip = X_BF * scene.tool.p_FTip;
    return follow(scene, q, J,
                  paper_cartesian_twist(X_BF.translation(), p_tip, scene.p_BRcm(),
                                        wanted_velocity(scene, t), 0));
  };
}

/// What a slip makes of equation (3): r_ee where r_shaft belongs. It pivots about the trocar as
/// well as the right law does.
Step swapped_law(const Scene& scene) {
  return [&scene](const JointVector& q, double t) -> JointVector {
    const auto [X_BF, J] = scene.chain.flange(q);
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm());
    const Vector3 v = wanted_velocity(scene, t);
    const Vector3 r_ee = shaft.p_BF - shaft.p_BNear;
    const Vector3 omega = r_ee.cross(v) / r_ee.squaredNorm();
    Vector6 twist;
    twist.head<3>() = shaft.s * shaft.s.dot(v) + kGain * shaft.e + omega.cross(r_ee);
    twist.tail<3>() = omega;
    return follow(scene, q, J, twist);
  };
}

struct Figures {
  Series rcm, between, tip, tip_velocity, roll;
  double drift = 0;  ///< [rad] joints at equal phase, the last period against the third
};

Figures run(const Scene& scene, const Step& step, double seconds, int pieces) {
  Figures figures;
  JointVector q = scene.q_home;
  const long period = std::lround(kPeriod / kT), end = std::lround(seconds / kT);
  std::vector<JointVector> third;
  for (long i = 0; i < end; ++i) {
    if (i >= 2 * period && i < 3 * period) third.push_back(q);
    if (i >= 3 * period && i >= end - period) {
      const JointVector moved = q - third[i % period];
      figures.drift = std::max(figures.drift, moved.cwiseAbs().maxCoeff());
    }
    const JointVector next = step(q, i * kT);
    for (int k = 1; k < pieces; ++k) {
      const JointVector on_the_way = q + (next - q) * k / pieces;
      figures.between.add(scene.shaft(on_the_way).e.norm());
    }
    const ShaftState before = scene.shaft(q), after = scene.shaft(next);
    figures.rcm.add(after.e.norm());
    figures.tip.add((after.p_BTip - scene.X_BR * test::lissajous((i + 1) * kT)).norm());
    // The oracle of the tip's velocity: where the tip went, over the time that it took.
    figures.tip_velocity.add(
        ((after.p_BTip - before.p_BTip) / kT - wanted_velocity(scene, i * kT)).norm());
    figures.roll.add(scene.roll(next));
    q = next;
  }
  return figures;
}

TEST(Law, ExactFormKeepsPivotTipRollAndPostureOnAnIdealArm) {
  const double seconds = test::family(80, 300);
  const int pieces = test::family(4, 16);
  results().table(
      "Lissajous motion of " + cell("%.0f", seconds) + " s",
      "Tip ±35, ±35, ±25 mm at 0.2, 0.15, 0.1 Hz, 120 mm deep, 500 Hz, tool 60 mm and 10° aside. "
      "Between: on the straight line in joint space between samples (" +
          cell("%d", pieces) +
          " pieces). Drift: of a joint from the third to the last period. Swapped: r_ee in the "
          "place of r_shaft; the RCM alone proves nothing.",
      {"arm", "law", "RCM max µm", "between max µm", "tip max µm", "roll max °", "drift °"});
  for (const bool panda : {false, true}) {
    for (const bool tilted : {false, true}) {
      const Scene scene(panda, tilted);
      std::vector<Named> laws;
      laws.push_back({"exact", exact_law(scene, kPosture)});
      if (panda) laws.push_back({"exact, no posture", exact_law(scene, 0)});
      laws.push_back({"velocity form", velocity_law(scene)});
      laws.push_back({"paper", paper_law(scene)});
      laws.push_back({"swapped", swapped_law(scene)});
      for (const auto& [name, step] : laws) {
        const Figures f = run(scene, step, seconds, pieces);
        results().row({scene.name, name, number(1e6 * f.rcm.largest),
                       number(1e6 * f.between.largest), number(1e6 * f.tip.largest),
                       number(kDegrees * f.roll.largest), number(kDegrees * f.drift)},
                      tilted && name != "exact, no posture");
        const std::string where = scene.name + ", " + scene.tool_name + ", " + name;
        if (name.rfind("exact", 0) == 0) {
          EXPECT_LE(f.rcm.largest, 1e-10) << where;  // 1e-4 um
          EXPECT_LE(f.between.largest, 0.15e-6) << where;
          EXPECT_LE(f.tip.largest, 1e-10) << where;
          EXPECT_LE(f.tip_velocity.largest, 1e-7) << where;
          EXPECT_LE(kDegrees * f.roll.largest, 1e-3) << where;
          if (name != "exact, no posture") {
            EXPECT_LE(kDegrees * f.drift, 1e-6) << where;
          }
        } else if (name == "velocity form") {
          EXPECT_LE(f.rcm.largest, 10e-6) << where;
          EXPECT_LE(kDegrees * f.roll.largest, 0.1) << where;
        } else if (name == "paper") {
          EXPECT_GE(f.rcm.largest, 100e-6) << where;  // no feedback: it drifts
        } else if (name == "swapped") {
          EXPECT_LE(f.rcm.largest, 20e-6) << where;          // the pivot says nothing ...
          EXPECT_GE(f.tip_velocity.largest, 0.01) << where;  // ... the tip's velocity does
        }
      }
    }
  }
  test::report("control cycles per law", std::lround(seconds / kT));
}

/// Yaw, pitch, insertion, roll: a motion of all four at once.
Vector4 virtual_joints(double t) {
  const double w = 2 * M_PI * t;
  return {0.28 * std::sin(0.2 * w), 0.28 * std::sin(0.15 * w), 0.12 + 0.025 * std::sin(0.1 * w),
          0.8 * std::sin(0.12 * w)};
}

/// The spherical laws: ours on the angles of the trocar frame, the paper's on the rates about the
/// base's x and y that these angles mean.
std::vector<Named> spherical_laws(const Scene& scene,
                                  const std::function<Vector4(double)>& joints) {
  const auto exact = [&scene, joints](const JointVector& q, double t) -> JointVector {
    const ShaftGoal goal = test::spherical_goal(scene.X_BR, joints(t + kT));
    return scene.next(q, goal, kT * pull(scene, q, kPosture));
  };
  const auto velocity = [&scene, joints](const JointVector& q, double t) -> JointVector {
    const auto [X_BF, J] = scene.chain.flange(q);
    const ShaftState shaft = shaft_state(X_BF, scene.tool, scene.p_BRcm());
    const ShaftGoal now = test::spherical_goal(scene.X_BR, joints(t));
    const ShaftGoal soon = test::spherical_goal(scene.X_BR, joints(t + kT));
    const Vector3 v =
        (soon.p_BTip() - now.p_BTip()) / kT + kTipGain * (now.p_BTip() - shaft.p_BTip);
    const Vector3 s_dot = (v - shaft.s * shaft.s.dot(v) - kGain * shaft.e) / shaft.depth;
    const double about = (soon.roll - now.roll) / kT + kRollGain * (now.roll - scene.roll(q)) +
                         roll_holonomy_rate(scene.home.s_B, shaft.s, s_dot);
    return follow(scene, q, J, rcm_twist(shaft, v, about, Vector3::Zero(), kGain, 0.02));
  };
  const auto paper = [&scene, joints](const JointVector& q, double t) -> JointVector {
    const auto [X_BF, J] = scene.chain.flange(q);
    const ShaftGoal now = test::spherical_goal(scene.X_BR, joints(t));
    const ShaftGoal soon = test::spherical_goal(scene.X_BR, joints(t + kT));
    const Vector3 omega = now.s_B.cross(Vector3(soon.s_B - now.s_B)) / kT;
    return follow(
        scene, q, J,
        paper_spherical_twist(X_BF.translation(), scene.p_BRcm(), omega.x(), omega.y(),
                              (soon.roll - now.roll) / kT, (soon.depth - now.depth) / kT));
  };
  return {{"exact", exact}, {"velocity form", velocity}, {"paper, eqs. (8)-(9)", paper}};
}

struct SphericalFigures {
  Series rcm, tip, roll;
};

SphericalFigures run_spherical(const Scene& scene, const Step& step,
                               const std::function<Vector4(double)>& joints, double seconds) {
  SphericalFigures figures;
  JointVector q = scene.q_home;
  const long end = std::lround(seconds / kT);
  for (long i = 0; i < end; ++i) {
    q = step(q, i * kT);
    if (!q.allFinite()) break;
    const ShaftState shaft = scene.shaft(q);
    const ShaftGoal goal = test::spherical_goal(scene.X_BR, joints((i + 1) * kT));
    figures.rcm.add(shaft.e.norm());
    figures.tip.add((shaft.p_BTip - goal.p_BTip()).norm());
    figures.roll.add(std::remainder(scene.roll(q) - goal.roll, 2 * M_PI));
  }
  return figures;
}

TEST(Law, SphericalModeTakesTheAxisFromTheShaft) {
  const double seconds = test::family(20, 300);
  const auto turn = [](double t) -> Vector4 {  // a quarter turn of roll in 2 s, nothing else
    return {0, 0, 0.12, M_PI_4 * (1 - std::cos(M_PI_2 * std::min(t, 2.0)))};
  };
  results().table("Spherical mode",
                  "Yaw and pitch ±16°, insertion ±25 mm, roll ±46° together for " +
                      cell("%.0f", seconds) +
                      " s; then a quarter turn of roll alone. The paper takes flange to trocar for "
                      "the shaft.",
                  {"arm", "law", "RCM max µm", "tip max mm", "roll error max °",
                   "tip after a quarter turn mm"});
  for (const bool panda : {false, true}) {
    for (const bool tilted : {false, true}) {
      const Scene scene(panda, tilted);
      const std::vector<Named> laws = spherical_laws(scene, virtual_joints);
      const std::vector<Named> turns = spherical_laws(scene, turn);
      for (std::size_t i = 0; i < laws.size(); ++i) {
        const auto& [name, step] = laws[i];
        const SphericalFigures f = run_spherical(scene, step, virtual_joints, seconds);
        const SphericalFigures turned = run_spherical(scene, turns[i].step, turn, 2);
        results().row({scene.name, name, number(1e6 * f.rcm.largest), number(1e3 * f.tip.largest),
                       number(kDegrees * f.roll.largest), number(1e3 * turned.tip.largest)},
                      tilted);
        const std::string where = scene.name + ", " + scene.tool_name + ", " + name;
        if (name == "exact") {
          EXPECT_LE(f.rcm.largest, 1e-9) << where;
          EXPECT_LE(f.tip.largest, 1e-9) << where;
          EXPECT_LE(turned.tip.largest, 1e-9) << where;
        } else if (name == "velocity form") {
          EXPECT_LE(f.rcm.largest, 10e-6) << where;
        } else if (tilted) {
          EXPECT_GE(f.rcm.largest, 1e-3) << where;
          EXPECT_GE(turned.tip.largest, 0.02) << where;
        }
      }
    }
  }
}

}  // namespace
}  // namespace surg
