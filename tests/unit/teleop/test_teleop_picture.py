"""Hand and picture agree at every view angle: measured in pixels of rendered pictures.

A hand on the teleoperation core, an arm that follows it, a stereo endoscope in the simulator that
is moved while the hand holds the arm. The tip is found in the pictures by its motion and its look;
what the simulator knows of it is not asked.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.control.gate_arm import TICK, GateArm
from helpers.results.teleoperation_results import note
from helpers.teleop.hand import Hand, settings
from helpers.teleop.stage import Stage, stage_of
from surg_core.held_endoscope import HeldEndoscope, held_endoscope
from surg_sim.appearance.render import Picture
from surg_teleop.follow.teleop_types import CameraView, TeleopState
from surg_teleop.follow.teleoperation import Teleop
from surg_teleop.frames.probe_moves import REST, SIDE, STEPS, ProbeMove
from surg_teleop.frames.registration_verdict import Lens, RegistrationOutcome, judge
from surg_teleop.frames.tip_tracker import Place, find_places

Array = NDArray[np.float64]

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
CELLS = ("sim_two_arms", "sim_two_arms_panda") if FULL else ("sim_two_arms",)
VIEWS = 100 if FULL else 2  # of each cell
LEAST = 0.9
"""Share of the motion in the picture that must go the way of the hand: within 26 degrees."""


@dataclass
class Session:
    """A hand that follows its picture: the core, and beside it the pictures of what it did."""

    stage: Stage
    camera: HeldEndoscope
    arm: GateArm
    teleop: Teleop
    hand: Hand = field(default_factory=Hand)
    belief: Callable[[Array], Array] = lambda R_WV: R_WV

    @classmethod
    def on(cls, stage: Stage) -> Session:
        """At the controls, following."""
        camera = held_endoscope(stage.cell)
        assert camera is not None
        session = cls(stage, camera, GateArm(), Teleop(settings(jaw=None)))
        session.arm.R_WR = rcm_axes(stage)
        session.arm.p = session.arm.R_WR.T @ (stage.work - stage.pivot(stage.tool))
        session.tick(3)
        session.teleop.enable()
        session.tick(3)
        assert session.teleop.state is TeleopState.FOLLOWING
        return session

    def tick(self, n: int, step: Array | None = None) -> None:
        """N cycles; the hand moves by ``step`` in each [m], in the picture's axes."""
        R_WV = self.belief(self.camera.rotation(self.stage.joints(self.camera.arm)))
        for _ in range(n):
            if step is not None:
                self.hand.move(step)
            now = self.arm.tick * TICK
            sample, view = self.hand.sample(now), CameraView(R_WV, now)
            self.arm.step(self.teleop.tick(now, sample, self.arm.view(), view).commands)

    def move(self, way: Array) -> None:
        """The hand goes a way [m], the arm comes after it and rests."""
        cycles = 20 + int(np.linalg.norm(way) / (0.1 * TICK))
        self.tick(cycles, way / cycles)
        self.tick(60)

    def pictures(self) -> tuple[Picture, Picture]:
        """Of the arm where the core has led it."""
        tip = self.arm.R_WR @ self.arm.p + self.stage.pivot(self.stage.tool)
        assert self.stage.put(self.stage.tool, tip, self.arm.roll)
        return self.stage.pictures()

    def places(self, scale: float) -> dict[ProbeMove, Place]:
        """Where the tip is seen when the hand goes 5 mm of the tip's each way and back."""
        pictures = {REST: self.pictures()}
        for step in STEPS[1:]:
            self.move(step.offset() / scale)
            pictures[step] = self.pictures()
            self.move(-step.offset() / scale)
        left, right = ({step: pair[i] for step, pair in pictures.items()} for i in (0, 1))
        return find_places(left, right)


