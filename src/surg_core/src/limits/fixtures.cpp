#include "surg_core/limits/fixtures.hpp"

#include <algorithm>
#include <cctype>

#include "config/document_reader.hpp"
#include "surg_core/limits/capsule.hpp"

namespace surg {
namespace {

constexpr double kOnAxis = 1e-9;  // [m] a point on the axis or at the centre

/// Share of the shaft, from the trocar at the origin to the tip, that is nearest to the segment.
double nearest_on_shaft(const Vector3& tip, const Vector3& from, const Vector3& axis) {
  const double a = tip.squaredNorm(), b = tip.dot(axis), c = axis.squaredNorm();
  const double d = tip.dot(from), e = axis.dot(from);
  if (!(a > 0)) return 1;
  const double determinant = a * c - b * b;
  const bool parallel = !(determinant > 1e-9 * a * c);
  double shaft = parallel ? 1.0 : std::clamp((c * d - b * e) / determinant, 0.0, 1.0);
  const double along = c > 0 ? std::clamp((b * shaft - e) / c, 0.0, 1.0) : 0.0;
  shaft = std::clamp((d + b * along) / a, 0.0, 1.0);
  return shaft;
}

Vector3 any_across(const Vector3& axis) {
  return axis.squaredNorm() > 0 ? Vector3(axis.unitOrthogonal()) : Vector3(Vector3::UnitZ());
}

}  // namespace

void Fixture::set_name(std::string_view text) {
  name.fill(0);
  std::copy_n(text.begin(), std::min(text.size(), kLongestName), name.begin());
}

std::string check_fixture(Fixture& f) {
  const std::string_view title = f.title();
  const bool word = !title.empty() && std::all_of(title.begin(), title.end(), [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) || c == '_';
  });
  if (!word) return "name is '" + std::string(title) + "'; allowed are letters, digits and _";
  const auto far = [](const Vector3& p) { return !(p.array().abs() <= Fixture::kFarthest).all(); };
  const std::string farthest = config::number(Fixture::kFarthest) + " m";
  if (far(f.point)) return "a coordinate is not finite or beyond " + farthest + " of the base";
  if (f.shape == Fixture::Shape::kPlane) {
    const double length = f.axis.norm();
    if (!(std::abs(length - 1) <= 1e-3)) {
      return "normal has length " + config::number(length) + "; a unit vector is needed";
    }
    f.axis /= length;
    f.radius = 0;
  } else {
    if (f.shape == Fixture::Shape::kSphere) f.axis.setZero();
    if (far(f.point + f.axis)) return "an end is not finite or beyond " + farthest + " of the base";
    const bool hollow = f.side == Fixture::Side::kStayIn;
    const double least = hollow ? Fixture::kLeastHollow : Fixture::kLeastRadius;
    if (!(f.radius >= least && f.radius <= Fixture::kGreatestRadius)) {
      return "radius " + config::number(f.radius) + " m is out of range; allowed is " +
             config::number(least) + " to " + config::number(Fixture::kGreatestRadius) + " m";
    }
  }
  if (f.of == Fixture::Of::kShaft && f.side == Fixture::Side::kStayIn) {
    return "of is 'shaft' with stay_in; allowed is keep_out, as the shaft always reaches out of "
           "the patient";
  }
  return {};
}

Wall wall_at(const Fixture& f, const Vector3& p_Tip) {
  Wall wall;
  const double side = f.side == Fixture::Side::kKeepOut ? 1 : -1;
  if (f.shape == Fixture::Shape::kPlane) {
    // Where the trocar is on the allowed side, the shaft is there if the tip is.
    wall.away = -side * f.axis;
    wall.distance = wall.away.dot(p_Tip - f.point);
    return wall;
  }
  Vector3 p = p_Tip;
  if (f.of == Fixture::Of::kShaft) {
    wall.lever = nearest_on_shaft(p_Tip, f.point, f.axis);
    p = wall.lever * p_Tip;
  }
  const double share = nearest_share(f.point, f.axis, p);
  const Vector3 out = p - (f.point + share * f.axis);
  const double off = out.norm();
  wall.away = side * (off > kOnAxis ? Vector3(out / off) : any_across(f.axis));
  wall.distance = side * (off - f.radius);
  if (side < 0) {
    wall.hollow = f.radius;
    if (share > 0 && share < 1) wall.along = f.axis.normalized();
  }
  return wall;
}

const Fixture* Fixtures::find(std::string_view name) const {
  const Fixture* found =
      std::find_if(begin(), end(), [name](const Fixture& f) { return f.title() == name; });
  return found == end() ? nullptr : found;
}

bool Fixtures::put(const Fixture& fixture) {
  const Fixture* same = find(fixture.title());
  if (same == nullptr && size_ == kMost) return false;
  all_[same == nullptr ? size_++ : same - begin()] = fixture;
  return true;
}

bool Fixtures::remove(std::string_view name) {
  const Fixture* found = find(name);
  if (found == nullptr) return false;
  std::copy(all_.begin() + (found - begin()) + 1, all_.begin() + size_,
            all_.begin() + (found - begin()));
  all_[--size_] = Fixture{};
  return true;
}

Fixtures Fixtures::in_frame(const Pose& X_AB) const {
  Fixtures out = *this;
  for (int i = 0; i < size_; ++i) {
    out.all_[i].point = X_AB * all_[i].point;
    out.all_[i].axis = X_AB.linear() * all_[i].axis;
  }
  return out;
}

Fixtures Fixtures::grown(double reach) const {
  constexpr double kLeft = 1e-4;  // [m] radius of a hollow that is smaller than the reach
  Fixtures out = *this;
  for (int i = 0; i < size_; ++i) {
    Fixture& fixture = out.all_[i];
    const double outwards = fixture.side == Fixture::Side::kKeepOut ? reach : -reach;
    fixture.radius = std::max(fixture.radius + outwards, kLeft);
    if (fixture.shape == Fixture::Shape::kPlane) fixture.point -= outwards * fixture.axis;
  }
  return out;
}

const Fixtures& Fixtures::none() {
  static const Fixtures kNone;
  return kNone;
}

}  // namespace surg
