"""A headset's dead-man: from the page's inputs to the commands of both arms, on a fake clock."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.control.gate_arm import TICK, GateArm
from helpers.teleop.hand import settings
from surg_console.session.console_orders import Camera, Clutch, EnableTeleop, Move, Order
from surg_console.session.console_session import ConsoleSession, Phase
from surg_console.session.dead_man import SETTLE, DeadMan
from surg_console.session.operator_messages import HIDDEN
from surg_console.session.system_state import Arm, Follower, Robot
from surg_console.web.page_protocol import Input
from surg_core.hand.leader_sample import HandlePose, LeaderSample
from surg_teleop.follow.arm_switch import ArmSwitch
from surg_teleop.follow.teleop_types import CameraView, TeleopState
from surg_teleop.follow.teleoperation import Teleop

PERIOD = 0.012
"""[s] between two frames of a headset, a little more than at 90 Hz."""
LATEST = 0.06
"""[s] Longest that an order is on its way; each topic has a delay of its own."""
CATCHES_UP = 0.03
"""[s] Longest that an arm goes on to its last target."""
STRAIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Hands:
    """What the operator does with both controllers."""

    p: dict[str, np.ndarray] = field(
        default_factory=lambda: {"left": np.zeros(3), "right": np.ones(3)}
    )
    held: dict[str, bool] = field(default_factory=lambda: {"left": False, "right": False})
    seen: dict[str, bool] = field(default_factory=lambda: {"left": True, "right": True})

    def keys(self) -> dict[str, object]:
        """What the page says of them."""
        hand = "left" if self.held["left"] else "right"
        x, y, z = self.p[hand].tolist()
        squeeze = self.held["left"] or self.held["right"]
        return {
            "p": (x, y, z), "q": STRAIGHT, "camera": self.held["left"], "squeeze": squeeze,
            "tracked": self.seen[hand],
        }  # fmt: skip


class Bench:
    """A headset's page, the console's session, the teleoperation and two arms that are gates."""

    def __init__(self, seed: int, loses: type[Order] | None = None) -> None:
        self.random, self.loses = random.Random(seed), loses
        self.session, self.hands = ConsoleSession(pictures=False), Hands()
        self.session.join("a", 0.0)
        names = ("PSM1", "ECM")
        self.arms = {name: GateArm() for name in names}
        teleops = [Teleop(settings(arm=name), scale=0.5) for name in names]
        self.switch = ArmSwitch(*teleops)
        kinds = (Move, Clutch, Camera, EnableTeleop)
        self.way: dict[type, deque[tuple[float, Order]]] = {kind: deque() for kind in kinds}
        self.pedals: set[str] = set()
        self.sample: LeaderSample | None = None
        self.now, self.seq, self.spoken = 0.0, 0, -1.0
        self.moves: list[Input] = []

    def enable(self) -> None:
        assert self.session.enable("a", self.robot(), self.now) == ""

    def robot(self) -> Robot:
        state = self.switch.instrument.state.name
        return Robot((Arm("PSM1", "ENABLED", True, self.now),), Follower(state, scale=0.5))

    def send(self) -> None:
        for order in self.session.take_orders():
            if type(order) not in self.way or type(order) is self.loses:
                continue
            queue = self.way[type(order)]
            at = self.now + self.random.uniform(0.0, LATEST)
            queue.append((max(at, queue[-1][0] if queue else 0.0), order))  # in order, as by TCP

    def arrive(self) -> None:
        for kind, queue in self.way.items():
            while queue and queue[0][0] <= self.now:
                _, order = queue.popleft()
                if isinstance(order, Move):
                    self.moves.append(order.sample)
                    pose = HandlePose(np.array(order.sample.p), np.array(order.sample.q))
                    self.sample = LeaderSample(self.now, pose=pose, grip=order.sample.grip)
                elif isinstance(order, EnableTeleop):
                    self.switch.enable() if order.value else self.switch.disable()
                elif isinstance(order, Clutch | Camera):
                    name = kind.__name__.lower()
                    self.pedals = self.pedals | {name} if order.value else self.pedals - {name}

    def tick(self, speaks: bool = True, **keys: object) -> dict[str, float]:
        """One cycle of the arms; how far each has been moved [m]."""
        self.now += TICK
        if speaks and self.now - self.spoken >= PERIOD:
            self.spoken, self.seq = self.now, self.seq + 1
            sample = Input(self.seq, self.now, **{**self.hands.keys(), **keys})
            self.session.receive("a", sample, self.now)
        self.session.tick(self.robot(), self.now)
        self.send()
        self.arrive()
        sample = self.sample
        if sample is not None:
            sample = LeaderSample(
                sample.stamp, pose=sample.pose, grip=sample.grip, buttons=frozenset(self.pedals)
            )
        views = {name: arm.view() for name, arm in self.arms.items()}
        camera = CameraView(np.eye(3), self.now)
        outputs = self.switch.tick(self.now, sample, views, camera)
        before = {name: arm.p for name, arm in self.arms.items()}
        for name, arm in self.arms.items():
            arm.step(outputs[name].commands)
        return {
            name: float(np.linalg.norm(arm.p - before[name])) for name, arm in self.arms.items()
        }

    def run(self, seconds: float, v: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Both hands move; how far each arm has come, (2, 3) [m]."""
        before = np.array([arm.p for arm in self.arms.values()])
        for _ in range(round(seconds / TICK)):
            for hand in self.hands.p.values():
                hand += np.array(v) * TICK
            self.tick()
        return np.array([arm.p for arm in self.arms.values()]) - before

    def squeeze(self, left: bool = False, right: bool = False) -> None:
        self.hands.held = {"left": left, "right": right}


