// A wristed instrument: behind the shaft's roll a pitch axis, a link, a yaw axis and a link to the
// tip. The RCM law moves the wrist centre, the point where the pitch axis crosses the shaft.
//
// Joints: pitch about y of the rolled shaft frame, then yaw about x of the pitched frame, along
// which the jaw's axis lies, too. At zero all z axes lie along the shaft. An instrument is mounted
// with its pitch axis turned about the shaft; poses are those of the tool frame, which a straight
// instrument has as well: at home, with a straight wrist, it is the rcm frame.
#pragma once

#include <array>
#include <optional>

#include "surg_core/types.hpp"

namespace surg {

/// Pitch and yaw [rad] or their rates.
using WristJoints = Eigen::Vector2d;
/// What the instrument's drive turns: pitch, yaw, and the shaft against its holder, 0 where it
/// cannot. The roll of a pose is the arm's and this one together.
using DriveJoints = Eigen::Vector3d;

/// Lengths of the wrist [m].
struct WristGeometry {
  double pitch_to_yaw = 0;  ///< from the pitch axis to the yaw axis
  double yaw_to_tip = 0;
  double turn = 0;  ///< [rad] of the pitch axis about the shaft, against y of the tool frame
  double length() const { return pitch_to_yaw + yaw_to_tip; }
};

/// A point with a rotation, in the rcm frame.
struct TipFrame {
  Vector3 p = Vector3::Zero();
  Matrix3 R = Matrix3::Identity();
};

/// Position of the wrist centre, rotation of the rolled shaft and wrist joints.
struct WristPose {
  TipFrame centre;
  WristJoints joints = WristJoints::Zero();
};

/// The tool frame behind a wrist: R_Tip = R_shaft R_z(turn) R_y(pitch) R_x(yaw) R_z(-turn).
TipFrame tip_of_wrist(const WristGeometry& wrist, const WristPose& pose);

/// The two wrists that hold the tip at a pose in the rcm frame, whose origin is the trocar; the
/// first has |pitch| < pi / 2. Empty where the yaw axis points along the line to the trocar: the
/// roll is free there. The tip's rotation is orthonormal.
std::optional<std::array<WristPose, 2>> wrists_of_tip(const WristGeometry& wrist,
                                                      const TipFrame& tip);

/// Velocity [m/s] and angular velocity [rad/s] of a frame.
struct FrameRate {
  Vector3 v = Vector3::Zero(), omega = Vector3::Zero();
};

/// The tip's motion from that of the shaft at the wrist centre and the wrist's rates [rad/s].
FrameRate tip_rate(const WristGeometry& wrist, const WristPose& pose, const FrameRate& centre,
                   const WristJoints& rates);

/// The motion of centre, shaft and wrist that moves the tip as asked.
struct WristRate {
  Vector3 v_centre = Vector3::Zero();
  double roll_rate = 0;  ///< about the shaft [rad/s]
  WristJoints joints = WristJoints::Zero();
};
/// The shaft turns with the centre about the trocar at the origin. Near the singular pose, where
/// the joints would have to be infinitely fast, the solution is damped.
WristRate wrist_rates(const WristGeometry& wrist, const WristPose& pose, const FrameRate& tip);

}  // namespace surg
