#include "surg_core/files/robot_model.hpp"

#include <algorithm>
#include <sstream>

#include "files/text_file.hpp"

namespace surg {
namespace {

constexpr double kTurnRounding = 2e-5;  // 2 pi with four decimals in one file, nine in another

std::string number(double value) {
  std::ostringstream text;
  text.precision(10);
  text << value;
  return text.str();
}

/// Names the root and its pose in B, where only fixed joints lie between them.
void find_root(const Urdf& urdf, const RobotConfig& robot, Model& model) {
  Pose X_RootB = Pose::Identity();
  std::string link = robot.base_link;
  for (;;) {
    const auto joint = std::find_if(urdf.joints.begin(), urdf.joints.end(),
                                    [&](const UrdfJoint& j) { return j.child == link; });
    if (joint == urdf.joints.end()) break;
    if (joint->kind != "fixed") return;
    X_RootB = joint->X_PJ * X_RootB;
    link = joint->parent;
  }
  if (link == "world") return;
  model.root_link = link;
  model.X_BRoot = X_RootB.inverse();
}

/// The YAML may tighten what the URDF allows, never loosen it.
void check_limits(const std::vector<UrdfJoint>& joints, const RobotConfig& robot,
                  const std::string& urdf) {
  int i = 0;
  for (const UrdfJoint& joint : joints) {
    if (!joint.turning()) continue;
    const auto loose = [&](const std::string& key, double yaml, const std::string& relation,
                           double drawn) {
      files::refuse(robot.file, 0,
                    key + " of joint '" + joint.name + "' is " + number(yaml) + ", but " + urdf +
                        " allows " + relation + " " + number(drawn) + ": tighten the YAML");
    };
    if (joint.limit && !(robot.velocity[i] <= *joint.limit->velocity + kTurnRounding)) {
      loose("joints.velocity", robot.velocity[i], "<=", *joint.limit->velocity);
    }
    if (joint.kind == "revolute") {
      if (!(robot.position_min[i] >= *joint.limit->lower - kTurnRounding)) {
        loose("joints.position_min", robot.position_min[i], ">=", *joint.limit->lower);
      }
      if (!(robot.position_max[i] <= *joint.limit->upper + kTurnRounding)) {
        loose("joints.position_max", robot.position_max[i], "<=", *joint.limit->upper);
      }
    }
    ++i;
  }
}

}  // namespace

std::string urdf_of(const RobotConfig& robot) { return files::beside(robot.file, robot.urdf); }

Model load_model(const RobotConfig& robot) {
  const std::string file = urdf_of(robot);
  Model model;
  try {
    const Urdf urdf = load_urdf(file);
    model.joints = joints_between(urdf, robot.base_link, robot.flange_link);
    model.chain = chain_of(urdf, robot.base_link, robot.flange_link, robot.joint_names);
    model.urdf = urdf.text;
    find_root(urdf, robot, model);
  } catch (const ConfigError& error) {
    throw ConfigError(robot.file + ": urdf: " + error.what());
  }
  check_limits(model.joints, robot, file);
  return model;
}

}  // namespace surg
