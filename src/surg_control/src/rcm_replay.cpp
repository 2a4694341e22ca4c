// Recomputes the shaft's geometry of a recorded episode, without ROS:
//   rosrun surg_control rcm_replay EPISODE/cycle_PSM1.csv --cell CELL [--arm PSM1] [--out FILE]
//     [--tolerance METRES]
// Exit code 0: recomputed and recorded values agree; 1: they do not, or the CSV is broken; 2: wrong
// arguments or configuration.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <string>

#include "surg_control/config_loader.hpp"
#include "surg_control/model_loader.hpp"
#include "surg_control/replay.hpp"

namespace {

const char kUsage[] =
    "usage: rcm_replay CYCLE.csv --cell CELL [--arm NAME] [--out FILE.csv] [--tolerance METRES]\n"
    "Recomputes tip, depth and RCM deviation from the recorded joints and compares.\n";

struct Arguments {
  std::string csv, cell, arm, out = "/dev/null";
  double tolerance = 1e-6;  ///< [m]; a CSV with fewer digits than a double may need more
};

[[noreturn]] void wrong(const std::string& what) {
  std::fprintf(stderr, "rcm_replay: %s\n%s", what.c_str(), kUsage);
  std::exit(2);
}

Arguments parse(int argc, char** argv) {
  Arguments arguments;
  std::map<std::string, std::string> options;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (word == "--help" || word == "-h") {
      std::fputs(kUsage, stdout);
      std::exit(0);
    }
    if (word.rfind("--", 0) == 0) {
      if (i + 1 == argc) wrong(word + " needs a value");
      options[word] = argv[++i];
    } else if (arguments.csv.empty()) {
      arguments.csv = word;
    } else {
      wrong("one CSV at a time; '" + word + "' is too much");
    }
  }
  for (const auto& [name, value] : options) {
    if (name == "--cell") {
      arguments.cell = value;
    } else if (name == "--arm") {
      arguments.arm = value;
    } else if (name == "--out") {
      arguments.out = value;
    } else if (name == "--tolerance") {
      char* end = nullptr;
      arguments.tolerance = std::strtod(value.c_str(), &end);
      if (value.empty() || *end != '\0' || !(arguments.tolerance >= 0)) {
        wrong("--tolerance is '" + value + "'; allowed is a number of metres >= 0");
      }
    } else {
      wrong("unknown option " + name);
    }
  }
  if (arguments.csv.empty()) wrong("no CSV named");
  if (arguments.cell.empty()) wrong("no --cell named");
  return arguments;
}

}  // namespace

int main(int argc, char** argv) {
  const Arguments arguments = parse(argc, argv);
  try {
    const surg_control::ArmSetup setup = surg_control::load_arm(arguments.cell, arguments.arm);
    const surg_control::Model model = surg_control::load_model(setup.robot, setup.robot_urdf);
    std::ifstream in(arguments.csv);
    if (!in) wrong("cannot read '" + arguments.csv + "'");
    std::ofstream out(arguments.out);
    if (!out) wrong("cannot write '" + arguments.out + "'");
    const surg_control::ReplayReport report =
        surg_control::replay(in, out, model.chain, setup.tool);
    out.flush();
    if (!out) wrong("cannot write all of '" + arguments.out + "': is the disk full?");
    std::printf("%llu cycles recomputed, %llu without a joint state\n",
                static_cast<unsigned long long>(report.rows),
                static_cast<unsigned long long>(report.skipped));
    std::printf("max |difference| [m]: tip %.3g, depth %.3g, rcm_error %.3g\n", report.tip,
                report.depth, report.rcm_error);
    if (report.rows == 0 || !(report.worst() <= arguments.tolerance)) {
      std::printf("%s\n", report.rows == 0 ? "nothing to compare" : "recording and replay differ");
      return 1;
    }
  } catch (const surg::ConfigError& error) {
    std::fprintf(stderr, "rcm_replay: %s\n", error.what());
    return 2;
  } catch (const surg_control::ReplayError& error) {
    std::fprintf(stderr, "rcm_replay: %s: %s\n", arguments.csv.c_str(), error.what());
    return 1;
  }
  return 0;
}
