"""The safety controller against an oracle of its own; the expert is never refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from helpers.policy.policy_bench import ARM, HOME, Bench, arm_of, cell
from helpers.results.policy_results import note
from surg_core.arm_view import ArmState, ArmView
from surg_core.contract import SECOND_NS, STEP_NS
from surg_policy_bridge.server.observer import CameraWatch, Observer, lagging_arm
from surg_policy_bridge.server.policy_arm import Target
from surg_policy_bridge.server.safety_controller import (
    CLIPPABLE,
    RULES,
    ArmSafety,
    SafetyController,
)
from surg_policy_bridge.server.timers import PRESENCE_NS, OperatorPresence

DT = STEP_NS / SECOND_NS
# The shipped UR5e (docs/reference/safety.md), written here a second time on purpose: an oracle.
V_MAX, A_MAX, SLACK, ROLL_V, ROLL_SLACK = 0.25, 2.0, 0.002, 2.0, 0.0349
DEPTH_MIN, DEPTH_MAX, CONE = 0.020, 0.220, 1.0472
JAW = (0.0, 0.8)
PACED = ("start", "step", "acceleration", "jaw")
"""Rules that clip where the arm shall follow a policy that was late, at the allowed pace."""


def view(p: np.ndarray = HOME, roll: float = 0.0, jaw: float = 0.3, rcm: float = 0.0) -> ArmView:
    """An arm at rest."""
    p = np.array(p, dtype=float)
    return ArmView(
        stamp_ns=0,
        state=ArmState.ENABLED,
        homed=True,
        busy=False,
        reason="",
        refused=0,
        p_BTip=p,
        p_BSet=p,
        roll=roll,
        roll_set=roll,
        jaw=jaw,
        jaw_set=jaw,
        rcm_error=rcm,
        R_BR=np.eye(3),
        holder="/policy",
    )


def safety(clip: tuple[str, ...] = ()) -> ArmSafety:
    """Of the bench's arm."""
    return ArmSafety(ARM, arm_of(), clip)


def allowed(target: np.ndarray, last: np.ndarray | None, v_last: np.ndarray, jaw: tuple) -> bool:
    """The rules once more, written down anew."""
    if not np.isfinite(target).all():
        return False
    depth = float(np.linalg.norm(target[:3]))
    inside = DEPTH_MIN <= depth <= DEPTH_MAX
    inside = inside and math.acos(min(1.0, target[2] / max(depth, 1e-9))) <= CONE
    before = np.array([*HOME, 0.0, 0.3]) if last is None else last
    step = float(np.linalg.norm(target[:3] - before[:3]))
    turn = abs((target[3] - before[3] + math.pi) % (2 * math.pi) - math.pi)
    dt = 0.0 if last is None else DT
    near = step <= V_MAX * dt + SLACK and turn <= ROLL_V * dt + ROLL_SLACK
    if not (inside and near):
        return False
    v = (target[:3] - before[:3]) / DT
    calm = last is None or np.abs(v - v_last).max() <= A_MAX * DT + SLACK / DT
    return calm and jaw[0] <= target[4] <= jaw[1]


def test_every_verdict_against_an_oracle(full: bool) -> None:
    """Random walks, calm and wild; a step is taken exactly when the oracle allows it."""
    rng = np.random.default_rng(11)
    jaw = (arm_of().instrument.jaw_min, arm_of().instrument.jaw_max)
    taken = refused = 0
    for _ in range(400 if full else 60):
        guard, last, v_last, at = safety(), None, np.zeros(3), 0
        for _ in range(40):
            before = np.array([*HOME, 0.0, 0.3]) if last is None else last
            size = rng.choice([1e-3, 4e-3, 1.5e-2, 5e-2])
            target = before + np.array([*rng.normal(scale=size, size=3), 0.0, 0.0])
            target[:3] += 0.8 * v_last * DT * rng.integers(0, 2)
            target[3] += rng.normal(scale=rng.choice([0.02, 0.2]))
            target[4] = rng.uniform(jaw[0] - 0.1, jaw[1] + 0.1)
            if rng.random() < 0.02:
                target[rng.integers(5)] = rng.choice([np.nan, np.inf, -1e308])
            verdict = guard.judge(Target.of(target), view(), at)
            if allowed(target, last, v_last, jaw):
                assert verdict.target is not None, (target, verdict.violations)
                guard.take(verdict, at)
                v_last = (target[:3] - before[:3]) / DT
                last, taken = target, taken + 1
                at += STEP_NS
            else:
                assert verdict.target is None, target
                assert verdict.violations[0].rule in RULES and ARM in verdict.violations[0].text
                refused += 1  # and the same moment is tried again
    note(0, taken + refused, f"{taken} taken, {refused} refused, each as the oracle says")
    assert min(taken, refused) > 300


