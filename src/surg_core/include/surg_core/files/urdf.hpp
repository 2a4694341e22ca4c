// The part of URDF that the platform needs: names, joints and limits. One reader decides what a
// usable URDF is, for nodes, checks, simulator and Python alike.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"

namespace surg {

/// What a joint's <limit> states; an attribute that is not there is empty.
struct UrdfLimit {
  std::optional<double> lower, upper;  ///< [rad], or [m] of a prismatic joint
  std::optional<double> velocity;      ///< [rad/s], [m/s]
};

/// Another joint that this one follows: angle = multiplier * the other's + offset.
struct UrdfMimic {
  std::string joint;
  double multiplier = 1, offset = 0;
};

/// One joint of a URDF.
struct UrdfJoint {
  std::string name;
  std::string kind;  ///< "revolute", "continuous", "prismatic", "fixed", "floating" or "planar"
  std::string parent, child;
  Vector3 xyz, rpy;              ///< of <origin>, as written [m], [rad]
  Pose X_PJ = Pose::Identity();  ///< joint frame in the parent link at position 0
  Vector3 axis;                  ///< in the joint frame; of length 1, or 0 where none is stated
  std::optional<UrdfLimit> limit;
  std::optional<UrdfMimic> mimic;
  int line = 0;  ///< in the file, from 1

  bool turning() const { return kind == "revolute" || kind == "continuous"; }
};

/// A URDF file: one tree of links.
struct Urdf {
  std::string file;
  std::string text;  ///< in UTF-8, and stating nothing else
  std::vector<std::string> links;
  std::vector<UrdfJoint> joints;
};

/// Reads a URDF in the encoding that it states. Throws ConfigError for a missing or malformed file,
/// for xacro that nobody has expanded, for a number that is none, and for links and joints that are
/// not one tree.
Urdf load_urdf(const std::string& path);

/// The joints from link 'start' down to link 'end', in this order, fixed ones included. Throws
/// ConfigError for an unknown link, no way from start to end, or a joint on it that is neither
/// revolute, continuous nor fixed, or has no axis.
std::vector<UrdfJoint> joints_between(const Urdf& urdf, const std::string& start,
                                      const std::string& end);

/// The chain of the joints from 'base' to 'flange'; fixed ones are folded into the next turning
/// one. 'joint_names': the turning ones, in this order. Throws ConfigError if they are others, or
/// if one lacks the limits that URDF demands of it: range and speed of a revolute joint, a speed
/// above 0 of any.
Chain chain_of(const Urdf& urdf, const std::string& base, const std::string& flange,
               const std::vector<std::string>& joint_names);

/// Names of a wrist's joints in an instrument's URDF: roll about z where the drive has a motor for
/// it, pitch about y, then yaw about x.
constexpr std::array<const char*, 3> kWristJoints{"wrist_roll", "wrist_pitch", "wrist_yaw"};

/// Pose of 'child' in 'parent', which only fixed joints may separate, and those of a wrist, which
/// stand at zero. Throws ConfigError.
Pose fixed_transform(const Urdf& urdf, const std::string& parent, const std::string& child);

}  // namespace surg
