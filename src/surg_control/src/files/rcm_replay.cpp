// Runs a controller again from a black box, bit for bit, without ROS:
//   rosrun surg_control rcm_replay --black-box FILE
// Exit code 0: recomputed and recorded outputs agree; 1: they do not, or the file is broken; 2:
// wrong arguments.
#include <cstdio>
#include <string>

#include "surg_control/files/black_box_file.hpp"

namespace {

const char kUsage[] =
    "usage: rcm_replay --black-box FILE\n"
    "Runs a black box's controller again and compares every output bit for bit.\n";

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
  const std::string first = argc > 1 ? argv[1] : "";
  if (first == "--help" || first == "-h") {
    std::fputs(kUsage, stdout);
    return 0;
  }
  if (argc != 3 || first != "--black-box") {
    std::fprintf(stderr, "rcm_replay: --black-box FILE is needed, and nothing else\n%s", kUsage);
    return 2;
  }
  try {
    return replay_black_box(argv[2]);
  } catch (const surg::BlackBoxError& error) {
    std::fprintf(stderr, "rcm_replay: %s\n", error.what());
    return 1;
  }
}