def started(seed: int = 1, loses: type[Order] | None = None) -> Bench:
    bench = Bench(seed, loses)
    bench.run(0.1)
    bench.enable()
    bench.run(0.6)
    assert bench.session.phase is Phase.DRIVING, bench.session.reason
    return bench


RIGHT = (0.05, 0.0, 0.0)
"""[m/s]"""


def test_the_instrument_follows_the_right_hand_and_the_endoscope_the_left_one() -> None:
    bench = started()
    assert np.abs(bench.run(0.5, RIGHT)).max() == 0.0, "no squeeze"
    bench.squeeze(right=True)
    instrument, scope = bench.run(1.0, RIGHT)
    assert instrument == pytest.approx([0.5 * 0.05 * (1.0 - SETTLE), 0, 0], abs=0.002)
    assert np.all(scope == 0)
    bench.squeeze(left=True, right=True)
    bench.run(0.2)
    instrument, scope = bench.run(1.0, (0.0, 0.0, 0.05))
    assert np.all(instrument == 0) and scope == pytest.approx([0, 0, 0.0215], abs=0.003)
    bench.squeeze(right=True)  # the endoscope's squeeze let go, the instrument's still held
    bench.run(0.2)
    assert bench.run(0.5, RIGHT)[0, 0] > 0.006
    bench.squeeze()
    bench.run(0.2)
    assert np.abs(bench.run(0.5, RIGHT)).max() == 0.0


def test_a_squeeze_from_before_enable_and_after_a_loss_is_no_squeeze() -> None:
    bench = Bench(2)
    bench.squeeze(right=True)
    bench.run(0.1)
    bench.enable()
    assert np.abs(bench.run(1.0, RIGHT)).max() == 0.0
    bench.squeeze()
    bench.run(0.1)
    bench.squeeze(right=True)
    assert bench.run(0.5, RIGHT)[0, 0] > 0.005
    bench.hands.seen["right"] = False
    bench.run(0.1)
    assert np.abs(bench.run(0.3, RIGHT)).max() == 0.0
    bench.hands.seen["right"] = True
    assert np.abs(bench.run(0.5, RIGHT)).max() == 0.0, "found again, and still squeezed"
    bench.squeeze()
    bench.run(0.05)
    bench.squeeze(right=True)
    assert bench.run(0.5, RIGHT)[0, 0] > 0.005


@pytest.mark.parametrize("why", ["headset", "recentred"])
def test_f03_a_headset_that_is_taken_off_or_recentred_holds_and_nothing_resumes(why: str) -> None:
    bench = started()
    bench.squeeze(right=True)
    bench.run(0.4, RIGHT)
    bench.session.hide("a", why)
    assert bench.session.reason == HIDDEN[why]
    bench.run(LATEST + 0.02, RIGHT)
    for held in (True, False, True):
        bench.squeeze(right=held)
        assert np.abs(bench.run(0.5, RIGHT)).max() == 0.0
    assert bench.session.phase is Phase.HELD


def test_a_clutch_that_never_arrives_lets_no_more_through_than_the_squeezes_did() -> None:
    """The teleoperation follows all the time; what goes out stands still by itself."""
    bench = started(loses=Camera)
    bench.squeeze(right=True)
    bench.run(0.3)
    bench.squeeze()
    bench.loses = Clutch
    bench.pedals.clear()
    bench.switch.enable()
    bench.run(0.3)
    assert bench.switch.instrument.state is TeleopState.FOLLOWING, "although nothing is squeezed"
    assert np.abs(bench.run(1.0, RIGHT)).max() == 0.0
    for _ in range(3):
        bench.squeeze(right=True)
        came = bench.run(0.5, RIGHT)[0, 0]
        bench.squeeze()
        came += bench.run(0.2, RIGHT)[0, 0]
        assert came <= 0.5 * 0.05 * 0.5 + 1e-9
        assert np.abs(bench.run(0.3, (0.3, -0.4, 0.2))).max() == 0.0