def test_f06_a_jump_is_refused_at_its_exact_size() -> None:
    """v_max dt + 2 mm between consecutive steps; the first: 2 mm from the set-point."""
    for size, first, good in (
        (SLACK - 1e-9, True, True),
        (SLACK + 1e-8, True, True),  # as float32 adds it up: shortened to 2 mm
        (SLACK + 2e-6, True, False),
        (V_MAX * DT + SLACK - 1e-9, False, True),
        (V_MAX * DT + SLACK + 1e-9, False, False),
    ):
        guard, at = safety(), 0
        start = Target(HOME, 0.0, 0.3)
        if not first:
            # Up to speed first: the rule on acceleration is another one.
            for speed in (0.0, 0.1, 0.2):
                start = Target(start.p + np.array([speed * DT, 0, 0]), 0.0, 0.3)
                guard.take(guard.judge(start, view(start.p), at), at)
                at += STEP_NS
        toward = np.array([1.0, 0.0, 0.0])
        verdict = guard.judge(Target(start.p + size * toward, 0.0, 0.3), view(start.p), at)
        rules = [each.rule for each in verdict.violations]
        assert (verdict.target is not None) == good, (size, first, rules)
        if good and first and verdict.target is not None:
            assert 0.0 <= SLACK - np.linalg.norm(verdict.target.p - start.p) <= 2e-9
        if not good:
            assert rules == ["start" if first else "step"]
    for turn, good in ((ROLL_V * DT + 0.034, True), (ROLL_V * DT + 0.036, False)):
        guard = safety()
        guard.take(guard.judge(Target(HOME, 3.1, 0.3), view(roll=3.1), 0), 0)
        across = Target(HOME, 3.1 + turn - 2 * math.pi, 0.3)  # over ±π
        assert (guard.judge(across, view(), STEP_NS).target is not None) == good


def test_millimetres_for_metres_are_refused_in_words() -> None:
    verdict = safety().judge(Target(1e3 * HOME, 0.0, 0.3), view(), 0)
    (violation,) = verdict.violations
    assert violation.rule == "workspace" and "metres" in violation.text


def test_a_shaft_off_its_pivot_is_not_led_on() -> None:
    good, bad = (safety().judge(Target(HOME, 0, 0.3), view(rcm=r), 0) for r in (1e-3, 1.001e-3))
    assert good.target is not None and bad.target is None
    assert bad.violations[0].rule == "rcm_error"


def test_what_may_be_clipped_lies_on_the_way_and_is_allowed() -> None:
    """A clipped step is the longest allowed one in the same direction."""
    rng = np.random.default_rng(3)
    clipped = 0
    for _ in range(300):
        guard, strict = safety(CLIPPABLE), safety()
        wish = Target(HOME + rng.normal(scale=0.05, size=3), rng.normal(), rng.uniform(0, 0.5))
        verdict = guard.judge(wish, view(), 0)
        assert verdict.target is not None
        assert strict.judge(verdict.target, view(), 0).target is not None, "what is sent is good"
        if any(each.rule == "start" for each in verdict.violations):
            clipped += 1
            moved, wanted = verdict.target.p - HOME, wish.p - HOME
            np.testing.assert_allclose(np.cross(moved, wanted), 0.0, atol=1e-12)
            turn = 1.001 * verdict.target.roll
            further = replace(verdict.target, p=HOME + 1.001 * moved, roll=turn)
            assert strict.judge(further, view(), 0).target is None, "and the longest"
    assert clipped > 100


def test_an_arm_follows_a_late_policy_at_the_allowed_pace(full: bool) -> None:
    """Whatever is asked for inside the workspace, what is sent passes the oracle's rules."""
    rng = np.random.default_rng(5)
    jaw = (arm_of().instrument.jaw_min, arm_of().instrument.jaw_max)
    changed = kept = 0
    for _ in range(300 if full else 40):
        guard, last, v_last = safety(PACED), None, np.zeros(3)
        for number in range(40):
            wish = np.array([*HOME, 0.0, 0.3])
            wish[:3] += rng.normal(scale=rng.choice([1e-3, 6e-3, 2e-2]), size=3)
            if number % 8 > 4 and last is not None:
                wish = last  # time to arrive
            verdict = guard.judge(Target.of(wish), view(), number * STEP_NS)
            assert verdict.target is not None, verdict.violations
            sent = verdict.target.row
            assert allowed(sent, last, v_last, jaw), (number, verdict.violations)
            fits = allowed(wish, last, v_last, jaw)
            assert fits == (not verdict.violations) and (not fits or (sent == wish).all())
            changed, kept = changed + (not fits), kept + fits
            guard.take(verdict, number * STEP_NS)
            before = np.array([*HOME, 0.0, 0.3]) if last is None else last
            v_last, last = (sent[:3] - before[:3]) / DT, sent
    assert min(changed, kept) > 100, (changed, kept)


