// Recomputes what was recorded, without ROS. Either the shaft's geometry of an episode:
//   rosrun surg_control rcm_replay EPISODE/cycle_PSM1.csv --cell CELL [--arm PSM1] [--out FILE]
//     [--tolerance METRES]
// or the whole controller from a black box, bit for bit:
//   rosrun surg_control rcm_replay --black-box FILE
// Exit code 0: recomputed and recorded values agree; 1: they do not, or the file is broken; 2:
// wrong arguments or configuration.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <string>

#include "surg_control/files/black_box_file.hpp"
#include "surg_control/files/replay.hpp"
#include "surg_core/files/arm_setup.hpp"

namespace {

const char kUsage[] =
    "usage: rcm_replay CYCLE.csv --cell CELL [--arm NAME] [--out FILE.csv] [--tolerance METRES]\n"
    "       rcm_replay --black-box FILE\n"
    "Recomputes tip, depth and RCM deviation from the recorded joints and compares; or runs a\n"
    "black box's controller again and compares every output bit for bit.\n";

struct Arguments {
  std::string csv, cell, arm, out = "/dev/null", black_box;
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
    if (name == "--black-box") {
      arguments.black_box = value;
    } else if (name == "--cell") {
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
  if (!arguments.black_box.empty()) {
    if (options.size() > 1 || !arguments.csv.empty()) wrong("--black-box stands alone");
    return arguments;
  }
  if (arguments.csv.empty()) wrong("no CSV named");
  if (arguments.cell.empty()) wrong("no --cell named");
  return arguments;
}

/// Runs a black box again. The exit code.
int replay_black_box(const std::string& path) {
  const surg::BlackBoxRecording recording = surg_control::read_black_box(path);
  const surg::BlackBoxLabel& label = recording.label;
  std::printf("%s of %s, written %s by version %s, law %d, limits %s\n", label.arm.c_str(),
              label.cell.c_str(), label.written.c_str(), label.version.c_str(),
              static_cast<int>(recording.setup.options.law),
              surg::limits_hash(recording.setup.robot, recording.setup.limits).c_str());
  for (std::size_t k = 0; k < recording.steps.size(); ++k) {
    const surg::Outputs& out = recording.steps[k].out;
    if (out.state != surg::State::kFault) continue;
    std::printf("FAULT(%s) from cycle %zu of %zu on: %s\n", surg::name(out.reason), k,
                recording.steps.size(), surg::sentence(out.reason));
    break;
  }
  const auto difference = surg::replay(recording);
  if (!difference) {
    std::printf("%zu cycles and %zu commands and calls run again: bit for bit the same\n",
                recording.steps.size(), recording.events.size());
    return 0;
  }
  std::printf("first difference in cycle %zu of %zu: %s\n  recorded %s\n  replayed %s\n",
              difference->step, recording.steps.size(), difference->field.c_str(),
              difference->recorded.c_str(), difference->replayed.c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  const Arguments arguments = parse(argc, argv);
  try {
    if (!arguments.black_box.empty()) return replay_black_box(arguments.black_box);
    const surg::ArmSetup setup = surg::load_arm(arguments.cell, arguments.arm);
    std::ifstream in(arguments.csv);
    if (!in) wrong("cannot read '" + arguments.csv + "'");
    std::ofstream out(arguments.out);
    if (!out) wrong("cannot write '" + arguments.out + "'");
    const surg_control::ReplayReport report =
        surg_control::replay(in, out, setup.model.chain, setup.mounted.tool);
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
  } catch (const surg::BlackBoxError& error) {
    std::fprintf(stderr, "rcm_replay: %s\n", error.what());
    return 1;
  } catch (const surg_control::ReplayError& error) {
    std::fprintf(stderr, "rcm_replay: %s: %s\n", arguments.csv.c_str(), error.what());
    return 1;
  }
  return 0;
}