def test_the_handles_turn_goes_on_where_it_was_let_go_and_about_its_own_axis() -> None:
    bench = started()
    found = []
    for held in ((0.0, 0.0, 0.0), (0.8, -0.4, 0.3)):
        base = Rotation.from_rotvec(held)
        for squeezed, part in ((False, 0.0), (True, 0.0), (True, 1.0), (False, 0.3)):
            turn = base * Rotation.from_rotvec([0, 0, 0.5 * part])
            bench.squeeze(right=squeezed)
            for _ in range(80):
                bench.tick(q=tuple(turn.as_quat().tolist()))
        found.append(Rotation.from_quat(bench.moves[-1].q).as_rotvec())
    assert found[0] == pytest.approx([0, 0, 0.5], abs=1e-9)
    assert found[1] == pytest.approx([0, 0, 1.0], abs=1e-9), "about the handle, however it is held"


def test_clutch_pedal_and_motion_follow_one_another_with_a_distance() -> None:
    """The pedal moves under a clutch that has long been closed; motion under one long open."""
    pedals = motions = 0
    for seed in range(40):
        rng, man, hands, now = random.Random(seed), DeadMan(), Hands(), 0.0
        closed = pedal = -1.0
        before = man.pass_on(Input(1, 0.0, **hands.keys()), 0.0)
        for seq in range(2, 300):
            now += PERIOD
            hand = rng.choice(("left", "right"))
            hands.held[hand] ^= rng.random() < 0.06
            hands.seen[hand] ^= rng.random() < 0.02
            hands.p[hand] += 0.001
            out = man.pass_on(Input(seq, now, **hands.keys()), now)
            if out.camera != before.camera:
                pedals += 1
                assert before.clutch and out.clutch and now - closed >= SETTLE - 1e-9, (seed, now)
                pedal = now
            if out.clutch != before.clutch:
                assert out.clutch or now - pedal >= SETTLE - 1e-9, (seed, now)
                closed = now
            if out.p != before.p:
                motions += 1
                assert not out.clutch and now - closed >= SETTLE - 1e-9, (seed, now)
            before = out
    print(f"{pedals} pedals, {motions} motions")
    assert pedals > 40 and motions > 200


def lives(seed: int) -> Iterator[tuple[Bench, dict[str, float], dict[str, bool]]]:
    """One random life: bench, how far each arm went, and which arm a squeeze allows to."""
    bench = Bench(seed)
    rng = bench.random
    until, v, armed, may, speaks = 0.0, np.zeros(3), False, False, True
    for _ in range(900):
        if bench.now >= until:
            until = bench.now + rng.uniform(0.02, 0.25)
            v = np.array([rng.uniform(-0.2, 0.2) for _ in range(3)])
            act = rng.random()
            hand = rng.choice(("left", "right", "right"))
            speaks = act > 0.03
            if act < 0.55:
                bench.hands.held[hand] = not bench.hands.held[hand]
            elif act < 0.7:
                bench.hands.seen[hand] = not bench.hands.seen[hand]
            elif act < 0.73:
                bench.session.hide("a", rng.choice(("headset", "recentred")))
            elif act < 0.75:
                bench.session.stop(bench.robot(), "a")
            idle = bench.session.phase not in (Phase.STARTING, Phase.DRIVING)
            if idle and rng.random() < 0.7:
                bench.session.enable("a", bench.robot(), bench.now)
                armed = False
        for hand in bench.hands.p.values():
            hand += v * TICK
        before = bench.seq
        went = bench.tick(speaks)
        keys = bench.hands.keys()
        if bench.session.phase not in (Phase.STARTING, Phase.DRIVING):
            armed = False
        elif bench.seq > before:  # the page has said how things are
            armed = bool(keys["tracked"]) and (armed or not keys["squeeze"])
            may = armed
        may = may and armed and bool(keys["squeeze"])
        yield bench, went, {"PSM1": may and not keys["camera"], "ECM": may and bool(keys["camera"])}


def test_random_lives_move_no_arm_without_its_squeeze(full: bool) -> None:
    """An arm moves only within what an order needs on its way, after a squeeze that counts."""
    moved, lifetimes = {"PSM1": 0, "ECM": 0}, 1000 if full else 12
    for seed in range(lifetimes):
        since = {"PSM1": -1.0, "ECM": -1.0}
        for bench, went, may in lives(seed):
            for arm, allowed in may.items():
                if allowed:
                    since[arm] = bench.now
                if went[arm] > 1e-9:
                    moved[arm] += 1
                    late = bench.now - since[arm]
                    assert late <= LATEST + PERIOD + CATCHES_UP, (seed, arm, bench.now, late)
    print(f"{lifetimes} lives: cycles with motion {moved}")
    assert min(moved.values()) > 5 * lifetimes
