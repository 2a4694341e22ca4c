#include "surg_control/files/model_loader.hpp"

#include <console_bridge/console.h>
#include <urdf_parser/urdf_parser.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainjnttojacsolver.hpp>
#include <kdl/tree.hpp>
#include <kdl_parser/kdl_parser.hpp>
#include <random>
#include <sstream>
#include <vector>

namespace surg_control {
namespace {

constexpr double kAgreement = 1e-9;   // [m, rad]
constexpr double kLimitSlack = 2e-5;  // 2 pi with four decimals here and with nine there
constexpr int kPostures = 100;

[[noreturn]] void refuse(const std::string& file, const std::string& what) {
  throw surg::ConfigError(file + ": " + what);
}

std::string number(double value) {
  std::ostringstream text;
  text.precision(10);
  text << value;
  return text.str();
}

/// Collects what urdfdom says while it parses, so that the cause ends up in the error and not on a
/// console.
class ParserMessages : public console_bridge::OutputHandler {
 public:
  ParserMessages() { console_bridge::useOutputHandler(this); }
  ~ParserMessages() override { console_bridge::restorePreviousOutputHandler(); }
  void log(const std::string& text, console_bridge::LogLevel level, const char*, int) override {
    if (level >= console_bridge::CONSOLE_BRIDGE_LOG_WARN)
      text_ += (text_.empty() ? "" : "; ") + text;
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

std::string read_urdf(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) refuse(path, "no such URDF file (the robot YAML's 'urdf' is relative to that YAML)");
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

surg::Pose to_pose(const urdf::Pose& pose) {
  surg::Pose X = surg::Pose::Identity();
  X.linear() =
      Eigen::Quaterniond(pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z)
          .normalized()
          .toRotationMatrix();
  X.translation() = surg::Vector3(pose.position.x, pose.position.y, pose.position.z);
  return X;
}

/// The joints from base to flange, in this order.
std::vector<urdf::JointConstSharedPtr> path_of_joints(const urdf::ModelInterface& model,
                                                      const surg::RobotConfig& robot,
                                                      const std::string& file) {
  for (const std::string& link : {robot.base_link, robot.flange_link}) {
    if (!model.getLink(link)) {
      std::string known;
      for (const auto& entry : model.links_) known += (known.empty() ? "" : ", ") + entry.first;
      refuse(file, "has no link '" + link + "' (named in " + robot.file + "); it has: " + known);
    }
  }
  std::vector<urdf::JointConstSharedPtr> path;
  for (std::string link = robot.flange_link; link != robot.base_link;) {
    const urdf::JointConstSharedPtr joint = model.getLink(link)->parent_joint;
    if (!joint) {
      refuse(file, "link '" + robot.flange_link + "' does not hang on '" + robot.base_link +
                       "': name base_link and flange_link of one chain in " + robot.file);
    }
    path.push_back(joint);
    link = joint->parent_link_name;
  }
  std::reverse(path.begin(), path.end());
  return path;
}

surg::Chain build_chain(const std::vector<urdf::JointConstSharedPtr>& path,
                        const surg::RobotConfig& robot, const std::string& file) {
  std::vector<surg::Joint> joints;
  surg::Pose X = surg::Pose::Identity();  // from the last movable joint to here
  for (const urdf::JointConstSharedPtr& joint : path) {
    X = X * to_pose(joint->parent_to_joint_origin_transform);
    if (joint->type == urdf::Joint::FIXED) continue;
    if (joint->type != urdf::Joint::REVOLUTE && joint->type != urdf::Joint::CONTINUOUS) {
      refuse(file, "joint '" + joint->name +
                       "' is not revolute, continuous or fixed: such arms are "
                       "not supported");
    }
    const surg::Vector3 axis(joint->axis.x, joint->axis.y, joint->axis.z);
    if (!(axis.norm() > 1e-6)) refuse(file, "joint '" + joint->name + "' has no axis");
    joints.push_back({joint->name, X, axis.normalized()});
    X = surg::Pose::Identity();
  }
  try {
    return surg::Chain(std::move(joints), X);
  } catch (const std::invalid_argument& error) {
    refuse(file, "from '" + robot.base_link + "' to '" + robot.flange_link + "': " + error.what());
  }
}

/// Names the root and its pose in B, where only fixed joints lie between them.
void find_root(const urdf::ModelInterface& urdf, const surg::RobotConfig& robot, Model& model) {
  surg::Pose X_RootB = surg::Pose::Identity();
  std::string link = robot.base_link;
  while (const urdf::JointConstSharedPtr joint = urdf.getLink(link)->parent_joint) {
    if (joint->type != urdf::Joint::FIXED) return;
    X_RootB = to_pose(joint->parent_to_joint_origin_transform) * X_RootB;
    link = joint->parent_link_name;
  }
  if (link == "world") return;
  model.root_link = link;
  model.X_BRoot = X_RootB.inverse();
}

void check_names(const surg::Chain& chain, const surg::RobotConfig& robot,
                 const std::string& file) {
  std::vector<std::string> names;
  for (const surg::Joint& joint : chain.joints()) names.push_back(joint.name);
  if (names == robot.joint_names) return;
  const auto list = [](const std::vector<std::string>& all) {
    std::string text;
    for (const std::string& name : all) text += (text.empty() ? "" : ", ") + name;
    return text;
  };
  refuse(robot.file, "joints.names is [" + list(robot.joint_names) + "], but from '" +
                         robot.base_link + "' to '" + robot.flange_link + "' " + file + " has [" +
                         list(names) + "]: write these, in this order");
}

/// The YAML may tighten what the URDF allows, never loosen it.
void check_limits(const std::vector<urdf::JointConstSharedPtr>& path,
                  const surg::RobotConfig& robot, const std::string& file) {
  int i = 0;
  for (const urdf::JointConstSharedPtr& joint : path) {
    if (joint->type == urdf::Joint::FIXED) continue;
    const auto loose = [&](const std::string& key, double yaml, const std::string& relation,
                           double urdf) {
      refuse(robot.file, key + " of joint '" + joint->name + "' is " + number(yaml) + ", but " +
                             file + " allows " + relation + " " + number(urdf) +
                             ": tighten the YAML");
    };
    if (joint->limits) {
      const urdf::JointLimits& limits = *joint->limits;
      if (!(robot.velocity[i] <= limits.velocity + kLimitSlack)) {
        loose("joints.velocity", robot.velocity[i], "<=", limits.velocity);
      }
      if (joint->type == urdf::Joint::REVOLUTE) {
        if (!(robot.position_min[i] >= limits.lower - kLimitSlack)) {
          loose("joints.position_min", robot.position_min[i], ">=", limits.lower);
        }
        if (!(robot.position_max[i] <= limits.upper + kLimitSlack)) {
          loose("joints.position_max", robot.position_max[i], "<=", limits.upper);
        }
      }
    } else if (joint->type == urdf::Joint::REVOLUTE) {
      refuse(file, "revolute joint '" + joint->name + "' has no <limit>");
    }
    ++i;
  }
}

}  // namespace

double difference_to_kdl(const surg::Chain& chain, const surg::RobotConfig& robot,
                         const std::string& urdf_text, int postures) {
  // KDL knows no inertia of a root link and would warn at every start; kinematics needs none.
  const urdf::ModelInterfaceSharedPtr parsed = urdf::parseURDF(urdf_text);
  if (parsed && parsed->root_link_) parsed->root_link_->inertial.reset();
  KDL::Tree tree;
  KDL::Chain kdl;
  if (!parsed || !kdl_parser::treeFromUrdfModel(*parsed, tree) ||
      !tree.getChain(robot.base_link, robot.flange_link, kdl) ||
      static_cast<int>(kdl.getNrOfJoints()) != chain.dof()) {
    refuse(robot.file, "KDL finds no chain of " + std::to_string(chain.dof()) + " joints from '" +
                           robot.base_link + "' to '" + robot.flange_link + "'");
  }
  KDL::ChainFkSolverPos_recursive fk(kdl);
  KDL::ChainJntToJacSolver jacobian(kdl);
  KDL::JntArray q_kdl(kdl.getNrOfJoints());
  KDL::Jacobian J_kdl(kdl.getNrOfJoints());
  KDL::Frame frame;

  std::mt19937 random(20240501);  // seeded: the same postures at every start
  double worst = 0;
  surg::JointVector q(chain.dof());
  for (int k = 0; k < postures; ++k) {
    for (int i = 0; i < chain.dof(); ++i) {
      q[i] = std::uniform_real_distribution<>(robot.position_min[i], robot.position_max[i])(random);
      q_kdl(i) = q[i];
    }
    surg::Pose X_BF;
    surg::Jacobian J;
    chain.forward(q, X_BF, J);
    if (fk.JntToCart(q_kdl, frame) < 0 || jacobian.JntToJac(q_kdl, J_kdl) < 0) {
      refuse(robot.file, "KDL cannot compute the chain's kinematics");
    }
    for (int row = 0; row < 3; ++row) {
      worst = std::max(worst, std::abs(X_BF.translation()[row] - frame.p[row]));
      for (int column = 0; column < 3; ++column) {
        worst = std::max(worst, std::abs(X_BF.linear()(row, column) - frame.M(row, column)));
      }
    }
    const double difference = (J - J_kdl.data).cwiseAbs().maxCoeff();
    // Written so that a NaN on either side counts as the worst and not as agreement.
    if (!(difference <= worst)) worst = difference;
    if (!X_BF.matrix().allFinite() || !J.allFinite()) return HUGE_VAL;
  }
  return worst;
}

Model load_model(const surg::RobotConfig& robot, const std::string& urdf_path) {
  Model model;
  model.urdf = read_urdf(urdf_path);
  urdf::ModelInterfaceSharedPtr parsed;
  {
    ParserMessages messages;
    parsed = urdf::parseURDF(model.urdf);
    if (!parsed) {
      refuse(urdf_path,
             "is no usable URDF: " +
                 (messages.text().empty() ? "the parser gives no cause" : messages.text()));
    }
  }
  const auto path = path_of_joints(*parsed, robot, urdf_path);
  model.chain = build_chain(path, robot, urdf_path);
  find_root(*parsed, robot, model);
  check_names(model.chain, robot, urdf_path);
  check_limits(path, robot, urdf_path);
  model.kdl_error = difference_to_kdl(model.chain, robot, model.urdf, kPostures);
  if (!(model.kdl_error <= kAgreement)) {
    refuse(urdf_path, "our chain and KDL's differ by " + number(model.kdl_error) +
                          " (allowed: " + number(kAgreement) +
                          "): the file uses something one of them does not "
                          "understand; the arm is not driven on a doubtful model");
  }
  return model;
}

Model load_model(const ArmSetup& setup) {
  Model model = load_model(setup.robot, setup.robot_urdf);
  if (!setup.kinematics) return model;
  try {
    model.chain = surg::with_kinematics(model.chain, *setup.kinematics);
  } catch (const std::invalid_argument& error) {
    refuse(setup.kinematics->file, error.what());
  }
  return model;
}

}  // namespace surg_control
