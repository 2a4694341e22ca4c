// Flight recorder: the last two seconds of a controller, complete enough to replay them bit for
// bit. Callers drive the controller through it. The control thread copies values into preallocated
// memory: no allocation, lock or I/O. A FAULT freezes the recording; another thread then reads it
// and releases it. docs/reference/black_box.md describes the file.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "surg_core/controller.hpp"

namespace surg {

/// The constructor arguments of a controller.
struct ControllerSetup {
  Chain chain;
  RobotConfig robot;
  Limits limits;
  InstrumentConfig instrument;
  ToolCalibration tool;
  Controller::Options options;
  ClearanceSetup clearance = {};
};

/// Origin of a recording, for people. Replay does not read it.
struct BlackBoxLabel {
  std::string arm, cell;  ///< name of the arm, path of the cell
  std::string written;    ///< date and time
  std::string version;    ///< of the software
};

/// A call between two steps, or one command within a step.
struct BlackBoxEvent {
  enum class Kind : std::uint8_t {
    kRequest,
    kSetRcm,
    kFault,
    kPause,
    kClaim,
    kCommand,
    kSetFixture,
    kRemoveFixture
  };
  Kind kind = Kind::kCommand;
  StateCommand state = StateCommand::kDisable;  ///< kRequest
  Reason reason = Reason::kNone;                ///< kFault, kPause: the argument
  Reason answer = Reason::kNone;                ///< of a call that answers: what came back
  std::uint32_t source = 0;                     ///< kClaim
  Vector3 p_BRcm = Vector3::Zero();             ///< kSetRcm
  MotionCommand command = {};                   ///< kCommand
  Fixture fixture = {};                         ///< kSetFixture; kRemoveFixture: its name
};

/// Inputs and outputs of one step; its commands are events.
struct BlackBoxStep {
  Readings in;
  std::uint32_t events = 0;  ///< calls since the step before, then this step's commands
  std::uint32_t n_commands = 0;
  Outputs out;
};

/// The content of a file: a controller, its snapshot before the first step, and all later calls.
struct BlackBoxRecording {
  BlackBoxLabel label;
  ControllerSetup setup;
  std::vector<std::byte> image;
  std::vector<BlackBoxStep> steps;
  std::vector<BlackBoxEvent> events;  ///< in order; those after the last step included
};

/// Offers the calls of Controller, forwards each and records it.
class BlackBox {
 public:
  static constexpr int kBlocks = 4;        ///< in turn; each begins with the controller's image
  static constexpr int kBlockSteps = 400;  ///< cycles of a block: 0.8 s at 2 ms
  /// A block ends early at this number of calls and commands.
  static constexpr int kBlockEvents = 4 * kBlockSteps;
  static constexpr int kAfter = 150;  ///< steps kept after the fault: its stop belongs to it

  /// 'controller' must have been constructed from 'setup' and must outlive the box. Allocates.
  BlackBox(Controller& controller, const ControllerSetup& setup);

  Reason request(StateCommand command);
  Reason set_rcm(const Vector3& p_BRcm);
  Reason set_fixture(const Fixture& fixture);
  Reason remove_fixture(std::string_view name);
  /// The recording begins anew with the new tool; refused with kNotAtRest until the last FAULT has
  /// been written. Both must outlive the box.
  Reason change_tool(const InstrumentConfig& instrument, const ToolCalibration& tool);
  void fault(Reason reason);
  void pause(Reason reason);
  Reason claim(std::uint32_t source);
  const Outputs& step(const Inputs& inputs);

  /// Freezes after kAfter more steps, as a FAULT does (same thread as step()).
  void trigger();

  /// Whether the recording is frozen. Any thread may ask; it stays frozen until release().
  bool frozen() const { return frozen_.load(std::memory_order_acquire); }
  /// Returns a copy of at least the last 2 s: less after a start, after a release, or in a flood of
  /// commands. Call it from another thread while frozen. Allocates.
  BlackBoxRecording recording(const BlackBoxLabel& label) const;
  /// Resumes recording with the next step. Call it from another thread while frozen.
  void release() { frozen_.store(false, std::memory_order_release); }

 private:
  struct Block {
    std::vector<std::byte> image;
    std::vector<BlackBoxStep> steps;
    std::vector<BlackBoxEvent> events;
    int n_steps = 0, n_events = 0;
  };

  bool recording_now();
  Block& room_for(int events);
  Reason make(const BlackBoxEvent& event);
  BlackBoxEvent* note(const BlackBoxEvent& event);
  void watch(State now, bool recorded);

  Controller& controller_;
  ControllerSetup setup_;
  const InstrumentConfig* instrument_ = nullptr;  // mounted instead of the setup's
  const ToolCalibration* tool_ = nullptr;
  std::vector<Block> blocks_;
  int present_ = -1;   ///< index into blocks_; -1: nothing recorded
  int used_ = 0;       ///< blocks that hold something
  int countdown_ = 0;  ///< steps until frozen; 0: none
  bool was_frozen_ = false;
  State last_ = State::kDisabled;
  std::atomic<bool> frozen_{false};
};

/// The file is no black box, is damaged, or belongs to another build.
class BlackBoxError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Returns the bytes of a file: magic and version, length, contents, checksum.
std::string encode(BlackBoxRecording recording);
/// Throws BlackBoxError.
BlackBoxRecording decode(std::string_view bytes);

/// The first difference between a recording and its replay.
struct BlackBoxDifference {
  std::size_t step = 0;  ///< index of the step; recording.steps.size(): behind the last
  std::string field;     ///< of Outputs, or the call's name
  std::string recorded, replayed;
};

/// Replays a recording on a new controller and compares every answer and every field of Outputs bit
/// for bit. Returns nothing if all are equal. Throws BlackBoxError for a snapshot of another build.
std::optional<BlackBoxDifference> replay(const BlackBoxRecording& recording);

}  // namespace surg