def rcm_axes(stage: Stage) -> Array:
    """R_WR of the instrument: z the home shaft axis, x the base's x made perpendicular to it."""
    arm = stage.cell.arms[stage.tool]
    z = stage.shaft(stage.tool)
    x = np.asarray(arm.X_WB)[:3, 0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@pytest.fixture(scope="module", params=CELLS)
def stage(request: pytest.FixtureRequest) -> Stage:
    return stage_of(request.param)


def lens(stage: Stage) -> Lens:
    i = stage.renderer.intrinsics
    return Lens(i.f, np.array([i.cx, i.cy]), stage.renderer.baseline)


def shares(places: dict[ProbeMove, Place]) -> list[float]:
    """How much of what is seen goes where the hand went: right, up, away; 1: all of it.

    Away is the change of the disparity: it must shrink.
    """
    right = places[ProbeMove(0, 1)].left - places[ProbeMove(0, -1)].left
    up = places[ProbeMove(1, -1)].left - places[ProbeMove(1, 1)].left
    far, near = places[ProbeMove(2, 1)].disparity, places[ProbeMove(2, -1)].disparity
    assert far is not None and near is not None
    return [
        float(right[0] / np.hypot(*right)),
        float(-up[1] / np.hypot(*up)),
        float(np.sign(near[0] - far[0])),
    ]


def test_the_tip_goes_where_the_hand_goes_in_the_picture(stage: Stage) -> None:
    """Random views, the scope moved while the hand holds the arm; any roll, any scale."""
    rng = np.random.default_rng(200)
    session = Session.on(stage)
    rolls, pixels, shrunk, angles = [], [], [], []
    stage.aim(rng)
    for view in range(VIEWS):
        before = session.arm.p
        stage.aim(rng)  # the endoscope moves while the hand rests: the tip must not
        session.tick(50)
        assert np.abs(session.arm.p - before).max() < 1e-12, "a moving scope moves no tip"
        scale = float(rng.uniform(0.1, 1.0))
        assert session.teleop.set_scale(scale) == ""
        home = session.arm.R_WR.T @ (stage.work - stage.pivot(stage.tool))
        wanted = home + rng.uniform(-0.008, 0.008, 3)
        R_RV = session.arm.R_WR.T @ session.camera.rotation(stage.joints(session.camera.arm))
        session.move(R_RV.T @ (wanted - session.arm.p) / scale)
        assert np.abs(session.arm.p - wanted).max() < 1e-6
        places = session.places(scale)
        seen = shares(places)
        what = f"view {view}, scale {scale:.2f}: right, up, away {np.round(seen, 2)}"
        assert min(seen) > LEAST, what
        verdict = judge(places, lens(stage))
        assert verdict.outcome is RegistrationOutcome.PASS, f"{what}: {verdict.text}"
        X = stage.X_WV()
        rolls.append(np.degrees(np.arctan2(X[2, 0], -X[2, 1])) % 360.0)
        pixels.append(float(places[ProbeMove(0, 1)].left[0] - places[ProbeMove(0, -1)].left[0]))
        shrunk.append(
            float(places[ProbeMove(2, -1)].disparity[0] - places[ProbeMove(2, 1)].disparity[0])
        )
        angles.append(float(np.degrees(verdict.angle)))
        assert session.teleop.state is TeleopState.FOLLOWING
    assert session.arm.refusals == []
    assert session.teleop.engagements == 1, "one engagement under all views"
    note(
        f"picture: {stage.cell.folder.name}",
        VIEWS,
        f"rolls {min(rolls):.0f} to {max(rolls):.0f} degrees: {2e3 * SIDE:.0f} mm to the right are "
        f"{min(pixels):.0f} to {max(pixels):.0f} px, 10 mm away {min(shrunk):.1f} to "
        f"{max(shrunk):.1f} px of disparity; hand to picture at most {max(angles):.1f} degrees",
    )


@pytest.mark.parametrize(
    "what", ["not at all", "twice", *(["as it was at the engagement", "inverse"] if FULL else [])]
)
def test_a_wrong_mapping_is_seen_in_the_picture(what: str, stage: Stage) -> None:
    """The measurement can fail: the camera's pose applied 0 or 2 times, or an old one."""
    rng = np.random.default_rng(201)
    stage.aim(rng)
    session = Session.on(stage)
    old = session.camera.rotation(stage.joints(session.camera.arm))
    scope = stage.shaft(stage.scope)
    tip = stage.pivot(stage.scope) + 0.06 * scope
    assert stage.put(stage.scope, tip, 2.0)  # far from the view at the engagement
    wrong: dict[str, Callable[[Array], Array]] = {
        "not at all": lambda R_WV: np.eye(3),
        "twice": lambda R_WV: R_WV @ R_WV,
        "as it was at the engagement": lambda R_WV: old,
        "inverse": lambda R_WV: R_WV.T,
    }
    session.belief = wrong[what]
    if what == "as it was at the engagement":
        now = session.camera.rotation(stage.joints(session.camera.arm))
        assert np.degrees(np.arccos((np.trace(old.T @ now) - 1.0) / 2.0)) > 25.0
    session.teleop.set_scale(1.0)
    try:
        places = session.places(1.0)
    except ValueError:  # it left the picture, or went where nothing is seen of it
        return
    assert judge(places, lens(stage)).outcome is not RegistrationOutcome.PASS
