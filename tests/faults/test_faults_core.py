"""Faults and their deadlines in cycles: the shipped controller, a simulated arm, a fake clock.

Every test quotes the row of the fault that it injects; random cases are seeded.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.control.fault_bench import STRANGER, STREAMS, Bench, command, force, shipped
from helpers.control.lagging_arm import SOURCE, TICK
from helpers.results.reactions import Reactions
from surg_core import Reason, State, StateCommand, _core
from surg_sim.nodes.fault_injector import Channel
from surg_sim.nodes.faults import Wire

pytestmark = pytest.mark.untimed

STILL = 100
"""Cycles within which a stop from working speed is at rest."""
ROUNDING = 1.0 + 1e-9


@pytest.fixture
def runs(full: bool) -> int:
    """Seeded runs of one row."""
    return 100 if full else 8


def is_still(bench: Bench) -> bool:
    return not np.any(bench.out.qd_command)


# --- commands -------------------------------------------------------------------------------


def bad_command(bench: Bench, value: float) -> surg_core.MotionCommand:
    """A command of the holder with one field spoilt."""
    motion = str(
        bench.rng.choice(["servo_cp", "servo_cv", "servo_jp", "servo_jv", "servo_jr", "move_cp",
                          "move_jp", "interpolate_cp"])
    )  # fmt: skip
    if motion == "servo_cv" and bench.rng.random() < 0.3:
        return command(motion, p=[0, 0, 0], roll_rate=value)
    if motion.endswith(("cp", "cv")):
        p, rotation = bench.setpoint(), [0.0, 0.0, 0.0, 1.0]
        # A finite rotation without a norm is no command: binding and node refuse its message.
        turned = motion.endswith("cp") and bench.rng.random() < 0.4
        if turned and not math.isfinite(value):
            rotation[bench.rng.integers(4)] = value
        else:
            p[bench.rng.integers(3)] = value
        return command(motion, p=p, rotation=rotation)
    joints = np.array(bench.out.virtual_set)
    joints[bench.rng.integers(4)] = value
    return command(motion, joints=joints)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
def test_f01_a_command_that_is_not_finite_faults_and_stops(
    runs: int, reactions: Reactions, value: float
) -> None:
    seen, still = [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up()
        out = bench.step(stream() if seed % 2 else command("jaw_servo_jp", jaw=0.4),
                         bad_command(bench, value))  # fmt: skip
        assert (out.state, out.reason) == (State.FAULT, Reason.NOT_FINITE)
        seen.append(0)
        assert np.any(out.qd_command), "a stop is a ramp"
        still.append(bench.rest())
        assert bench.jerked <= ROUNDING
        assert bench.deviation() < bench.limits.rcm_error_warn
        assert bench.step(stream()).verdicts[0].reason == Reason.NOT_ENABLED
        assert bench.controller.request(StateCommand.ENABLE) == Reason.NONE
    reactions.add("F01", f"{value} in a command", "FAULT(not_finite)", seen, 0)
    reactions.add("F01", f"{value} in a command", "standstill on the pivot", still, STILL)


@pytest.mark.parametrize("quantity", ["q", "qd", "tip_force", "trocar_force", "track"])
def test_f02_a_measurement_that_is_not_finite_faults(
    runs: int, reactions: Reactions, quantity: str
) -> None:
    """A tracker without a number faults; the arm itself is still known, so it ramps."""
    seen = []
    for seed in range(runs):
        bench = Bench(seed, track_rcm=quantity == "track").start()
        stream = bench.warm_up()
        value = float(bench.rng.choice([math.nan, math.inf, -math.inf]))
        spoilt = bench.q.copy() if quantity == "q" else np.zeros_like(bench.q)
        expected = Reason.STATE_NOT_FINITE
        if quantity in ("q", "qd"):
            spoilt[bench.rng.integers(len(spoilt))] = value
            faulty: dict[str, Any] = {quantity: spoilt}
        elif quantity == "track":
            p = np.array(bench.p_trocar)
            p[bench.rng.integers(3)] = value
            faulty = {"readings": surg_core.Readings(p_BTrack=p, v_BTrack=[0, 0, 0])}
            expected = Reason.NOT_FINITE
        else:
            f = np.zeros(3)
            f[bench.rng.integers(3)] = value
            faulty, expected = force(f, quantity), Reason.FORCE
        out = bench.step(stream(), **faulty)
        assert (out.state, out.reason) == (State.FAULT, expected)
        seen.append(0)
        bench.rest(**faulty)
        assert bench.controller.request(StateCommand.ENABLE) == expected, "while the cause lasts"
        bench.rest()
        assert bench.jerked <= ROUNDING
        assert bench.controller.request(StateCommand.ENABLE) == Reason.NONE
    what = "FAULT, stop" if quantity == "track" else "FAULT, fade"
    reactions.add("F02", f"NaN or infinity measured in {quantity}", what, seen, 0)


@pytest.mark.parametrize("kind", STREAMS)
def test_f03_a_stream_that_ends_stops_the_arm_in_cycle_51(
    runs: int, reactions: Reactions, kind: str
) -> None:
    noticed, beyond, travel = [], [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up(kind)
        out = bench.step(last := stream())
        begin, goal, silent = bench.tip(), bench.setpoint(), 0
        if kind.endswith("p"):
            goal = last.p if kind == "servo_cp" else tip_of(last.joints)
        u = (goal - begin) / max(float(np.linalg.norm(goal - begin)), 1e-9)
        over = 0.0
        while silent < 300:
            silent += 1
            out = bench.step()
            over = max(over, float((bench.tip() - goal) @ u))
            if out.reason == Reason.STALE:
                noticed.append(silent)
        assert out.state == State.ENABLED
        travel.append(1e3 * float(np.linalg.norm(bench.tip() - begin)))
        beyond.append(1e3 * over)
        rest = bench.tip()
        for _ in range(50):
            bench.step()
        assert np.linalg.norm(bench.tip() - rest) < 1e-5
        assert bench.jerked <= ROUNDING
        if kind == "servo_cp":  # messages that come late are far from where it stopped
            p = bench.setpoint() + 0.0025 * bench.direction()
            verdict = bench.step(command("servo_cp", p=p, rotation=[0, 0, 0, 1])).verdicts[0]
            assert verdict.reason == Reason.STREAM_START_TOO_FAR
            near = command("servo_cp", p=bench.setpoint(), rotation=[0, 0, 0, 1])
            assert bench.step(near).verdicts[0].reason == Reason.HELD, "it must end first"
            for _ in range(60):
                bench.step()
            p = bench.setpoint() + 0.0015 * bench.direction()
            verdict = bench.step(command("servo_cp", p=p, rotation=[0, 0, 0, 1])).verdicts[0]
            assert verdict.reason == Reason.NONE
    assert len(noticed) == runs
    assert set(noticed) == {51}
    reactions.add("F03", f"{kind} falls silent", "stop (0.1 s + 1 cycle)", noticed, 51)
    if kind.endswith("p"):
        name = "beyond the last target, from up to 50 mm/s"
        reactions.add("F03", f"{kind} falls silent", name, beyond, 2.0, "mm")
    else:
        most = 1e3 * (0.05 * math.sqrt(3) * (51 * TICK + 0.015) + 0.05**2 / 4)
        reactions.add("F03", f"{kind} falls silent", "travel from 50 mm/s", travel, most, "mm")


def tip_of(joints: Any) -> np.ndarray:
    """Tip of yaw, pitch, insertion in the rcm frame, by the definition in the conventions."""
    yaw, pitch, depth, _ = joints
    c = math.cos(pitch)
    return depth * np.array([math.sin(yaw) * c, math.sin(pitch), math.cos(yaw) * c])


# --- links ----------------------------------------------------------------------------------


def test_f10_a_silent_robot_link_faults_at_its_time_out(runs: int, reactions: Reactions) -> None:
    cycles = []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up()
        most = round(bench.robot.tuning.link_timeout / TICK)
        q, qd, age = bench.q.copy(), np.array(bench.out.qd_command), 0
        while bench.out.state == State.ENABLED:
            age += 1
            bench.step(stream(), q=q, qd=qd, state_age=age * TICK)
            assert age <= most + 1
            if bench.out.reason in (Reason.NOT_FOLLOWING,):
                break
        assert (bench.out.state, bench.out.reason) == (State.FAULT, Reason.LINK_LOST)
        cycles.append(age)
        bench.rest(state_valid=False)
        assert bench.jerked <= ROUNDING
        assert bench.controller.request(StateCommand.ENABLE) == Reason.LINK_LOST
        bench.step(state_valid=False)
        assert bench.controller.request(StateCommand.ENABLE) == Reason.LINK_LOST
    reactions.add("F10", "no state from the robot link", "FAULT(link), fade", cycles, 51)


LOSSES = {
    "1 % lost": Wire(loss=0.01),
    "5 % lost": Wire(loss=0.05),
    "bursts of 5": Wire(loss=0.02, burst=5),
    "5 % doubled, 5 % swapped": Wire(duplicate=0.05, reorder=0.05),
    "all of it": Wire(loss=0.02, burst=5, duplicate=0.05, reorder=0.05),
}


@pytest.mark.parametrize("what", LOSSES)
def test_f11_lost_doubled_and_swapped_states_do_not_disturb(
    runs: int, reactions: Reactions, what: str
) -> None:
    off, lost = [], 0
    for seed in range(runs):
        tips = []
        for wire in (Wire(), LOSSES[what]):
            bench = Bench(seed).start()
            channel = Channel(wire, np.random.default_rng(seed))
            stream = bench.wander("servo_cp", 0.05)
            newest = (0, bench.q, np.zeros_like(bench.q))
            way = []
            for k in range(1, 300):
                sent = channel.transmit((k, bench.q, bench.qd))
                newest = max([newest, *sent], key=lambda x: x[0])
                _, q, qd = newest
                out = bench.step(stream(), q=q, qd=qd, state_age=(k - newest[0]) * TICK)
                assert out.state == State.ENABLED, out.reason
                way.append(bench.deviation())
            tips.append(way)
            assert bench.jerked <= ROUNDING
            lost += channel.lost + channel.swapped + channel.doubled
        off.append(1e6 * max(abs(a - b) for a, b in zip(*tips, strict=True)))
    assert lost > runs
    reactions.add(
        "F11", f"robot/measured_js, {what}", "change of the pivot's deviation", off, 100, "µm"
    )


def test_f11_a_long_burst_is_a_lost_link(runs: int, reactions: Reactions) -> None:
    cycles = []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up("servo_cp", 0.03)
        burst = int(bench.rng.integers(52, 200))
        channel = Channel(Wire(loss=1.0, burst=burst), bench.rng)
        k = 0
        q, qd = bench.q.copy(), np.array(bench.out.qd_command)
        while bench.out.state == State.ENABLED:
            k += 1
            assert not channel.transmit(k)
            bench.step(stream(), q=q, qd=qd, state_age=k * TICK)
        assert bench.out.reason == Reason.LINK_LOST
        cycles.append(k)
    reactions.add("F11", "burst longer than link_timeout", "FAULT(link)", cycles, 51)


@pytest.mark.parametrize("ticks", [25, 50])
def test_f27_waking_from_a_freeze_is_no_jump(runs: int, reactions: Reactions, ticks: int) -> None:
    """The arm goes on with the last command, as a link does that has not noticed yet."""
    jumps, away = [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up("servo_cp")
        late = [stream() for _ in range(ticks)]
        bench.freeze(ticks)
        bench.jerked = 0.0
        # What has queued up comes at once.
        bench.step(*late, elapsed=(ticks + 1) * TICK)
        for _ in range(100):
            bench.step(stream())
            away.append(1e3 * bench.deviation())
        assert bench.out.state in (State.ENABLED, State.PAUSED), bench.out.reason
        jumps.append(bench.jerked)
    name = f"controller frozen for {ticks * 2} ms"
    reactions.add("F27", name, "change of a joint's command / (a T)", jumps, ROUNDING, "1")
    reactions.add("F27", name, "deviation from the trocar", [max(away)], 2.0, "mm")


# --- geometry -------------------------------------------------------------------------------


def robot_with(joint: int, side: int, room: float) -> surg_core.RobotConfig:
    """The shipped robot with one position limit as near to home as said."""
    document = surg_core.read_document(shipped("sim_ur5e").robot.file)
    values = dict(document.values)
    key = "joints.position_max" if side > 0 else "joints.position_min"
    limits = list(values[key])
    limits[joint] = float(values["joints.home"][joint]) + side * room
    values[key] = limits
    return _core.parse_robot(_core.Document(document.file, values))


WISHES = [
    *([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]),
    *([(sign * np.eye(3)[0], 1.0) for sign in (1.0, -1.0)]),
]


def drive(wish: Any, speed: float, backwards: bool = False) -> surg_core.MotionCommand:
    """A tip velocity, or a roll."""
    sign = -1.0 if backwards else 1.0
    if isinstance(wish, tuple):
        return command("servo_cv", p=[0, 0, 0], roll_rate=sign * wish[0][0] * 0.6)
    return command("servo_cv", p=sign * speed * wish)


def test_f20_every_joint_stops_before_its_limit_and_leaves_it(
    full: bool, reactions: Reactions
) -> None:
    margins, fast, stopped, cases = [], [], 0, 0
    for joint, side in itertools.product(range(6), (1, -1)):
        # What moves this joint that way the most, seen without the near limit.
        pulls = []
        for wish in WISHES:
            free = Bench().start()
            for _ in range(40):
                free.step(drive(wish, 0.05))
            pulls.append(side * float(free.out.qd_command[joint]))
        wish = WISHES[int(np.argmax(pulls))]
        for speed in (0.03, 0.06, 0.15) if full else (0.06,):
            cases += 1
            bench = Bench(robot=robot_with(joint, side, 0.12)).start()
            limit = bench.robot.home[joint] + side * 0.12
            left = [0.12]
            for _ in range(4000):
                out = bench.step(drive(wish, speed))
                assert out.state == State.ENABLED, out.reason
                left.append(side * (limit - bench.q[joint]))
                if left[-2] < 0.5 * bench.limits.joint_margin:
                    fast.append((left[-2] - left[-1]) / TICK - 5 * left[-2])
                if left[-1] < 0.002 and np.abs(out.qd_command).max() < 0.002:
                    break
            margins.append(-min(left))
            stopped += min(left) < 0.06
            assert bench.deviation() < bench.limits.rcm_error_warn
            assert bench.jerked <= ROUNDING
            at = bench.q[joint]
            for _ in range(300):
                out = bench.step(drive(wish, speed, backwards=True))
            assert out.state == State.ENABLED
            assert side * (at - bench.q[joint]) > 0.005, f"joint {joint} does not come back"
    assert cases >= 12
    assert stopped >= 12, f"only {stopped} of {cases} came near their limit"
    # The arm lags by 12 ms: its speed belongs to a distance that has shrunk meanwhile.
    name = "a joint driven into its limit, each both ways"
    reactions.add(
        "F20", name, "speed above 5 /s times the distance, inner half", [max(fast)], 0.05, "rad/s"
    )
    reactions.add("F20", name, "beyond the limit (negative: before it)", margins, 0.0, "rad")


def test_f21_towards_an_aligned_wrist(runs: int, reactions: Reactions) -> None:
    speeds, deviations, ways = [], [], []
    for seed in range(runs):
        arm = shipped("sim_ur5e")
        rng = np.random.default_rng(seed)
        home = np.array(arm.robot.home)
        home[4] = rng.choice([-1, 1]) * rng.uniform(0.15, 0.4)
        bench = Bench(seed, home=home, depth=float(rng.uniform(0.08, 0.15))).start()
        # The tip's direction that straightens the wrist the fastest.
        pulls = []
        for wish in WISHES[:6]:
            free = Bench(seed, home=home, depth=0.1).start()
            for _ in range(30):
                free.step(drive(wish, 0.02))
            pulls.append(-np.sign(home[4]) * float(free.out.qd_command[4]))
        wish = WISHES[int(np.argmax(pulls))]
        nearest = abs(bench.q[4])
        for _ in range(900):
            out = bench.step(drive(wish, 0.04))
            assert out.state == State.ENABLED, out.reason
            ratio = np.abs(out.qd_command) / np.array(arm.robot.velocity)
            speeds.append(float(ratio.max()))
            nearest = min(nearest, abs(bench.q[4]))
            deviations.append(1e3 * bench.deviation())
        before = bench.tip()
        for _ in range(300):  # a set-point whose clock is slow turns round slowly
            out = bench.step(drive(wish, 0.04, backwards=True))
        ways.append(-1e3 * float(-wish @ (bench.tip() - before)))
        assert out.state == State.ENABLED
        assert bench.jerked <= ROUNDING
    name = "tip driven towards an aligned wrist"
    reactions.add("F21", name, "joint speed / its limit", [max(speeds)], ROUNDING, "1")
    reactions.add("F21", name, "deviation from the trocar", [max(deviations)], 1.0, "mm")
    reactions.add("F21", name, "way back in 0.6 s (negative: it leaves)", ways, -3.0, "mm")


def test_f22_without_a_trocar_nothing_is_enabled(reactions: Reactions) -> None:
    moved = []
    for motion in ("servo_cp", "servo_cv", "servo_jp", "servo_jv", "move_cp", "insert"):
        bench = Bench()
        for word in (StateCommand.ENABLE, StateCommand.HOME):
            assert bench.controller.request(word) == Reason.RCM_UNSET
        out = bench.step(command(motion, p=[0, 0, 0.1], joints=[0, 0, 0.1, 0]))
        assert out.verdicts[0].reason == Reason.NOT_ENABLED
        for _ in range(50):
            moved.append(float(np.abs(bench.step().qd_command).max()))
    assert "rcm/set_cp" in surg_core.sentence(Reason.RCM_UNSET)
    reactions.add("F22", "no trocar point", "largest command", moved, 0.0, "rad/s")


@pytest.mark.parametrize("how", ["pushed aside", "tracked jump", "tracked out of bounds"])
def test_f23_a_trocar_off_the_shaft_faults(runs: int, reactions: Reactions, how: str) -> None:
    seen, still = [], []
    for seed in range(runs):
        bench = Bench(seed, track_rcm=True).start()
        stream = bench.warm_up()
        assert bench.controller.set_rcm(bench.p_trocar) == Reason.RCM_WHILE_ENABLED
        faulty: dict[str, Any] = {}
        if how == "pushed aside":
            q = bench.q.copy()
            push = np.zeros_like(q)
            push[3] = bench.rng.choice([-1, 1]) * bench.rng.uniform(0.01, 0.02)
            faulty = {"q": q + push, "qd": np.array(bench.out.qd_command) + push / TICK}
        else:
            R = np.asarray(bench.controller.X_BR)[:3, :3]
            far = how.endswith("bounds")
            offset = R @ bench.direction(lateral=True) * bench.rng.uniform(0.003, 0.0095)
            if far:
                offset = bench.direction() * bench.rng.uniform(0.0101, 0.05)
            readings = surg_core.Readings(p_BTrack=bench.p_trocar + offset, v_BTrack=np.zeros(3))
            faulty["readings"] = readings
        out = bench.step(stream(), **faulty)
        assert (out.state, out.reason) == (State.FAULT, Reason.RCM_ERROR)
        seen.append(0)
        still.append(bench.rest())
        assert bench.jerked <= ROUNDING
    reactions.add("F23", f"trocar off the shaft: {how}", "FAULT(rcm_error)", seen, 0)
    reactions.add("F23", f"trocar off the shaft: {how}", "standstill", still, STILL)


def test_f24_near_the_trocar_only_the_way_along_the_shaft(runs: int, reactions: Reactions) -> None:
    sideways, shallow, commanded, flange, out_again = [], [], [], [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        limits = bench.limits
        u = bench.direction(lateral=True)
        up = float(bench.rng.uniform(0.06, 0.25))
        aside = float(bench.rng.uniform(0.0, 0.1))
        previous = bench.setpoint()
        for k in range(1200):
            s = previous / np.linalg.norm(previous)
            wish = -up * s + aside * math.sin(0.01 * k) * u
            out = bench.step(command("servo_cv", p=wish))
            assert out.state == State.ENABLED, out.reason
            p = bench.setpoint()
            depth = float(np.linalg.norm(previous))
            step = p - previous
            lateral = np.linalg.norm(step - s * (s @ step)) / TICK
            fade = (depth - limits.depth_min) / (limits.depth_slow - limits.depth_min)
            allowed = limits.tip_velocity * math.sqrt(3) * min(max(fade, 0.0), 1.0)
            sideways.append(1e3 * (float(lateral) - allowed))
            flange.append(bench.flange_speed())
            commanded.append(bench.commanded_flange_speed())
            previous = p
        shallow.append(1e3 * (limits.depth_min - out.depth))
        assert out.depth < limits.depth_min + 0.003, "it never came near the trocar"
        assert bench.deviation() < 1e-4
        # Above the floor no target is taken, and the way out is open.
        p = 0.7 * limits.depth_min * previous / np.linalg.norm(previous)
        verdict = bench.step(command("move_cp", p=p, rotation=[0, 0, 0, 1])).verdicts[0]
        assert verdict.reason == Reason.OUTSIDE_WORKSPACE
        for _ in range(300):
            bench.step()
        assert bench.step(command("withdraw")).verdicts[0].reason == Reason.NONE
        for _ in range(4000):
            out = bench.step()
            flange.append(bench.flange_speed())
            commanded.append(bench.commanded_flange_speed())
            assert bench.deviation() < 1e-4
            if not out.busy:
                break
        out_again.append(1e3 * out.depth)
        verdict = bench.step(command("servo_cv", p=[0.01, 0, 0])).verdicts[0]
        assert verdict.reason == Reason.NOT_INSERTED
    name = "tip driven to the trocar"
    reactions.add("F24", name, "sideways speed above what is allowed there", sideways, 1e-3, "mm/s")
    reactions.add("F24", name, "above depth_min", shallow, 0.5, "mm")
    # The command keeps the limit; joints that answer late, each by another lag, may add a little.
    limit = bench.limits.flange_velocity
    reactions.add("F24", name, "flange speed, commanded", [max(commanded)], limit * ROUNDING, "m/s")
    reactions.add("F24", name, "flange speed of the late arm", [max(flange)], 1.02 * limit, "m/s")
    reactions.add("F24", "rcm/withdraw", "depth at its end", out_again, -9.0, "mm")


# --- forces ---------------------------------------------------------------------------------


def test_f25_soft_force_yields_and_pauses_after_100_ms(runs: int, reactions: Reactions) -> None:
    """A spring wall that the tip is driven into."""
    pause, into, most = [], [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        for _ in range(20):
            bench.step()
        u, begin = bench.direction(), bench.tip()
        R = np.asarray(bench.controller.X_BR)[:3, :3]
        above, braking, largest = 0, 0, 0.0
        while bench.out.state == State.ENABLED:
            depth = max(0.0, float((bench.tip() - begin) @ u) - 0.003)
            f = -1500.0 * depth * (R @ u)
            size = float(np.linalg.norm(f))
            before = bench.setpoint()
            out = bench.step(command("servo_cv", p=0.02 * u), **force(f))
            largest = max(largest, size)
            if size > bench.limits.tip_force_soft:
                above += 1
                if float((bench.setpoint() - before) @ u) > 1e-9:
                    braking = above
            assert bench.cycles < 3000
        assert (out.state, out.reason) == (State.PAUSED, Reason.FORCE)
        pause.append(above - 1)
        into.append(braking)
        most.append(largest)
        assert bench.jerked <= ROUNDING
        # Away from it is allowed: resume, and back.
        bench.rest(**force(f))
        assert bench.controller.request(StateCommand.RESUME) == Reason.NONE
        for _ in range(200):
            depth = max(0.0, float((bench.tip() - begin) @ u) - 0.003)
            bench.step(command("servo_cv", p=-0.02 * u), **force(-1500.0 * depth * (R @ u)))
            assert bench.out.state == State.ENABLED
        assert float((bench.tip() - begin) @ u) < 0.003
    name = "5 N at the tip, wall of 1.5 N/mm at 20 mm/s"
    reactions.add("F25", name, "no motion into it after", into, 5)
    reactions.add("F25", name, "PAUSED(force) after the first sample above", pause, 50)
    reactions.add("F25", name, "largest force", most, bench.limits.tip_force_hard, "N")


@pytest.mark.parametrize("where", ["tip_force", "trocar_force"])
def test_f25_hard_force_and_trocar_load_stop(runs: int, reactions: Reactions, where: str) -> None:
    seen, still = [], []
    limit = getattr(shipped("sim_ur5e").limits,
                    "tip_force_hard" if where == "tip_force" else "trocar_force_fault")  # fmt: skip
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up()
        f = bench.direction()
        if where == "trocar_force":
            assert bench.step(stream(), **force(0.999 * limit * f, where)).warn_force
            assert bench.out.state == State.ENABLED
        out = bench.step(stream(), **force(1.001 * limit * f, where))
        assert (out.state, out.reason) == (State.FAULT, Reason.FORCE)
        seen.append(0)
        still.append(0 if is_still(bench) else 1 + bench.rest(**force(2 * limit * f, where)))
        assert bench.jerked <= ROUNDING
        bench.step(**force(2 * limit * f, where))
        assert bench.controller.request(StateCommand.ENABLE) == Reason.FORCE
        bench.step()
        assert bench.controller.request(StateCommand.ENABLE) == Reason.NONE
    name = f"{where.replace('_', ' ')} above {limit:g} N"
    reactions.add("F25", name, "FAULT(force)", seen, 0)
    reactions.add("F25", name, "zero commanded", still, STILL)


# --- senders and jaw ------------------------------------------------------------------------


def test_f26_a_second_sender_changes_nothing_bit_for_bit(runs: int, reactions: Reactions) -> None:
    obeyed, stops = [], []
    for seed in range(runs):
        alone = Bench(seed).start()
        stream = alone.wander("servo_cp", 0.04)
        reference = [np.array(alone.step(stream()).qd_command) for _ in range(150)]
        bench = Bench(seed).start()
        stream, other = bench.wander("servo_cp", 0.04), bench.wander("servo_cp", 0.05)
        rng = np.random.default_rng(seed + 10_000)
        for k in range(150):
            mine, theirs = stream(), other()
            foreign = command("servo_cp", STRANGER, p=theirs.p, rotation=[0, 0, 0, 1])
            both = [mine, foreign]
            if k > 0 and rng.random() < 0.5:
                both.reverse()
            out = bench.step(*both)
            verdicts = {v.source: v.reason for v in out.verdicts}
            assert verdicts == {SOURCE: Reason.NONE, STRANGER: Reason.NO_AUTHORITY}
            assert out.source == SOURCE
            obeyed.append(int(np.any(out.qd_command != reference[k])))
        word = ("hold", "pause", "disable")[seed % 3]
        if word == "hold":
            assert bench.step(command("hold", STRANGER)).verdicts[0].reason == Reason.NONE
        else:
            request = getattr(StateCommand, word.upper())
            assert bench.controller.request(request) == Reason.NONE
        cycles = 0
        while float(np.linalg.norm(bench.step(stream()).v_BTip)) > 1e-4:
            cycles += 1
        stops.append(cycles)
    reactions.add("F26", "a second sender", "cycles that differ from those without it", obeyed, 0)
    reactions.add("F26", "hold, pause, disable by it", "standstill", stops, STILL)


def stop_by(bench: Bench, how: str) -> None:
    """One of the ways in which an arm is stopped."""
    if how in ("pause", "disable"):
        assert bench.controller.request(getattr(StateCommand, how.upper())) == Reason.NONE
    elif how == "not finite":
        bench.step(command("servo_cv", p=[math.nan, 0, 0]))
    elif how == "state":
        bench.step(q=np.full_like(bench.q, math.nan))
    elif how == "link":
        bench.step(state_age=1.0)
    elif how == "force":
        bench.step(**force([100, 0, 0]))
    elif how == "pivot":
        push = 0.02 * (np.arange(len(bench.q)) == 3)
        bench.step(q=bench.q + push, qd=np.array(bench.out.qd_command) + push / TICK)
    elif how == "tool":
        bench.step(readings=surg_core.Readings(jaw_age=0.201))
    else:
        bench.controller.pause(Reason.OVERRUN)


STOPS = ("pause", "disable", "not finite", "state", "link", "force", "pivot", "tool", "overrun")


@pytest.mark.parametrize("how", STOPS)
def test_f31_no_stop_moves_the_jaw(full: bool, reactions: Reactions, how: str) -> None:
    """The jaw is on its way when the arm is stopped: it stays where it was, then and afterwards."""
    moved = []
    for seed in range(20 if full else 3):
        bench = Bench(seed).start()
        stream = bench.warm_up()
        goal = float(bench.rng.choice([0.0, 0.9]))
        bench.step(command("jaw_servo_jp", jaw=goal), stream())
        for _ in range(int(bench.rng.integers(3, 20))):
            bench.step(stream())
        before = bench.out.jaw_set
        assert before not in (0.4, goal)
        stop_by(bench, how)
        begin = bench.out.jaw_set
        assert abs(begin - before) <= bench.arm.instrument.jaw_velocity * TICK * ROUNDING
        told = {"readings": surg_core.Readings(jaw_age=0.3)} if how == "tool" else {}
        for _ in range(100):
            bench.step(stream(), command("jaw_servo_jp", jaw=goal), **told)
            moved.append(abs(bench.out.jaw_set - begin))
        for _ in range(100):
            bench.step()
        if bench.out.state == State.PAUSED:
            assert bench.controller.request(StateCommand.RESUME) == Reason.NONE
        elif bench.out.state != State.ENABLED:
            assert bench.controller.request(StateCommand.ENABLE) == Reason.NONE
        for _ in range(50):  # another sender, another session: nothing is left of the old goal
            bench.step(command("servo_cv", STRANGER, p=[0, 0, 0]))
            moved.append(abs(bench.out.jaw_set - begin))
        assert bench.out.state == State.ENABLED
    reactions.add("F31", f"jaw on its way, stopped by: {how}", "jaw moves by", moved, 0.0, "rad")


def test_f31_a_lost_tool_link_holds_the_arm(runs: int, reactions: Reactions) -> None:
    said, still = [], []
    for seed in range(runs):
        bench = Bench(seed).start()
        stream = bench.warm_up()
        age = 0
        while bench.out.reason != Reason.TOOL_LOST:
            age += 1
            bench.step(stream(), readings=surg_core.Readings(jaw_age=age * TICK))
        said.append(age)
        assert bench.out.verdicts[0].reason == Reason.TOOL_LOST
        n = 0
        while np.linalg.norm(bench.out.v_BTip) > 1e-4:
            n += 1
            bench.step(stream(), readings=surg_core.Readings(jaw_age=(age + n) * TICK))
        still.append(n)
        assert bench.out.state == State.ENABLED
        assert bench.jerked <= ROUNDING
    reactions.add("F31", "no state from the tool link", "said, commands refused", said, 101)
    reactions.add("F31", "no state from the tool link", "arm at rest after that", still, STILL)
