"""Hand-written mutants of the core: each breaks one thing that must never break unnoticed.

A mutant names a file below `src/surg_core`, text that occurs there exactly once, what stands there
instead, and why it matters. Where two checks guard the same thing, the mutant takes both away.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Edit:
    """One replacement.

    Attributes:
        file: Path below `src/surg_core`.
        text: What is there, exactly once.
        instead: What the mutant has there.
    """

    file: str
    text: str
    instead: str


@dataclass(frozen=True)
class Mutant:
    """A fault in the core.

    Attributes:
        name: Short name, part of the test's name.
        why: What would happen to a user.
        edits: The replacements; more than one where checks are redundant.
        first: Test programs that are tried first; the others follow.
    """

    name: str
    why: str
    edits: tuple[Edit, ...]
    first: tuple[str, ...] = ()


@contextmanager
def applied(mutant: Mutant, root: Path) -> Iterator[None]:
    """The fault in the files below ``root``, which are as before afterwards."""
    before = {edit.file: (root / edit.file).read_text() for edit in mutant.edits}
    try:
        for edit in mutant.edits:
            text = (root / edit.file).read_text()
            assert text.count(edit.text) == 1, (
                f"{edit.file} holds this {text.count(edit.text)} times, once is needed; write the "
                f"mutant anew:\n{edit.text}"
            )
            (root / edit.file).write_text(text.replace(edit.text, edit.instead))
        yield
    finally:
        for file, text in before.items():
            (root / file).write_text(text)


def one(
    name: str, why: str, file: str, text: str, instead: str, first: tuple[str, ...] = ()
) -> Mutant:
    """A mutant of a single place."""
    return Mutant(name, why, (Edit(file, text, instead),), first)


MUTANTS: tuple[Mutant, ...] = (
    # -- time and gaps
    one(
        "late_cycles_count_once",
        "F27: a cycle of 20 ms moves the set-point by 2 ms, and the pivot by more than 1 mm",
        "src/state/cycle_clock.cpp",
        "? 0 : 1 + std::max(missed, 0);",
        "? 0 : 1;",
        ("test_cycle_time",),
    ),
    one(
        "rest_of_a_period_lost",
        "cycles of 3 ms: the set-point stays behind the clock",
        "src/state/cycle_clock.cpp",
        "rest_ -= (periods_ - 1) * period_;",
        "rest_ = 0;",
        ("test_cycle_time",),
    ),
    one(
        "starved_arm_goes_on",
        "F27: every cycle takes four periods and nobody says so",
        "src/controller/controller_guards.cpp",
        "if (clock.overrun()) pause(Reason::kOverrun);",
        "",
        ("test_cycle_time",),
    ),
    one(
        "full_speed_after_a_gap",
        "the link has stopped the arm, and the first command is the old full speed",
        "src/controller/controller_guards.cpp",
        "if (state_known && clock.gap() && commanded_to_move) {",
        "if (false && commanded_to_move) {",
        ("test_cycle_time",),
    ),
    one(
        "lost_commands_unseen",
        "commands were lost, the link has stopped the arm, and the next command is full speed",
        "src/controller/controller_guards.cpp",
        "if (unexplained < StateCheck::kLost) return false;",
        "if (unexplained < 100000) return false;",
        ("test_cycle_time",),
    ),
    one(
        "a_stopped_robot_is_commanded_on",
        "a protective stop leaves the arm ENABLED, and it leaps when it is unlocked",
        "src/controller/controller_guards.cpp",
        "if (robot_reason == Reason::kNone) return;",
        "if (true) return;",
        ("test_controller_robot",),
    ),
    one(
        "an_old_condition_is_believed",
        "a link that no longer says the robot's condition counts as a healthy one",
        "src/controller/controller_guards.cpp",
        "const bool fresh = in.condition_age <= robot.tuning.link_timeout + kStatusPeriods;",
        "const bool fresh = true;",
        ("test_controller_robot",),
    ),
    one(
        "standstill_unseen",
        "an arm that stands still against slow commands is never noticed",
        "src/controller/controller_guards.cpp",
        "if (!enabled() || !state_known || clock.gap()) {\n    standstill.restart();",
        "if (true) {\n    standstill.restart();",
        ("test_controller_robot",),
    ),
    one(
        "unhome_in_a_ramp",
        "the arm is ramping down, and its command drops to zero at once",
        "src/controller/controller_state.cpp",
        "if (command == StateCommand::kUnhome && !enabled() && !may_stop_at_once()) {",
        "if (false) {",
        ("test_measured_acceleration",),
    ),
    one(
        "taught_in_a_ramp",
        "a trocar point taught in a ramp stops the arm in one cycle",
        "src/controller/controller_state.cpp",
        "if (!may_stop_at_once()) return Reason::kNotAtRest;",
        "",
        ("test_measured_acceleration",),
    ),
    one(
        "unhome_while_enabled",
        "the arm loses its frame in the middle of a motion",
        "src/state/operating_state.cpp",
        """if (state_ == State::kEnabled) return Reason::kRefusedTransition;
      homed_ = false;""",
        "homed_ = false;",
        ("test_measured_acceleration",),
    ),
    one(
        "start_forgets_the_last_command",
        "resumed while the last command still fades, the arm stops in one cycle",
        "src/controller/controller_state.cpp",
        "follower.reset(arm.measured().q, qd_last);",
        "follower.reset(arm.measured().q);",
        ("test_controller_moves",),
    ),
    one(
        "jump_onto_the_pivot",
        "a start off the pivot moves the shaft to it as fast as the joints can",
        "src/controller/controller_state.cpp",
        "pivot_offset = -shaft().e;",
        "pivot_offset.setZero();",
        ("test_measured_acceleration",),
    ),
    one(
        "trocar_met_too_late",
        "a breathing trocar is met where it was when the command was given",
        "src/controller/controller_motion.cpp",
        "const double arrives = T + (law == Law::kExact ? follower.delay() : 0.0);",
        "const double arrives = T;",
        ("test_controller_commands",),
    ),
    one(
        "late_states_trusted_by_the_velocity_form",
        "behind late states the velocity form shakes the arm",
        "src/controller/controller_motion.cpp",
        "const double share = feedback_scale();",
        "const double share = 1;",
        ("test_stale_state",),
    ),
    one(
        "step_dt_max_off",
        "after a long silence a stream may step across the whole workspace",
        "src/state/gate.cpp",
        "return begins ? 0.0 : std::min(since, limits.step_dt_max);",
        "return begins ? 0.0 : since;",
        ("test_controller_limits",),
    ),
    # -- the wrist
    one(
        "wrist_other_branch",
        "a tip pose bends the wrist backwards, beyond its range",
        "src/kinematics/wrist.cpp",
        "return std::array{with_link_along(u, wrist, tip), with_link_along(-u, wrist, tip)};",
        "return std::array{with_link_along(-u, wrist, tip), with_link_along(u, wrist, tip)};",
        ("test_wrist",),
    ),
    one(
        "wrist_mounted_straight",
        "the wrist bends in a direction turned about the shaft",
        "src/controller/controller_state.cpp",
        "set_turn(std::atan2(-axis_R.x(), axis_R.y()))",
        "set_turn(0.0)",
        ("test_wrist",),
    ),
    one(
        "wrist_drive_as_fast_as_the_arm",
        "the tip leaves its path by speed times the difference of the lags",
        "src/motion/wrist_motion.cpp",
        "ahead[i] = dofs_[i].x + (lag - arm_lag) * dofs_[i].v + bend * dofs_[i].a;",
        "ahead[i] = dofs_[i].x;",
        ("test_wrist",),
    ),
    one(
        "wrist_beyond_its_range",
        "a target beyond the wrist's range is followed to its stop",
        "src/motion/command_handler.cpp",
        "if (!(stream && command.slide)) return Reason::kOutsideWorkspace;",
        "if (!stream) return Reason::kOutsideWorkspace;",
        ("test_wrist",),
    ),
    one(
        "wrist_steps_unchecked",
        "a stream may throw the wrist across its range",
        "src/state/gate.cpp",
        "if (turned <= wrist.velocity * dt + limits.step_roll_slack) return Reason::kNone;",
        "if (turned <= 1e9) return Reason::kNone;",
        ("test_wrist",),
    ),
    one(
        "wrist_goes_on_after_a_stop",
        "arm and jaw hold, and the wrist turns on",
        "src/motion/command_handler.cpp",
        "  setpoint_.stop();\n  wrist_.stop();\n  move_active_",
        "  setpoint_.stop();\n  move_active_",
        ("test_wrist",),
    ),
    one(
        "wrist_blocked_unseen",
        "a drive that stands still is told to go on",
        "src/motion/wrist_motion.cpp",
        "away_ = away ? away_ + elapsed : 0;",
        "away_ = 0;",
        ("test_wrist",),
    ),
    one(
        "wrist_overshoots_its_end",
        "the set-point passes the end of the drive, and arm and tip do not fit together",
        "src/motion/wrist_motion.cpp",
        "if (was_inside && dofs_[i].x != end) dofs_[i] = {end, 0, 0};",
        "if (was_inside && false) dofs_[i] = {end, 0, 0};",
        ("test_wrist",),
    ),
    one(
        "wrist_end_takes_the_tip_along",
        "a joint at its end moves the tip that should only turn",
        "src/motion/command_handler.cpp",
        "const DriveJoints turns = wrist_.allowed(command.wrist);",
        "const DriveJoints turns = command.wrist;",
        ("test_wrist",),
    ),
    one(
        "arm_and_drive_roll",
        "the tool turns twice as fast as it was told",
        "src/motion/command_handler.cpp",
        "command.roll_rate = wrist_.rolls() ? 0 : rate.roll_rate;",
        "command.roll_rate = rate.roll_rate;",
        ("test_wrist",),
    ),
    one(
        "joint_commands_forget_the_arms_roll",
        "the shaft leaps where somebody has turned the arm by hand",
        "src/motion/command_handler.cpp",
        "const double arm = absolute ? setpoint_.roll() : 0;",
        "const double arm = 0;",
        ("test_wrist",),
    ),
    one(
        "poses_forget_the_arms_roll",
        "the tool is turned by what somebody has turned the arm by",
        "src/motion/command_handler.cpp",
        "return roll_near(near, centre.p, Eigen::Quaterniond(centre.R)) - arm;",
        "return roll_near(near, centre.p, Eigen::Quaterniond(centre.R));",
        ("test_wrist",),
    ),
    one(
        "roll_of_the_drive_unreported",
        "a policy sees the arm's roll alone",
        "src/controller/controller.cpp",
        "  out.virtual_q[3] += q[2];\n",
        "",
        ("test_wrist",),
    ),
    # -- the follower
    one(
        "late_states_trusted",
        "on a starved machine the feedback shakes the arm off its pivot, even from rest",
        "src/controller/controller_guards.cpp",
        "return damped / (std::max(lag, damped) + kRoundTrip * delay);",
        "return damped / std::max(lag, damped);",
        ("test_stale_state",),
    ),
    one(
        "reference_leaves_no_room",
        "a wrong correction stays for as long as the reference brakes, and takes the arm off its "
        "pivot",
        "src/controller/controller_motion.cpp",
        "request.room = follower.wanted_room();",
        "",
        ("test_late_link",),
    ),
    one(
        "joints_return_at_full_gain",
        "the way back from a late link overshoots, joint by joint, beside the pivot",
        "src/law/exact_follower.cpp",
        "share_of_pull(error, gain) * gain * error",
        "gain * error",
        ("test_late_link", "test_exact_follower"),
    ),
    one(
        "feed_forward_always_full",
        "feed-forward and feedback that do not fit are cut joint by joint, beside the pivot",
        "src/law/exact_follower.cpp",
        "const double share = largest_share(v + correction_, change);",
        "const double share = 1;",
        ("test_exact_follower",),
    ),
    one(
        "measured_lag_ignored",
        "a lag that is stated wrong takes the arm off its pivot for good",
        "src/controller/controller_guards.cpp",
        "if (gains.rcm > 0) follower.set_link(lag_meter.link());",
        "",
        ("test_controller",),
    ),
    one(
        "joints_out_of_step",
        "joints of unequal lag are late each by its own, and leave the pivot",
        "src/law/exact_follower.cpp",
        "held + hurry * rate_",
        "hurry * rate_",
        ("test_exact_follower",),
    ),
    one(
        "pivot_only_expected",
        "servos cut the path's curves, and a fast arm leaves its pivot by as much",
        "src/law/exact_follower.cpp",
        "if (pivot) error +=",
        "if (false) error +=",
        ("test_lag_plant",),
    ),
    one(
        "late_link_teaches_lags",
        "some tens of milliseconds of a starved link leave each joint a wrong lag",
        "src/state/lag_meter.cpp",
        "const double weight = dt * (first ? 1.0 : likelihood(lead, v));",
        "const double weight = dt;",
        ("test_lag_meter",),
    ),
    one(
        "lateness_pulled_back",
        "an arm that is late for a moment is pulled off its way",
        "src/law/exact_follower.cpp",
        "const double ahead = since - behind_;",
        "const double ahead = since;",
        ("test_exact_follower", "test_late_link"),
    ),
    one(
        "late_link_at_full_speed",
        "an arm that repeats a command at full speed leaves a path that bends, and its pivot",
        "src/law/exact_follower.cpp",
        "(behind_ > kLate ? -1 / kSlowing : 1 / kHastening)",
        "1 / kHastening",
        ("test_exact_follower", "test_late_link"),
    ),
    one(
        "slower_flange_ignored",
        "the arm is late on its way, and goes on at full speed",
        "src/controller/controller_motion.cpp",
        "std::clamp(lead + slower, 0.0,",
        "std::clamp(lead, 0.0,",
        ("test_late_link",),
    ),
    one(
        "room_before_the_pivot",
        "the room for a correction takes the reference itself off its pivot",
        "src/limits/limited_step.cpp",
        "return on_pivot.tier < 2 ? on_pivot : step;",
        "return step;",
        ("test_limited_step",),
    ),
    # -- the law
    one(
        "pivot_lever_reversed",
        "the flange turns about the wrong side of the trocar: the pivot is left",
        "src/law/rcm.cpp",
        "omega.cross(Vector3(shaft.p_BNear - shaft.p_BF))",
        "omega.cross(Vector3(shaft.p_BF - shaft.p_BNear))",
    ),
    one(
        "tip_at_half_speed",
        "keeps the pivot perfectly and moves the tip wrongly: RCM deviation alone proves nothing",
        "src/law/rcm.cpp",
        "const Vector3 s_dot = (lateral(v_BTip, s) - v_lateral) / depth;",
        "const Vector3 s_dot = (0.5 * lateral(v_BTip, s) - v_lateral) / depth;",
    ),
    one(
        "feedback_drives_away",
        "the tip pays for the pivot's feedback with the wrong sign",
        "src/law/rcm.cpp",
        "(lateral(v_BTip, s) - v_lateral) / depth",
        "(lateral(v_BTip, s) + v_lateral) / depth",
    ),
    one(
        "insertion_forgotten",
        "the tip cannot be pushed in or pulled out",
        "src/law/rcm.cpp",
        "s.dot(v_BTip) * s + v_lateral - omega",
        "0.9 * s.dot(v_BTip) * s + v_lateral - omega",
    ),
    one(
        "holonomy_reversed",
        "every closed loop of the tip rolls the instrument by twice its solid angle",
        "src/law/rcm.cpp",
        "return -s_home.dot(s.cross(s_dot))",
        "return s_home.dot(s.cross(s_dot))",
    ),
    one(
        "paper_law_beautified",
        "the paper's law would no longer be the one that is printed",
        "src/law/rcm.cpp",
        "const Vector3 r_hat = r_ee.normalized();",
        "const Vector3 r_hat = -r_ee.normalized();",
    ),
    # -- limits and workspace
    one(
        "no_fade_at_the_trocar",
        "F24: full lateral speed with the tip at the trocar, where omega is v / L",
        "src/limits/workspace.cpp",
        "return std::clamp((depth - limits.depth_min) / (limits.depth_slow - limits.depth_min), "
        "0.0, 1.0);",
        "return depth > 0 ? 1.0 : 0.0 * limits.depth_min;",
    ),
    one(
        "no_cone",
        "targets beyond the cone pry the wall",
        "src/limits/workspace.cpp",
        "depth * std::cos(limits.cone) - p_RTip.z()",
        "-1.0",
    ),
    # -- gate and authority
    one(
        "stream_starts_anywhere",
        "F03: a source that wakes up late goes on where it is now",
        "src/state/gate.cpp",
        "begins ? 0.0 : std::min(since, limits.step_dt_max)",
        "std::min(since, limits.step_dt_max)",
    ),
    one(
        "roll_steps_unchecked",
        "a stream may jump in roll",
        "src/state/gate.cpp",
        "std::abs(roll_distance) <= limits.roll_velocity * dt + limits.step_roll_slack",
        "roll_distance <= 1e9",
    ),
    one(
        "anybody_commands",
        "F26: two sources interleave",
        "include/surg_core/state/gate.hpp",
        "return holder_ == 0 || holder_ == source;",
        "return holder_ == 0 || holder_ == source || true;",
    ),
    one(
        "holder_is_dropped_in_motion",
        "F26: the arm is free for others while it still moves",
        "include/surg_core/state/gate.hpp",
        "silent_ = resting ? silent_ + dt_ : 0;",
        "silent_ += resting || true ? dt_ : 0;",
    ),
    Mutant(
        "poison_passes",
        "F01: NaN or infinity in a command reaches the profiler and the wire",
        (
            Edit("src/controller/controller_guards.cpp", "if (!finite(command)) {", "if (false) {"),
            Edit(
                "src/controller/controller_motion.cpp",
                "if (!qd.allFinite() || !twist.allFinite()) {",
                "if (false) {",
            ),
        ),
    ),
    one(
        "blind_on_a_nan_age",
        "F10: an age that is not a number counts as fresh",
        "src/controller/controller_guards.cpp",
        ": !(in.state_age <= robot.tuning.link_timeout) ? Reason::kLinkLost",
        ": in.state_age > robot.tuning.link_timeout ? Reason::kLinkLost",
    ),
    one(
        "measured_nan_is_believed",
        "F02: the geometry is unknown and the arm goes on",
        "src/controller/controller_guards.cpp",
        ": !sized || !in.q.allFinite() || !in.qd.allFinite()",
        ": !sized",
    ),
    one(
        "pivot_unguarded",
        "F23: the arm works on beside its trocar",
        "src/controller/controller_guards.cpp",
        "if (!shaft_through_trocar() || (inserted && shaft().depth <= 0)) {",
        "if (inserted && shaft().depth <= 0) {",
    ),
    one(
        "stuck_arm_ignored",
        "the set-point runs away from an arm that is held, and the arm runs after it once released",
        "src/controller/controller_guards.cpp",
        "if (!(behind <= kFollowDistance)) stop_from_measured(Reason::kNotFollowing);",
        "if (!(behind <= 100)) stop_from_measured(Reason::kNotFollowing);",
    ),
    one(
        "hard_force_ramps",
        "F25: a hard contact is pushed on during the ramp",
        "src/controller/controller_guards.cpp",
        "if (verdict == ForceGuard::Verdict::kFade) fade();",
        "if (false) fade();",
    ),
    one(
        "yield_into_the_tissue",
        "F25: takes away the motion that would relieve the tissue",
        "src/law/twist_law.cpp",
        "requested - std::min(0.0, requested.dot(push)) * push",
        "requested - std::max(0.0, requested.dot(push)) * push",
    ),
    one(
        "overshoot_pulled_back",
        "F25: an arm that overshot away from a force is pulled back against it",
        "src/law/exact_follower.cpp",
        "if (into > 0) error +=",
        "if (false) error +=",
    ),
    one(
        "first_sample_jumps",
        "the noise of a track's first sample throws the tip off its path",
        "src/kinematics/trocar.cpp",
        "const bool near = off.norm() <= kNear;",
        "const bool near = false;",
        ("test_track_noise",),
    ),
    one(
        "tremor_is_motion",
        "a tremor that the filter knows still pulls at the motion",
        "src/estimators/tremor_estimate.cpp",
        "(x[i] - state_[i][0] - state_[i][3]) * gain",
        "(x[i] - state_[i][0]) * gain",
    ),
    # -- state
    one(
        "watchdog_one_cycle_late",
        "F03: the deadline is exact",
        "src/motion/command_handler.cpp",
        "silent_cycles_ > std::lround(timeout_ / dt_)",
        "silent_cycles_ > std::lround(timeout_ / dt_) + 1",
    ),
    one(
        "stream_talks_over_hold",
        "a person's hold is overrun by a stream that goes on",
        "src/motion/command_handler.cpp",
        "if (stream_blocked_ && is_servo(motion)) {",
        "if (stream_blocked_ && is_servo(motion) && motion == Motion::kNone) {",
    ),
    one(
        "enabled_in_spite_of_the_cause",
        "FAULT is left while its cause lasts",
        "src/state/operating_state.cpp",
        "if (!may_enter) return Reason::kRefusedTransition;\n"
        "      if (obstacle != Reason::kNone) return obstacle;",
        "if (!may_enter) return Reason::kRefusedTransition;",
    ),
    one(
        "later_faults_hide_the_first",
        "the cause that people read is not the cause",
        "src/state/operating_state.cpp",
        "  if (state_ == State::kFault) return;\n",
        "",
    ),
    one(
        "jaw_goes_on_after_a_stop",
        "F31: the jaw finishes its motion when the arm is resumed",
        "src/motion/jaw.cpp",
        "  goal_ = set_;\n  busy_ = false;",
        "  busy_ = false;",
    ),
    Mutant(
        "jaw_moves_in_a_fault",
        "F31: a jaw opens or closes while the arm is stopped",
        (
            Edit("src/motion/jaw.cpp", "  goal_ = set_;\n  busy_ = false;", "  busy_ = false;"),
            Edit(
                "src/motion/jaw.cpp",
                "if (!may_move) return;",
                "if (!may_move && settle_ < 0) return;",
            ),
        ),
    ),
    Mutant(
        "track_anywhere",
        "F23: a tracked trocar may move through the room",
        (
            Edit(
                "src/kinematics/trocar.cpp",
                "const bool in_range = (sample.p - p_taught_).norm() <= kRange;",
                "const bool in_range = true;",
            ),
            Edit(
                "src/kinematics/trocar.cpp",
                "(filter_.p(filtered_) - p_taught_).norm() <= kRange &&",
                "true &&",
            ),
        ),
        ("test_controller_commands",),
    ),
    one(
        "track_acceleration_sign",
        "between two samples the pivot bends the wrong way",
        "include/surg_core/estimators/track_filter.hpp",
        "return p_ + ahead * (v_ + 0.5 * ahead * a_);",
        "return p_ + ahead * (v_ - 0.5 * ahead * a_);",
        ("test_track_noise",),
    ),
    one(
        "track_outliers_believed",
        "a reflection on the tracker's lens throws the pivot off",
        "src/estimators/track_filter.cpp",
        "return miss <= gate(std::sqrt(positions_.position_variance() + variance));",
        "return miss <= 1.0;",
        ("test_track_noise",),
    ),
    one(
        "track_jump_is_outliers",
        "a trocar that jumped is taken for outliers until the track times out",
        "src/kinematics/trocar.cpp",
        "const bool agrees = outliers_ > 0 && (p - p_outlier_).norm() <= near;",
        "const bool agrees = outliers_ < 0 && (p - p_outlier_).norm() <= near;",
        ("test_track_noise",),
    ),
    one(
        "track_fast_breathing_is_outliers",
        "a trocar that breathes faster than its filter expects is taken for a jump",
        "src/estimators/track_filter.cpp",
        "took_last_ = beside || expected(p, variance);",
        "took_last_ = expected(p, variance);",
        ("test_track_noise",),
    ),
    one(
        "breathing_never_trusted",
        "a tracker without a velocity shakes the pivot of a ventilated patient",
        "src/estimators/harmonics.cpp",
        "found_ = probed_[1] < variance;",
        "found_ = false;",
        ("test_track_noise",),
    ),
    one(
        "breathing_outlives_its_change",
        "the pivot breathes on after the patient stopped",
        "src/estimators/breathing_filter.cpp",
        "return bias_.squaredNorm() > kDeparture * kDeparture * of_bias;",
        "return bias_.squaredNorm() > 1e9 * of_bias;",
        ("test_track_noise",),
    ),
    one(
        "track_jumps",
        "every sample jerks the arm by its noise",
        "src/kinematics/trocar.cpp",
        "lead_ += p - filter_.p(filtered_);",
        "lead_.setZero();",
        ("test_track_noise",),
    ),
    one(
        "track_velocity_always_used",
        "a tracker without a velocity drags the pivot behind the trocar",
        "include/surg_core/estimators/track_filter.hpp",
        "return miss_both_ < miss_positions_;",
        "return miss_both_ <= 1.0;",
        ("test_track_noise",),
    ),
    one(
        "pivot_limits_times_three",
        "a stream in spherical mode whips the arm about the trocar",
        "src/motion/setpoint.cpp",
        "{limits_.pivot_velocity, limits_.pivot_acceleration, limits_.pivot_jerk}",
        "{3 * limits_.pivot_velocity, 3 * limits_.pivot_acceleration, 3 * limits_.pivot_jerk}",
        ("test_setpoint",),
    ),
    # -- profiles
    one(
        "ramp_from_the_profile",
        "where a limit slows the arm, a stop would first make it faster",
        "src/motion/setpoint.cpp",
        "for (auto& dof : dofs_) dof.v *= clock_rate_;",
        "",
    ),
    one(
        "half_the_brake",
        "twice the stop distance",
        "src/motion/setpoint.cpp",
        "speed - limits_.stop_deceleration * dt",
        "speed - 0.5 * limits_.stop_deceleration * dt",
    ),
    one(
        "velocity_wish_unbounded",
        "servo_cv moves as fast as asked for",
        "src/motion/setpoint.cpp",
        "for (int i = 0; i < 4; ++i) rate_[i] = factor * rate[i];",
        "for (int i = 0; i < 4; ++i) rate_[i] = std::max(factor, 0.999) * rate[i];",
    ),
    one(
        "jerk_unchecked",
        "moves are planned beyond the jerk limit",
        "src/motion/profiler.cpp",
        "return q.max_jerk() <= limits.jerk * kRounding &&",
        "return",
        ("test_profiler",),
    ),
    one(
        "extremes_at_the_ends_only",
        "the check of a quintic's velocity misses its peak",
        "src/motion/quintic.cpp",
        "double Quintic::max_velocity() const {",
        "double Quintic::max_velocity() const {\n"
        "  if (d_ > 0) return std::max(std::abs(at(0).v), std::abs(at(d_).v));",
        ("test_quintic",),
    ),
    one(
        "a_plan_is_predicted",
        "a policy's arm runs ahead of its rows and past the last one",
        "src/motion/stream_input.cpp",
        "if (clock_.period() > kSlow) return way(ahead);",
        "",
        ("test_stream_input",),
    ),
    one(
        "filter_forgets_its_acceleration_limit",
        "a stream accelerates the tip beyond the limit",
        "src/motion/stream.cpp",
        "double j = std::clamp(jerk, (-A - own.a) / T, (A - own.a) / T);",
        "double j = A > 0 ? jerk : 0;",
        ("test_stream",),
    ),
    # -- the flange, and the way back
    one(
        "flange_goes_too_fast",
        "the wrist passes its speed where the joints cannot brake on the path",
        "src/limits/limited_step.cpp",
        "found && flange_twist(here.J, padded(step.qd))",
        "false && flange_twist(here.J, padded(step.qd))",
    ),
    one(
        "follower_forgets_the_flange",
        "what makes an arm of unknown lag follow takes the wrist beyond its speed",
        "src/law/exact_follower.cpp",
        "qd = slowed_flange(J, options_.flange_velocity, qd, slow);",
        "",
        ("test_exact_follower",),
    ),
    one(
        "retrace_in_motion_never_rests",
        "the way out, asked for in motion, goes on with that motion instead",
        "src/controller/controller_motion.cpp",
        "if (!retrace_active) advance_setpoint",
        "if (!handler.retracing()) advance_setpoint",
        ("test_flange_speed",),
    ),
    one(
        "retrace_from_the_measured_state",
        "the replay swings behind an arm that answers late",
        "src/controller/controller_motion.cpp",
        "if (!retrace_active && law != Law::kExact)",
        "if (law != Law::kExact)",
        ("test_flange_speed",),
    ),
    one(
        "look_ahead_forgets_the_margin",
        "a profile that ends near a limit of a joint leaves its path, or the pivot, at the end",
        "src/limits/look_ahead.cpp",
        "approach_speed(limits.velocity[j], left,",
        "approach_speed(limits.velocity[j], 1e3,",
        ("test_flange_speed",),
    ),
    # -- moves and their ends
    one(
        "move_into_a_limit_never_ends",
        "F20: a client that waits for the end of its move waits for ever",
        "src/motion/command_handler.cpp",
        "if (!driven || !limited || held_ <= kHeldWithin) return Reason::kNone;",
        "if (!driven || !limited || held_ <= 1e9) return Reason::kNone;",
        ("test_motion_ends",),
    ),
    one(
        "retrace_frees_the_arm",
        "F26: another node's move is accepted in the middle of the way back",
        "src/controller/controller.cpp",
        "at_rest && !handler.busy() && !jaw.busy()",
        "at_rest && !jaw.busy()",
        ("test_motion_ends",),
    ),
    one(
        "roll_without_a_range",
        "a roll of 1e5 rad is a target",
        "src/motion/command_handler.cpp",
        "return std::abs(roll) <= std::max(limits_.roll_max, std::abs(setpoint_.roll()));",
        "return std::abs(roll) <= 1e6;",
        ("test_motion_ends",),
    ),
    one(
        "arrived_anywhere",
        "a move that a force stopped half-way counts as done",
        "src/motion/command_handler.cpp",
        "(p_goal_ - setpoint_.p_RTip()).norm() < kArrivedDistance &&",
        "",
        ("test_controller_moves",),
    ),
    one(
        "arrived_without_its_roll",
        "a move counts as done though the instrument has not turned",
        "src/motion/command_handler.cpp",
        "std::abs(setpoint_.roll() - at.roll) < kArrivedDistance / kRollLever",
        "true",
        ("test_controller_moves",),
    ),
    one(
        "stop_then_go_stays",
        "a move from full motion stops and forgets its target",
        "src/motion/setpoint.cpp",
        "  stop();\n  move_after_stop_ = true;",
        "  stop();",
        ("test_controller_moves",),
    ),
    one(
        "sideways_target_near_the_trocar",
        "F24: a target beside the shaft at 25 mm depth is accepted",
        "src/motion/command_handler.cpp",
        "!aside_near_trocar(p_RTip, setpoint_.s_R(), limits_.depth_slow)",
        "true",
        ("test_controller_moves",),
    ),
    one(
        "sideways_way_near_the_trocar",
        "F24: a profile between two deep ends passes the shallow zone at full speed",
        "src/motion/setpoint.cpp",
        "if (aside_near_trocar(p, s, shallow)) return true;",
        "",
        ("test_controller_moves",),
    ),
    one(
        "force_does_not_stop_a_move",
        "F25: a move waits for the contact to yield, and then goes on",
        "src/motion/setpoint.cpp",
        "  if (mode_ == Mode::kProfile && v_RTip().dot(push_R_) < 0) stop();\n",
        "",
        ("test_controller_moves",),
    ),
    one(
        "commanded_roll_jumps_a_turn",
        "beyond half a turn an orientation asks for the way round the other side",
        "src/motion/command_handler.cpp",
        "return near + wrapped(requested - near);",
        "return requested;",
        ("test_controller_moves",),
    ),
    one(
        "measured_roll_jumps_a_turn",
        "beyond half a turn the measured roll changes its sign",
        "src/kinematics/arm_state.cpp",
        "state.roll += wrapped(roll - state.roll);",
        "state.roll = roll;",
        ("test_controller_moves",),
    ),
    one(
        "retraced_roll_jumps_a_turn",
        "a way back from beyond half a turn leaves the set-point a turn away",
        "src/controller/controller_motion.cpp",
        "roll + wrapped(turn - roll)",
        "turn",
        ("test_controller_moves",),
    ),
    one(
        "trace_survives_hand_guiding",
        "the way back begins with a jump to where the arm was before",
        "src/controller/controller_state.cpp",
        "if (moved) trace.clear();",
        "if (moved && trace.empty()) trace.clear();",
        ("test_controller_moves",),
    ),
    # -- limits of the set-point, and what is reported
    one(
        "roll_jerk_unbounded",
        "the instrument rolls with 50 times its jerk",
        "src/motion/setpoint.cpp",
        "limits_.roll_acceleration, limits_.roll_jerk}",
        "limits_.roll_acceleration, 50 * limits_.roll_jerk}",
        ("test_controller_limits",),
    ),
    one(
        "depth_jerk_unbounded",
        "the tip goes in and out with 20 times its jerk",
        "src/motion/setpoint.cpp",
        "std::array<DofLimits, 4>{tip, tip, tip, roll}",
        "std::array<DofLimits, 4>{tip, tip, {tip.velocity, tip.acceleration, 20 * tip.jerk}, roll}",
        ("test_controller_limits",),
    ),
    one(
        "pivot_between_samples_unwatched",
        "at full speed the shaft leaves the pivot between two samples",
        "src/limits/limited_step.cpp",
        "if (sagitta > kSagitta) {",
        "if (sagitta > 1e9 * kSagitta) {",
        ("test_controller_limits",),
    ),
    one(
        "blocked_arm_paused_late",
        "the set-point runs 50 mm ahead of a blocked arm",
        "src/controller/controller_guards.cpp",
        "if (!(behind <= kFollowDistance))",
        "if (!(behind <= 5 * kFollowDistance))",
        ("test_controller_reports",),
    ),
    one(
        "pivot_never_warned_of",
        "F23: the first word about a shaft beside its trocar is the FAULT",
        "src/controller/controller_guards.cpp",
        "shaft().e.norm() > limits.rcm_error_warn;",
        "shaft().e.norm() > 1e9 * limits.rcm_error_warn;",
        ("test_controller_reports",),
    ),
    one(
        "reported_roll_rate_without_holonomy",
        "the reported rate of roll is not that of the reported roll",
        "src/kinematics/arm_state.cpp",
        "omega.dot(shaft.s) - roll_holonomy_rate",
        "omega.dot(shaft.s) + roll_holonomy_rate",
        ("test_controller_reports",),
    ),
    one(
        "black_box_skips_a_field",
        "a replay does not see that the deviation of the pivot differs",
        "src/state/black_box.cpp",
        '  visit("rcm_error", out.rcm_error);\n',
        "",
        ("test_black_box",),
    ),
    # -- kinematics, configuration, evidence
    one(
        "inverse_a_little_off",
        "joint velocities give another flange velocity than asked for",
        "src/kinematics/jacobian_inverse.cpp",
        "M.col(c) -= factor * M(best, c);",
        "M.col(c) -= 0.999 * factor * M(best, c);",
        ("test_kinematics",),
    ),
    one(
        "cell_loosens_limits",
        "F15: a cell file switches a limit off",
        "src/config/robot_config.cpp",
        "if (!(value >= lowest && value <= highest)) {\n"
        '      throw ConfigError(where + number(value) + " " + key->unit +\n'
        '                        " would loosen',
        "if (!(value == value)) {\n"
        '      throw ConfigError(where + number(value) + " " + key->unit +\n'
        '                        " would loosen',
        ("test_config",),
    ),
    one(
        "black_box_forgets_a_member",
        "an incident cannot be replayed",
        "src/controller/controller_impl.hpp",
        "unexplained, qd_last, out.accepted,",
        "unexplained, out.accepted,",
        ("test_black_box",),
    ),
    one(
        "damaged_black_box_is_read",
        "evidence that is not what was recorded",
        "src/state/black_box.cpp",
        "if (sum != checksum(contents)) {",
        "if (false) {",
        ("test_black_box",),
    ),
    # -- clearance
    one(
        "way_back_counts_as_away",
        "two arms come millimetres closer than the cell says",
        "src/limits/clearance.cpp",
        "-gap.away.dot(waiting_->at(joint, gap.p)));",
        "-gap.away.dot(still_.at(joint, gap.p)));",
        ("test_clearance_guard",),
    ),
    one(
        "clearance_without_the_distance",
        "arms touch",
        "src/limits/clearance.cpp",
        "if (gap.distance < far) keep(joint, gap, gap.distance - target.required - kReserve);",
        "if (gap.distance < far) keep(joint, gap, gap.distance);",
        ("test_clearance_guard",),
    ),
)