def test_a_paced_arm_arrives() -> None:
    """20 mm at once: it is there after three steps, one slack too far after four, and stays."""
    guard, goal = safety(PACED), Target(HOME + np.array([0.02, 0.0, 0.0]), 0.2, 0.3)
    sent = []
    for number in range(12):
        verdict = guard.judge(goal, view(), number * STEP_NS)
        assert verdict.target is not None
        guard.take(verdict, number * STEP_NS)
        sent.append(verdict.target.p[0] - HOME[0])
    assert sent[0] == pytest.approx(SLACK, rel=1e-6) and sent[-4:] == pytest.approx([0.02] * 4)
    assert max(sent) < 0.02 + 1.01 * SLACK


def test_a_jaw_is_clipped_into_its_range_and_never_from_afar() -> None:
    high = arm_of().instrument.jaw_max
    guard = safety(("jaw",))
    verdict = guard.judge(Target(HOME, 0.0, high + 0.01), view(), 0)
    assert verdict.target is not None and verdict.target.jaw == high
    degrees = guard.judge(Target(HOME, 0.0, math.degrees(high)), view(), 0)
    assert degrees.target is None and degrees.violations[0].rule == "jaw"


def test_a_rule_that_cannot_clip_is_said() -> None:
    with pytest.raises(ValueError, match="rcm_error"):
        safety(("rcm_error",))


def test_two_arms_move_both_or_not_at_all() -> None:
    both = SafetyController({"A": arm_of(), "B": arm_of()}, ())
    views = {"A": view(), "B": view()}
    good = Target(HOME + np.array([1e-3, 0, 0]), 0.0, 0.3)
    bad = Target(HOME + np.array([5e-2, 0, 0]), 0.0, 0.3)
    passed, broken = both.judge({"A": good, "B": bad}, views, 0)
    assert not passed and broken[0].text.startswith("B")
    passed, _ = both.judge({"A": good, "B": good}, views, 0)
    assert set(passed) == {"A", "B"}


def test_a_stream_that_ended_begins_anew() -> None:
    timeout = round(arm_of().robot.tuning.servo_timeout * SECOND_NS)
    for since, good in ((timeout, True), (timeout + 1, False)):
        guard = safety()
        guard.take(guard.judge(Target(HOME, 0, 0.3), view(), 0), 0)
        step = Target(HOME + np.array([0.004, 0, 0]), 0, 0.3)
        assert (guard.judge(step, view(), since).target is not None) == good


def test_the_expert_is_never_refused(full: bool) -> None:
    """Every action that the scripted senders take, as a policy's."""
    from surg_sim.envs.surg_env import SurgEnv

    judged, most = 0, 10_000 if full else 30
    for task in ("bgr", "pick_and_place") if full else ("bgr",):
        env = SurgEnv(task)
        for seed in range(10_000, 10_005) if full else (10_000,):
            env.reset(seed=seed)
            (arm,) = env.arms
            guard, at, done = safety(), 0, False
            names = [name.removeprefix(f"{arm}/") for name in env.state_names]
            while not done:
                action = env.expert_action()
                state = dict(zip(names, env._observation()["state"], strict=False))
                p_set = np.array([state[f"set_{axis}"] for axis in "xyz"])
                at_rest = view(p_set, state["roll_set"], state["jaw"])
                verdict = guard.judge(Target.of(action), at_rest, at)
                assert verdict.target is not None and not verdict.violations, (task, seed, verdict)
                guard.take(verdict, at)
                judged, at = judged + 1, at + STEP_NS
                _, _, terminated, truncated, _ = env.step(action)
                done = terminated or truncated or judged >= most
        env.close()
    note(1, judged, "none")
    assert judged >= 30


def test_a_dead_man_counts_while_its_source_says_so_again() -> None:
    presence = OperatorPresence()
    assert not presence.detected(0)
    presence.press("/footpedals", True, 0)
    presence.press("/console", False, 0)
    assert presence.detected(PRESENCE_NS), "one source does not lift another's foot"
    assert not presence.detected(PRESENCE_NS + 1), "its node was killed with the pedal down"
    presence.press("/footpedals", True, SECOND_NS)
    presence.press("/footpedals", False, SECOND_NS)
    assert not presence.detected(SECOND_NS)


