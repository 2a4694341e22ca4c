// Motion commands that a client may send.
#pragma once

#include <cstdint>

#include "surg_core/kinematics/wrist.hpp"
#include "surg_core/types.hpp"

namespace surg {

/// Motion commands, in the numbering of surg_msgs/Cycle.
enum class Motion : std::uint8_t {
  kNone = 0,
  kServoCp = 1,
  kServoJp = 2,
  kServoCv = 3,
  kServoJv = 4,
  kInterpolateCp = 5,
  kMoveCp = 6,
  kHold = 7,
  kJawServoJp = 8,
  kServoJr = 9,  ///< joints: change of the goal
  kInterpolateJp = 10,
  kMoveJp = 11,
  kMoveJr = 12,
  kJawMoveJp = 13,
  kInsert = 14,    ///< along the shaft into the patient, until depth_slow
  kWithdraw = 15,  ///< along the shaft out of the patient
  kRetrace = 16,   ///< back along the recorded joint trace
  kElbowMoveJp = 17,
};

/// One decoded command. Which members count depends on 'motion'.
struct MotionCommand {
  Motion motion = Motion::kNone;
  std::uint32_t source = 0;     ///< id of the sender (the node maps caller ids to numbers)
  Vector3 p = Vector3::Zero();  ///< cp: p_RcmTip; cv: v_Tip, in the rcm frame
  Eigen::Quaterniond rotation =
      Eigen::Quaterniond::Identity();       ///< cp: R_RcmTool (a straight instrument uses the roll)
  double roll_rate = 0;                     ///< cv: about the shaft [rad/s]
  Vector3 omega = Vector3::Zero();          ///< cv: of the tip of a wrist [rad/s], in the rcm frame
  Vector4 joints = Vector4::Zero();         ///< jp / jv: yaw, pitch, insertion, roll
  DriveJoints wrist = DriveJoints::Zero();  ///< jp / jv: pitch and yaw; the handler sets the roll
  double jaw = 0;                           ///< jaw angle [rad]
  double elbow = 0;                         ///< swivel angle [rad]
  std::int64_t stamp_ns = 0;                ///< when it was made, on the sender's clock; 0: unknown
  double age = 0;                           ///< [s] since it arrived
  bool slide = false;  ///< servo_cp: a target outside the workspace slides along its wall
};

/// Whether the command is a stream: each message is the next sample, and silence ends the stream.
inline bool is_servo(Motion motion) {
  return motion == Motion::kServoCp || motion == Motion::kServoJp || motion == Motion::kServoJr ||
         motion == Motion::kServoCv || motion == Motion::kServoJv;
}

/// Whether the command leads to rest at a target that it states.
inline bool has_target(Motion motion) {
  return motion == Motion::kInterpolateCp || motion == Motion::kMoveCp ||
         motion == Motion::kInterpolateJp || motion == Motion::kMoveJp || motion == Motion::kMoveJr;
}

/// Whether the command moves the jaw only.
inline bool is_jaw(Motion motion) {
  return motion == Motion::kJawServoJp || motion == Motion::kJawMoveJp;
}

}  // namespace surg
