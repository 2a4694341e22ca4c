// Virtual fixtures: regions (plane, sphere, capsule) that the instrument's tip, or its shaft inside
// the patient, keeps out of or stays in. Signed distances with their gradients, and a list of fixed
// size. slide.hpp limits a motion by them.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <string_view>

#include "surg_core/types.hpp"

namespace surg {

/// One region, in the frame of its list.
struct Fixture {
  enum class Shape : std::uint8_t { kPlane = 0, kSphere = 1, kCapsule = 2 };
  enum class Side : std::uint8_t { kKeepOut = 0, kStayIn = 1 };
  enum class Of : std::uint8_t { kTip = 0, kShaft = 1 };
  static constexpr std::size_t kLongestName = 31;
  static constexpr double kFarthest = 3.0;        ///< [m] of a coordinate
  static constexpr double kLeastRadius = 0.001;   ///< [m] of a keep-out region
  static constexpr double kLeastHollow = 0.005;   ///< [m] radius of a stay-in region
  static constexpr double kGreatestRadius = 1.0;  ///< [m] of any region

  std::array<char, kLongestName + 1> name{};  ///< letters, digits and _; zeros behind it
  Shape shape = Shape::kSphere;
  Side side = Side::kKeepOut;
  Of of = Of::kTip;
  bool of_cell = false;             ///< stated by the cell: cannot be replaced or removed
  Vector3 point = Vector3::Zero();  ///< [m] on the plane, centre, or one end of the axis
  Vector3 axis = Vector3::UnitZ();  ///< plane: unit normal into the region; capsule: to the
                                    ///< other end of the axis [m]
  double radius = 0;                ///< [m] sphere, capsule

  std::string_view title() const { return name.data(); }
  /// Takes at most kLongestName characters.
  void set_name(std::string_view text);
};

/// Empty, or what is wrong with a region: the value and what is allowed. Scales a plane's normal to
/// unit length.
std::string check_fixture(Fixture& fixture);

/// Where a tip position stands to a region.
struct Wall {
  double distance = 0;       ///< [m] positive: allowed
  Vector3 away;              ///< unit direction in which the distance grows
  double lever = 1;          ///< growth of the distance per length of tip motion along 'away'
  double hollow = INFINITY;  ///< [m] radius of a wall that the tip is inside of
  Vector3 along = Vector3::Zero();  ///< unit direction in which a hollow wall is straight
};

/// The shaft reaches from the origin of the frame (the trocar) to the tip.
Wall wall_at(const Fixture& fixture, const Vector3& p_Tip);

/// Up to kMost regions of one arm. A plain value.
class Fixtures {
 public:
  static constexpr int kMost = 16;  ///< fixtures of one arm

  int size() const { return size_; }
  bool empty() const { return size_ == 0; }
  const Fixture& operator[](int i) const { return all_[i]; }
  const Fixture* begin() const { return all_.data(); }
  const Fixture* end() const { return all_.data() + size_; }

  /// The region of this name, or null.
  const Fixture* find(std::string_view name) const;
  /// Adds a region, or replaces the one of the same name. False: no room.
  bool put(const Fixture& fixture);
  bool remove(std::string_view name);
  /// The same regions in frame A, with X_AB the pose of the present frame in it.
  Fixtures in_frame(const Pose& X_AB) const;

  /// The same for a point from which the tip is up to 'reach' [m] away: keep-out regions grow, and
  /// stay-in regions shrink.
  Fixtures grown(double reach) const;

  /// None, for motions that have no fixtures.
  static const Fixtures& none();

 private:
  int size_ = 0;
  std::array<Fixture, kMost> all_{};
};

}  // namespace surg
