#include "surg_core/motion/setpoint.hpp"

#include <algorithm>
#include <cmath>

#include "surg_core/law/rcm.hpp"
#include "surg_core/limits/workspace.hpp"

namespace surg {
namespace {

constexpr double kFixtureBraking = 0.5;  // of the tip's acceleration, before a fixture
constexpr double kOnWall = 1e-5;         // [m] a profile that begins on a wall may run along it
constexpr double kWallRounding = 1e-9;   // [m]
constexpr int kWaySamples = 256;         // of a profile between fixtures, at most

Vector3 position(const Dofs& dofs) { return {dofs[0].x, dofs[1].x, dofs[2].x}; }
Vector3 velocity(const Dofs& dofs) { return {dofs[0].v, dofs[1].v, dofs[2].v}; }

/// More than any place of a stop can be from p. No axis is ever faster than where its full jerk has
/// brought the acceleration to zero.
double longest_way(const std::array<StreamFilter, 4>& filters,
                   const std::array<DofLimits, 4>& limits, const Vector3& p, double duration) {
  Vector3 way;
  for (int i = 0; i < 3; ++i) {
    const Kinematic& from = filters[i].state();
    const double fastest = std::abs(from.v) + 0.5 * from.a * from.a / limits[i].jerk;
    way[i] = std::abs(from.x - p[i]) + fastest * duration;
  }
  return way.norm();
}

}  // namespace

Dofs to_spherical(const Dofs& cartesian) {
  const Vector3 p = position(cartesian), v = velocity(cartesian);
  const double depth = std::max(p.norm(), 1e-6);
  const Vector3 s = p / depth;
  const Vector3 s_dot = (v - s * s.dot(v)) / depth;
  const Eigen::Vector2d angles = shaft_angles(s);
  const double cos_pitch = std::max(std::cos(angles[1]), 1e-6);
  Dofs out{};
  out[0] = {angles[0], (s_dot.x() * s.z() - s.x() * s_dot.z()) / (cos_pitch * cos_pitch), 0};
  out[1] = {angles[1], s_dot.y() / cos_pitch, 0};
  out[2] = {depth, s.dot(v), 0};
  out[3] = {cartesian[3].x, cartesian[3].v, 0};
  return out;
}

Dofs to_cartesian(const Dofs& spherical) {
  const auto& [yaw, pitch, insertion, roll] = spherical;
  const Vector3 s = shaft_direction(yaw.x, pitch.x);
  const Vector3 s_dot = shaft_direction_rate(yaw.x, pitch.x, yaw.v, pitch.v);
  const Vector3 p = insertion.x * s;
  const Vector3 v = insertion.v * s + insertion.x * s_dot;
  return {Kinematic{p.x(), v.x(), 0}, Kinematic{p.y(), v.y(), 0}, Kinematic{p.z(), v.z(), 0},
          Kinematic{roll.x, roll.v, 0}};
}

Setpoint::Setpoint(const Limits& limits, const Options& options)
    : limits_(limits),
      paper_(options.paper),
      base_duration_(options.profiler_duration),
      held_(options.held),
      input_(options.stream_delay, options.tremor) {
  profiler_ = Profiler(dof_limits(Space::kCartesian), base_duration_);
}

std::array<DofLimits, 4> Setpoint::dof_limits(Space space) const {
  const DofLimits tip{limits_.tip_velocity, limits_.tip_acceleration, limits_.tip_jerk};
  const DofLimits pivot{limits_.pivot_velocity, limits_.pivot_acceleration, limits_.pivot_jerk};
  const DofLimits roll{limits_.roll_velocity, limits_.roll_acceleration, limits_.roll_jerk};
  return space == Space::kCartesian ? std::array<DofLimits, 4>{tip, tip, tip, roll}
                                    : std::array<DofLimits, 4>{pivot, pivot, tip, roll};
}

void Setpoint::reset(const Vector3& p_RTip, const Vector3& s_R, double roll) {
  mode_ = Mode::kRest;
  space_ = Space::kCartesian;
  move_after_stop_ = at_wall_ = false;
  axis_R_ = s_R;
  axial_ = p_RTip.dot(s_R) < limits_.depth_min;
  dofs_ = {Kinematic{p_RTip.x(), 0, 0}, Kinematic{p_RTip.y(), 0, 0}, Kinematic{p_RTip.z(), 0, 0},
           Kinematic{roll, 0, 0}};
}

void Setpoint::switch_space(Space space) {
  if (space != space_) {
    dofs_ = space == Space::kSpherical ? to_spherical(dofs_) : to_cartesian(dofs_);
    space_ = space;
  }
  const auto limits = dof_limits(space);
  for (int i = 0; i < 4; ++i) {
    filters_[i] = StreamFilter(limits[i]);
    filters_[i].reset(dofs_[i]);
  }
}

void Setpoint::add_stream_sample(Space space, const std::array<double, 4>& target, double age,
                                 std::int64_t stamp_ns) {
  if (mode_ != Mode::kStream || space != space_) {
    axial_ = false;
    switch_space(space);
    if (paper_) profiler_ = Profiler(dof_limits(space), base_duration_);
    mode_ = Mode::kStream;
    std::array<double, 4> acceleration;
    const auto limits = dof_limits(space);
    for (int i = 0; i < 4; ++i) acceleration[i] = limits[i].acceleration;
    input_.begin(target, dofs_, acceleration, age, stamp_ns);
  } else {
    input_.add(target, age, stamp_ns);
  }
  target_ = target;
}

void Setpoint::set_velocity(Space space, const std::array<double, 4>& rate) {
  if (mode_ != Mode::kVelocity || space != space_) {
    axial_ = false;
    switch_space(space);
    mode_ = Mode::kVelocity;
  }
  // A velocity above its limit keeps its direction: one factor for all.
  const auto limits = dof_limits(space);
  double factor = 1;
  for (int i = 0; i < 4; ++i) {
    if (std::abs(rate[i]) > limits[i].velocity) {
      factor = std::min(factor, limits[i].velocity / std::abs(rate[i]));
    }
  }
  for (int i = 0; i < 4; ++i) rate_[i] = factor * rate[i];
}

bool Setpoint::move_to(Space space, const std::array<double, 4>& target, const Fixtures& fixtures) {
  Setpoint direct = *this;
  direct.axial_ = false;
  direct.profile_duration_ = base_duration_;
  Setpoint rested = direct;
  if (direct.plan(space, target, fixtures)) {
    *this = direct;
    return true;
  }
  // From rest the path differs: a line in the space of the profile.
  for (auto& dof : rested.dofs_) dof.v = dof.a = 0;
  if (!rested.plan(space, target, fixtures)) return false;
  axial_ = false;
  profile_duration_ = base_duration_;
  target_ = target;
  target_space_ = space;
  stop();
  move_after_stop_ = true;
  return true;
}

void Setpoint::move_along(const Vector3& s_R, double depth, double speed) {
  const Vector3 p = p_RTip(), end = s_R * depth;
  axial_ = true;
  axis_R_ = s_R;
  // Rest to rest, the quintic's peak velocity is 15/8 of the mean.
  profile_duration_ = std::max(base_duration_, 15.0 / 8.0 * (end - p).norm() / speed);
  plan(Space::kCartesian, {end.x(), end.y(), end.z(), dofs_[3].x}, Fixtures::none());
}

/// Plans a profile and returns whether it stays inside the workspace and clear of the fixtures;
/// mode and profile are set in any case.
bool Setpoint::plan(Space space, const std::array<double, 4>& target, const Fixtures& fixtures) {
  if (space_ != space) switch_space(space);
  profiler_ = Profiler(dof_limits(space), profile_duration_);
  profiler_.reset(dofs_);
  profiler_.plan(target);
  mode_ = Mode::kProfile;
  target_ = target;
  target_space_ = space;
  move_after_stop_ = false;
  return axial_ || (!plan_leaves_workspace() && way_is_clear(fixtures));
}

/// Goes along the profile in steps that cannot reach a fixture.
bool Setpoint::way_is_clear(const Fixtures& fixtures) const {
  if (mode_ != Mode::kProfile || fixtures.empty()) return true;
  const Slide from_here = slide(fixtures);
  const double tip = std::sqrt(3.0) * limits_.tip_velocity;
  const double turning = std::sqrt(2.0) * limits_.pivot_velocity * limits_.depth_max;
  const double fastest = space_ == Space::kCartesian ? tip : tip + turning;
  const double left = profiler_.duration(), least = left / kWaySamples;
  for (double t = 0;;) {
    const auto x = profiler_.position_after(t);
    const double clearance = from_here.clearance(tip_of(x[0], x[1], x[2]));
    if (clearance < -kOnWall) return false;
    if (t >= left) return true;
    t = std::min(t + std::max(clearance / fastest, least), left);
  }
}

/// Samples the profile: a quintic that starts in motion overshoots, and the workspace is not convex
/// (its inner boundary is a sphere), so checking target and straight line is not enough.
bool Setpoint::plan_leaves_workspace() const {
  constexpr int kSamples = 32;
  Profiler ahead = profiler_;
  const double step = ahead.duration() / kSamples;
  const Vector3 from = p_RTip(), s = s_R();
  const double shallow = std::min(limits_.depth_slow, from.norm());
  for (int i = 0; i < kSamples; ++i) {
    ahead.advance(step);
    const Dofs& dofs = ahead.state();
    const Vector3 p = tip_of(dofs[0].x, dofs[1].x, dofs[2].x);
    if (farther_outside(p)) return true;
    if (aside_near_trocar(p, s, shallow)) return true;
  }
  return false;
}

/// Outside the workspace, and more so than the set-point is now.
bool Setpoint::farther_outside(const Vector3& p_RTip) const {
  const double there = outside_workspace(limits_, p_RTip);
  return there > 0 && there > outside_workspace(limits_, this->p_RTip());
}

void Setpoint::stop() {
  move_after_stop_ = false;
  if (mode_ == Mode::kRest || mode_ == Mode::kStopping) return;
  // If a limit slows the clock, the tip is slower than the profile, and the ramp starts at the
  // tip's own speed. From the profile's speed the arm would not brake until both agree.
  for (auto& dof : dofs_) dof.v *= clock_rate_;
  switch_space(Space::kCartesian);
  mode_ = Mode::kStopping;
}

void Setpoint::restart_from_rest(const Fixtures& fixtures) {
  for (auto& dof : dofs_) dof.v = dof.a = 0;
  for (int i = 0; i < 4; ++i) filters_[i].reset(dofs_[i]);
  if (mode_ == Mode::kProfile && !plan(target_space_, target_, fixtures)) mode_ = Mode::kRest;
  if (mode_ == Mode::kStopping) come_to_rest(fixtures);
}

void Setpoint::resync(const Vector3& p_RTip, const Vector3& v_RTip) {
  if (!has_no_path() || axial_) return;
  place(p_RTip, v_RTip, Vector3::Zero());
}

void Setpoint::coast(double dt, const Fixtures& fixtures) {
  const Vector3 p_before = p_RTip();
  const Slide from_here = slide(fixtures);
  for (int i = 0; i < 4; ++i) {
    dofs_[i].x += dt * dofs_[i].v;  // a goes on in the next cycle: rebuilt from 0, it never could
    filters_[i].reset(dofs_[i]);
  }
  restrict_step(p_before);
  if (!fixtures.empty()) keep_to(from_here, p_before, dt);
}

void Setpoint::come_to_rest(const Fixtures& fixtures) {
  mode_ = Mode::kRest;
  if (move_after_stop_ && !plan(target_space_, target_, fixtures)) mode_ = Mode::kRest;
}

void Setpoint::advance(double dt, const Fixtures& fixtures) {
  if (!(dt > 0)) return;
  if (tick_ > 0) clock_rate_ = std::min(dt / tick_, 1.0);
  at_wall_ = at_fixture_ = false;
  if (fixtures.empty() || axial_ || mode_ == Mode::kRest || mode_ == Mode::kProfile) {
    advance_freely(dt, fixtures);
    return;
  }
  const Vector3 p_before = p_RTip();
  const Slide from_here = slide(fixtures);
  advance_freely(dt, fixtures);
  keep_to(from_here, p_before, dt);
}

/// Does not enforce the fixtures, but plans with them.
void Setpoint::advance_freely(double dt, const Fixtures& fixtures) {
  const Vector3 p_before = p_RTip();
  switch (mode_) {
    case Mode::kRest:
      break;
    case Mode::kStream:
      advance_stream(dt, fixtures);
      break;
    case Mode::kVelocity:
      advance_velocity(dt, fixtures);
      break;
    case Mode::kProfile:
      profiler_.advance(dt);
      dofs_ = profiler_.state();
      if (profiler_.done()) {
        for (auto& dof : dofs_) dof.v = dof.a = 0;
        mode_ = Mode::kRest;
      }
      return;
    case Mode::kStopping:
      advance_stopping(dt, fixtures);
      break;
  }
  restrict_step(p_before);
}

void Setpoint::yield_to(const Vector3& push_R) {
  push_R_ = push_R;
  if (mode_ == Mode::kProfile && v_RTip().dot(push_R_) < 0) stop();
}

/// Removes forbidden parts of a step: lateral motion near the trocar, where the shaft would turn
/// too fast (F24), and motion against a contact force (F25). Profiles are planned clear of both.
void Setpoint::restrict_step(const Vector3& p_before) {
  const double depth = p_before.norm(), fade = lateral_fade(limits_, depth);
  if (axial_ || (fade >= 1 && push_R_.isZero(0))) return;
  const Vector3 s = p_before / depth, moved = p_RTip() - p_before;
  Vector3 step = s * s.dot(moved) + fade * (moved - s * s.dot(moved));
  step -= std::min(0.0, step.dot(push_R_)) * push_R_;
  place_tip(p_before + step);
}

/// Keeps the velocity.
void Setpoint::place_tip(const Vector3& p_RTip) {
  if (space_ == Space::kCartesian) {
    for (int i = 0; i < 3; ++i) dofs_[i].x = p_RTip[i];
  } else {
    const Eigen::Vector2d angles = shaft_angles(p_RTip.normalized());
    dofs_[0].x = angles[0];
    dofs_[1].x = angles[1];
    dofs_[2].x = p_RTip.norm();
  }
  for (int i = 0; i < 3; ++i) filters_[i].reset(dofs_[i]);
}

void Setpoint::shift(const Vector3& by_R) {
  if (mode_ == Mode::kProfile) stop();
  place_tip(p_RTip() + by_R);
}

Slide Setpoint::slide(const Fixtures& fixtures) const {
  const double brake = std::max(limits_.stop_deceleration, limits_.tip_acceleration);
  return {fixtures,
          p_RTip(),
          fixtures.empty() ? Vector3::Zero() : v_RTip(),
          kFixtureBraking * limits_.tip_acceleration,
          brake,
          held_};
}

/// Takes what leads into a fixture out of the last step, and out of the velocity and acceleration
/// with which the next one begins.
void Setpoint::keep_to(const Slide& slide, const Vector3& p_before, double dt) {
  if (axial_ || mode_ == Mode::kProfile) return;
  const Vector3 moved = p_RTip() - p_before, v = v_RTip();
  const Vector3 step = slide.step(moved, dt), v_kept = slide.velocity(v, step, dt);
  if (step == moved && v_kept == v) return;
  at_fixture_ = true;
  Dofs rates = dofs_;  // the accelerations as if they were velocities: both turn alike
  for (auto& dof : rates) dof.v = dof.a;
  const Vector3 a = velocity(space_ == Space::kCartesian ? rates : to_cartesian(rates));
  place(p_before + step, v_kept, slide.acceleration(a, step, v_kept));
}

/// Puts the tip to a place, moving; roll stays.
void Setpoint::place(const Vector3& p, const Vector3& v, const Vector3& a) {
  Dofs there{}, rates{};
  for (int i = 0; i < 3; ++i) {
    there[i] = {p[i], v[i], 0};
    rates[i] = {p[i], a[i], 0};
  }
  if (space_ == Space::kSpherical) {
    there = to_spherical(there);
    rates = to_spherical(rates);
  }
  for (int i = 0; i < 3; ++i) {
    dofs_[i] = {there[i].x, there[i].v, rates[i].v};
    filters_[i].reset(dofs_[i]);
  }
}

/// The target of a stream, brought back from behind a fixture.
Dofs Setpoint::target_clear_of(const Fixtures& fixtures, const Dofs& target) {
  if (fixtures.empty()) return target;
  const Dofs there = space_ == Space::kCartesian ? target : to_cartesian(target);
  const Slide::Target wished{position(there), velocity(there)};
  const Slide::Target clear = slide(fixtures).target(wished);
  if (clear.p == wished.p) return target;
  at_fixture_ = true;
  Dofs out = there;
  for (int i = 0; i < 3; ++i) out[i] = {clear.p[i], clear.v[i], 0};
  return space_ == Space::kCartesian ? out : to_spherical(out);
}

void Setpoint::elapse(double T, bool heard) {
  tick_ = T;
  input_.elapse(T, heard);
}

void Setpoint::advance_stream(double dt, const Fixtures& fixtures) {
  if (paper_) {
    profiler_.reset(dofs_);
    profiler_.plan_fixed(target_, base_duration_);
    profiler_.advance(dt);
    dofs_ = profiler_.state();
    return;
  }
  // The tick is taken only if the hardest stop after it ends inside the workspace. Otherwise that
  // stop begins or continues; it was possible before.
  auto next = filters_;
  const Dofs target = target_clear_of(fixtures, input_.target(dt));
  const Dofs hand = input_.estimate(dt);
  const bool delayed = input_.delayed();
  for (int i = 0; i < 4; ++i) next[i].step(target[i], dt, period_, delayed ? &hand[i] : nullptr);
  at_wall_ = stop_leaves_workspace(next);
  for (int i = 0; i < 4; ++i) {
    if (at_wall_ && i < 3) {
      filters_[i].brake(dt);
    } else {
      filters_[i] = next[i];
    }
    dofs_[i] = filters_[i].state();
  }
}

/// Whether the tip leaves the workspace when every axis brakes as hard as its limits allow. The
/// axes stop one after the other on a curved path, which is checked in several places. Most stops
/// are too short to reach a wall, and no place is looked at: a way of r changes a distance to the
/// walls by 2 r at the most.
bool Setpoint::stop_leaves_workspace(const std::array<StreamFilter, 4>& filters) const {
  constexpr int kPlaces = 8;
  const auto limits = dof_limits(space_);
  std::array<Braking, 3> stops;
  double duration = 0;
  for (int i = 0; i < 3; ++i) {
    stops[i] = Braking::stop(filters[i].state(), limits[i]);
    duration = std::max(duration, stops[i].duration());
  }
  if (space_ == Space::kCartesian) {
    const double way = longest_way(filters, limits, p_RTip(), duration);
    if (outside_workspace(limits_, p_RTip()) + 2 * way < -kWallRounding) return false;
  }
  for (int k = 1; k <= kPlaces; ++k) {
    std::array<double, 3> x;
    for (int i = 0; i < 3; ++i) x[i] = stops[i].at(duration * k / kPlaces).x;
    if (leaves_workspace(tip_of(x[0], x[1], x[2]))) return true;
  }
  return false;
}

/// Whether the way to a point of the rcm frame leaves the workspace. Near the trocar restrict_step
/// removes the lateral part, so the axial part alone is checked as well.
bool Setpoint::leaves_workspace(const Vector3& to) const {
  const Vector3 p = p_RTip(), s = s_R();
  return farther_outside(to) || farther_outside(p + s * s.dot(to - p));
}

void Setpoint::advance_velocity(double dt, const Fixtures& fixtures) {
  // At the boundary: stop if a stop begun two ticks later would end outside, and do not start if
  // the requested velocity leads farther outside. Motion back inside is never restricted.
  const Vector3 p = p_RTip(), v = v_RTip();
  const double rest_time = std::max(v.norm() / limits_.stop_deceleration, rest_time_);
  const double stop_time = rest_time / 2 + 2 * dt;
  if (leaves_workspace(p + stop_time * v)) {
    at_wall_ = true;
    stop();
    advance_stopping(dt, fixtures);
    return;
  }
  std::array<double, 4> rate = rate_;
  Dofs wish = dofs_;
  for (int i = 0; i < 4; ++i) wish[i].v = rate[i];
  const Vector3 v_wish = velocity(space_ == Space::kCartesian ? wish : to_cartesian(wish));
  if (farther_outside(p + 0.01 * v_wish)) {
    at_wall_ = true;
    rate[0] = rate[1] = rate[2] = 0;
  }
  const double roll_room = limits_.roll_max - std::copysign(dofs_[3].x, dofs_[3].x * rate[3]);
  const double roll_rate = std::min(std::abs(rate[3]), kApproachGain * std::max(roll_room, 0.0));
  at_wall_ |= roll_rate < std::abs(rate[3]);
  rate[3] = std::copysign(roll_rate, rate[3]);
  for (int i = 0; i < 4; ++i) {
    const Kinematic& now = dofs_[i];
    // The position error that the filter sees is zero: only the velocity is followed.
    const Kinematic target{now.x + now.v * dt + 0.5 * now.a * dt * dt, rate[i], 0};
    filters_[i].step(target, dt);
    dofs_[i] = filters_[i].state();
  }
}

void Setpoint::advance_stopping(double dt, const Fixtures& fixtures) {
  const Vector3 v = velocity(dofs_);
  const double speed = v.norm();
  const double slower = std::max(0.0, speed - limits_.stop_deceleration * dt);
  const double keep = speed > 0 ? slower / speed : 0.0;
  for (int i = 0; i < 3; ++i) {
    dofs_[i].x += 0.5 * (1 + keep) * dofs_[i].v * dt;
    dofs_[i].v *= keep;
    dofs_[i].a = 0;
  }
  Kinematic& roll = dofs_[3];
  const double roll_speed = std::max(0.0, std::abs(roll.v) - limits_.roll_acceleration * dt);
  const double roll_next = std::copysign(roll_speed, roll.v);
  roll.x += 0.5 * (roll.v + roll_next) * dt;
  roll = {roll.x, roll_next, 0};
  if (slower == 0 && roll_speed == 0) come_to_rest(fixtures);
}

Vector3 Setpoint::p_RTip() const { return tip_of(dofs_[0].x, dofs_[1].x, dofs_[2].x); }

Vector3 Setpoint::tip_of(double x, double y, double z) const {
  return space_ == Space::kCartesian ? Vector3(x, y, z) : Vector3(z * shaft_direction(x, y));
}

Vector3 Setpoint::v_RTip() const {
  return velocity(space_ == Space::kCartesian ? dofs_ : to_cartesian(dofs_));
}

Setpoint::TipAndRoll Setpoint::after(double dt, const Fixtures& fixtures) const {
  if (!(dt > 0)) return {p_RTip(), roll()};
  if (mode_ == Mode::kProfile) {
    const auto x = profiler_.position_after(dt);
    return {tip_of(x[0], x[1], x[2]), x[3]};
  }
  Setpoint there = *this;
  there.advance(dt, fixtures);
  return {there.p_RTip(), there.roll()};
}

Setpoint::TipAndRoll Setpoint::predict(double t) const {
  if (mode_ == Mode::kProfile) return after(t);
  std::array<double, 4> x;
  for (int i = 0; i < 4; ++i) x[i] = dofs_[i].x + t * dofs_[i].v;
  return {tip_of(x[0], x[1], x[2]), x[3]};
}

Vector3 Setpoint::s_R() const { return axial_ ? axis_R_ : Vector3(p_RTip().normalized()); }

Vector4 Setpoint::joints() const {
  const Vector3 s = s_R();
  const Eigen::Vector2d angles = shaft_angles(s);
  return {angles[0], angles[1], s.dot(p_RTip()), roll()};
}

}  // namespace surg