# --- pictures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["silent", "frozen", "old"])
def test_f08_a_picture_that_is_not_new_is_noticed_after_three_periods(fault: str) -> None:
    watch = CameraWatch("endoscope_left", STEP_NS)
    assert "no picture" in watch.problem(0)
    for n in range(10):
        watch.picture(n * STEP_NS, n * STEP_NS, n)
    last = 9 * STEP_NS
    for n in range(1, 4):
        now = last + n * STEP_NS
        assert watch.problem(now) == "", "150 ms are not more than 150 ms"
        if fault == "frozen":
            watch.picture(now, now, 9)
        elif fault == "old":
            watch.picture(now, last, 100 + n)
    problem = watch.problem(last + 3 * STEP_NS + 1)
    assert ("sends no pictures" in problem) == (fault == "silent") and "150 ms" in problem
    watch.picture(last + 4 * STEP_NS, last + 4 * STEP_NS, 77)
    assert watch.problem(last + 4 * STEP_NS) == ""


def test_f08_a_drawn_picture_may_repeat_itself_while_nothing_moves() -> None:
    """The simulator's camera has no noise; a camera that freezes is noticed when a tip moves."""
    watch, rest = CameraWatch("endoscope_left", STEP_NS), np.zeros(3)
    for n in range(100):
        watch.picture(n * STEP_NS, n * STEP_NS, 7)
        assert watch.problem(n * STEP_NS, rest) == ""
        assert ("same picture" in watch.problem(n * STEP_NS)) == (n > 3), "a real camera's would"
    now = 99 * STEP_NS
    assert watch.problem(now, rest + 0.9e-3) == ""
    silent = watch.problem(now + 3 * STEP_NS + 1, rest)
    assert "sends no pictures" in silent and "150 ms old" in silent, "not since it last changed"
    for n in range(4):  # a picture of the moved tip takes its time
        assert watch.problem(now + n * STEP_NS, rest + 1.1e-3) == ""
        watch.picture(now + n * STEP_NS, now + n * STEP_NS, 7)
    late = watch.problem(now + 3 * STEP_NS + 1, rest)
    assert "same picture" in late and "150 ms old" in late, "also where the tip came back"
    watch.forget_tips()  # homing gives the arms another frame: that was no motion
    assert watch.problem(now + 3 * STEP_NS + 1, rest + 0.12) == ""


def test_f08_a_blind_camera_pauses_the_policy_and_nothing_is_observed() -> None:
    bench = Bench()
    bench.start()
    bench.period([bench.here(1e-3)])
    seen = len(bench.of("OBS"))
    bench.obstacle = "the picture of endoscope_left is 151 ms old"
    bench.period()
    assert bench.server.state.value == "PAUSED" and len(bench.of("OBS")) == seen
    assert "endoscope_left" in bench.server.reason
    bench.obstacle = ""
    bench.period()
    assert bench.server.state.value == "PAUSED", "nothing resumes by itself"


def test_observations_belong_together() -> None:
    exact = Observer(["a", "b"], 0)
    exact.put("a", 50, np.zeros(1))
    assert "b has not arrived" in exact.missing(50) and exact.take(1, 50) is None
    exact.put("b", 49, np.ones(1))
    assert exact.take(1, 50) is None, "lock-step: of the same tick"
    exact.put("b", 50, np.ones(1))
    seen = exact.take(1, 50)
    assert seen is not None and seen.arrays["b"] == 1.0
    assert exact.take(1, 50, ()) is not None, "nobody looks at anything"
    loose = Observer(["a", "b"], 3 * STEP_NS)
    loose.put("a", 10 * STEP_NS, np.zeros(1))
    loose.put("b", 7 * STEP_NS, np.ones(1))
    seen = loose.take(1, 10 * STEP_NS)
    assert seen is not None and seen.behind == 3 * STEP_NS
    loose.put("a", 10 * STEP_NS + 1, np.zeros(1))
    assert "b is 150 ms behind" in loose.missing(10 * STEP_NS + 1)
    loose.put("a", 9 * STEP_NS, np.full(1, 5.0))
    seen = loose.take(2, 9 * STEP_NS)
    assert seen is not None and seen.arrays["a"] == 0.0, "one that was overtaken is dropped"


def test_states_of_two_arms_belong_together() -> None:
    assert lagging_arm({"PSM1": 0}) == "" == lagging_arm({"PSM1": 3 * STEP_NS, "PSM2": 0})
    assert "PSM2 is 200 ms behind" in lagging_arm({"PSM1": 4 * STEP_NS, "PSM2": 0})


def test_the_cell_agrees_with_the_oracle() -> None:
    limits = cell().arms[ARM].limits
    assert (limits.tip_velocity, limits.tip_acceleration) == (V_MAX, A_MAX)
    assert (limits.depth_min, limits.depth_max, limits.step_slack) == (DEPTH_MIN, DEPTH_MAX, SLACK)
