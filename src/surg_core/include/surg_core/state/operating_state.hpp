// The CRTK operating state with latched reasons (docs/reference/topics.md, "State").
#pragma once

#include <cstdint>

namespace surg {

enum class State : std::uint8_t { kDisabled = 0, kEnabled = 1, kPaused = 2, kFault = 3 };

/// Why the arm refuses a command, stops or holds. 'sentence' explains it, with the remedy.
enum class Reason : std::uint8_t {
  kNone = 0,
  kNotHomed,             // motion before home
  kNotEnabled,           // motion while not ENABLED
  kNotFinite,            // F01 NaN or infinity in a command
  kStateNotFinite,       // F02 NaN or infinity in the measured state
  kStale,                // F03 stream fell silent
  kLinkLost,             // F10 no joint state
  kRcmUnset,             // F22
  kRcmError,             // F23
  kRcmWhileEnabled,      // F23 rcm/set_cp refused
  kStepTooLarge,         // servo step gate
  kStreamStartTooFar,    // a new pose stream must start near the set-point
  kOutsideWorkspace,     // target outside depth or cone
  kWrongFrame,           // frame_id is not the expected one
  kWrongSize,            // wrong number of joints
  kNoAuthority,          // F26 somebody else holds the arm
  kRefusedTransition,    // state command not possible from here
  kOverrun,              // F27
  kJointLimit,           // F20
  kOperator,             // asked for by a person (pause, disable)
  kNotFollowing,         // the arm stays away from the set-point
  kHeld,                 // a stream goes on after 'hold'
  kNotInserted,          // F24 the tip is near or above the trocar: only insert, withdraw, roll
  kTrackStale,           // rcm/track fell silent, or only outliers came
  kToolLost,             // F31 no jaw state from the tool link
  kUnreachable,          // F20, F21 a limit holds the arm on its way: report, not a state
  kNotArrived,           // a move ended without reaching its target
  kNoTrace,              // nothing recorded to go back along
  kFrameWhileEnabled,    // set_base_frame while ENABLED
  kForce,                // F25 too much force at the tip or on the trocar
  kMasterLost,           // F07 enable and resume without a ROS master
  kNotAtRest,            // home, unhome or rcm/set_cp while the arm is still coming to rest
  kLate,                 // F03 it answers what the arm said before its last stop
  kNoElbow,              // elbow/move_jp to an arm without a null space of its own
  kElbowOutOfReach,      // elbow/move_jp refused, or a report: a limit holds the elbow on its way
  kToolWhileEnabled,     // tool/mount refused: only DISABLED and at rest
  kRobot,                // F33 the robot is not active: stopped, braked, guided…
  kFixture,              // a virtual fixture is in the way, or holds the tip
  kFixtureOfCell,        // the cell states this fixture
  kFixtureWhileEnabled,  // a fixture may be replaced or removed only while not ENABLED
  kFixturesFull,         // no room for another fixture
  kNoFixture,            // no fixture of this name
  kOtherArmLost,         // the clearance guard has no fresh joint state of another arm
  kStateImplausible,     // F02 positions and velocities of the measured state contradict each other
  kJointOutside,         // a joint stands outside its position limits: nothing starts there
};

/// One sentence for people: what is wrong and what to do.
const char* sentence(Reason reason);
/// The short name used in FAULT(name), logs and summary.json.
const char* name(Reason reason);
const char* name(State state);

enum class StateCommand : std::uint8_t { kEnable, kDisable, kPause, kResume, kHome, kUnhome };

/// Conditions of a transition.
struct Conditions {
  Reason state = Reason::kLinkLost;  ///< kNone: a fresh, finite joint state is there
  Reason rcm = Reason::kRcmUnset;    ///< kNone: the shaft passes through a known trocar point
  bool force_ok = true;              ///< the measured forces are below their fault levels
};

/// CRTK state machine. The arm never resumes without a command.
class OperatingState {
 public:
  State state() const { return state_; }
  Reason reason() const { return reason_; }
  bool homed() const { return homed_; }

  /// Requests a transition. Returns kNone when done, otherwise why it was refused.
  Reason request(StateCommand command, const Conditions& now);
  /// Latches FAULT with its cause; the first cause stays.
  void fault(Reason reason);
  /// ENABLED -> PAUSED with a reason.
  void pause(Reason reason);

 private:
  State state_ = State::kDisabled;
  Reason reason_ = Reason::kNone;
  bool homed_ = false;
};

}  // namespace surg
