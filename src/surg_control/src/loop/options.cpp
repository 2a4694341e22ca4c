#include "surg_control/loop/options.hpp"

#include <ros/file_log.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "surg_control/topics/decode.hpp"

namespace surg_control {
namespace {

const std::vector<std::string> kNames{"arm",          "black_box", "cell",     "feedback_gain",
                                      "law",          "link",      "mode",     "others",
                                      "participants", "realtime",  "track_rcm"};

[[noreturn]] void refuse(const std::string& name, const std::string& is,
                         const std::string& allowed) {
  throw surg::ConfigError("parameter ~" + name + " is " + is + "; allowed: " + allowed);
}

void refuse_unknown(const ros::NodeHandle& node) {
  std::vector<std::string> all;
  node.getParamNames(all);
  const std::string prefix = node.getNamespace() + "/";
  for (const std::string& full : all) {
    if (full.compare(0, prefix.size(), prefix) != 0) continue;
    const std::string rest = full.substr(prefix.size());
    const std::string name = rest.substr(0, rest.find('/'));
    if (std::find(kNames.begin(), kNames.end(), name) == kNames.end()) {
      throw surg::ConfigError("unknown parameter ~" + name + "; allowed: " + listed(kNames));
    }
  }
}

std::string read_text(const ros::NodeHandle& node, const std::string& name,
                      const std::string& otherwise) {
  XmlRpc::XmlRpcValue value;
  if (!node.getParam(name, value)) return otherwise;
  if (value.getType() != XmlRpc::XmlRpcValue::TypeString) refuse(name, "no text", "text");
  return static_cast<std::string>(value);
}

std::string read_choice(const ros::NodeHandle& node, const std::string& name,
                        const std::vector<std::string>& allowed, const std::string& otherwise) {
  const std::string value = read_text(node, name, otherwise);
  if (value != otherwise && std::find(allowed.begin(), allowed.end(), value) == allowed.end()) {
    refuse(name, "'" + value + "'", listed(allowed));
  }
  return value;
}

/// A list of names, or one text with commas: 'rosrun … _participants:=operator' gives a text in
/// roscpp.
std::vector<std::string> read_names(const ros::NodeHandle& node, const std::string& name) {
  XmlRpc::XmlRpcValue value;
  std::vector<std::string> names;
  if (!node.getParam(name, value)) return names;
  if (value.getType() == XmlRpc::XmlRpcValue::TypeString) {
    std::string text = static_cast<std::string>(value);
    text.erase(std::remove_if(text.begin(), text.end(),
                              [](char c) { return c == '[' || c == ']' || c == ' ' || c == '\''; }),
               text.end());
    std::istringstream stream(text);
    for (std::string word; std::getline(stream, word, ',');) names.push_back(word);
  } else if (value.getType() == XmlRpc::XmlRpcValue::TypeArray) {
    for (int i = 0; i < value.size(); ++i) {
      if (value[i].getType() != XmlRpc::XmlRpcValue::TypeString)
        refuse(name, "no list of names", "names");
      names.push_back(static_cast<std::string>(value[i]));
    }
  } else {
    refuse(name, "no list of names", "a list, or names separated by commas");
  }
  for (std::string& word : names) {
    if (!word.empty() && word.front() == '/') word.erase(0, 1);
    if (word.empty()) refuse(name, "a list with an empty name", "node names");
  }
  return names;
}

double read_gain(const ros::NodeHandle& node) {
  XmlRpc::XmlRpcValue value;
  if (!node.getParam("feedback_gain", value)) return -1;
  double gain = NAN;
  if (value.getType() == XmlRpc::XmlRpcValue::TypeInt) gain = static_cast<int>(value);
  if (value.getType() == XmlRpc::XmlRpcValue::TypeDouble) gain = static_cast<double>(value);
  // 150 /s diverges with 10 ms of delay: nothing above 100 is an experiment worth running.
  if (!(gain >= 0 && gain <= 100)) refuse("feedback_gain", "no number in range", "0 to 100 [1/s]");
  return gain;
}

bool read_flag(const ros::NodeHandle& node, const std::string& name) {
  XmlRpc::XmlRpcValue value;
  if (!node.getParam(name, value)) return false;
  if (value.getType() != XmlRpc::XmlRpcValue::TypeBoolean) refuse(name, "no flag", "true or false");
  return static_cast<bool>(value);
}

}  // namespace

Options read_options(const ros::NodeHandle& private_node) {
  refuse_unknown(private_node);
  Options options;
  options.cell = read_text(private_node, "cell", "");
  if (options.cell.empty()) refuse("cell", "missing", "a cell folder or its cell.yaml");
  options.arm = read_text(private_node, "arm", "");
  options.black_box = read_text(private_node, "black_box", ros::file_log::getLogDirectory());
  if (options.black_box.empty()) options.black_box = ".";
  options.lockstep =
      read_choice(private_node, "mode", {"lockstep", "freerun"}, "lockstep") == "lockstep";
  options.participants = read_names(private_node, "participants");
  if (private_node.hasParam("others")) options.others = read_names(private_node, "others");
  const std::string law = read_choice(private_node, "law", {"ours", "velocity", "paper"}, "ours");
  options.law = law == "paper"      ? surg::Law::kPaper
                : law == "velocity" ? surg::Law::kVelocity
                                    : surg::Law::kExact;
  options.link = read_choice(private_node, "link", {"joint", "twist"}, "");
  options.feedback_gain = read_gain(private_node);
  options.realtime = read_flag(private_node, "realtime");
  options.track_rcm = read_flag(private_node, "track_rcm");
  if (options.realtime && options.lockstep) {
    refuse("realtime", "true in lock-step, which has no thread of its own",
           "false, or ~mode freerun");
  }
  return options;
}

void check_for_arm(const Options& options, const surg::ArmSetup& setup) {
  if (setup.arm.link == "simulator") return;
  const std::string why = "only for an arm whose link is 'simulator', and the link of " +
                          setup.arm.name + " is '" + setup.arm.link + "'";
  if (options.law == surg::Law::kPaper) refuse("law", "'paper'", why);
  if (options.feedback_gain >= 0) {
    refuse("feedback_gain", std::to_string(options.feedback_gain), why);
  }
}

bool commands_twist(const Options& options, const surg::ArmSetup& setup) {
  if (!options.link.empty()) return options.link == "twist";
  return setup.robot.command == surg::Command::kCartesianVelocity;
}

}  // namespace surg_control
