"""Grasping: what holds, what does not, slip, loss, release, and the forces of it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from helpers.results.tissue_results import note
from helpers.sim.assistant_pose import joints_for
from helpers.sim.phantom import OPEN, SHUT, Phantom
from surg_sim.physics.scene import Site
from surg_sim.physics.tissue import TissueParameters, add_bowel
from surg_sim.physics.tissue_grasp import SLIDES, add_grasp

LIFT = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def phantom() -> Phantom:
    return Phantom()


def test_jaws_that_close_round_the_tube_hold_it(phantom: Phantom, full: bool) -> None:
    """Any drawn shape, any place within reach: held where it was aimed at, give or take one."""
    rng, count = np.random.default_rng(1), 60 if full else 6
    aside = []
    for seed in range(count):
        phantom.reset(seed)
        node = int(rng.integers(11, 25))
        phantom.take(node)
        held = phantom.grasp.held
        assert held is not None, f"seed {seed}, node {node}: nothing held"
        assert abs(held - node) <= 1
        assert np.linalg.norm(phantom.bowel.nodes[held] - phantom.grasp.place) < 5e-4
        assert phantom.grasp.slips == phantom.warnings == 0
        aside.append(held - node)
    exact = sum(i == 0 for i in aside)
    note(
        "jaws that close round the tube hold",
        count,
        f"all held: {exact} the node aimed at, {count - exact} its neighbour",
    )


def test_one_pad_alone_holds_nothing(phantom: Phantom) -> None:
    """Beside the tube one pad touches, the other closes in the air."""
    for node, side in ((18, 1.0), (18, -1.0), (14, 1.0), (22, -1.0)):
        phantom.reset(node)
        phantom.approach(node, aside=side * 0.0115, depth=0.0)
        touched = [0, 0]
        phantom.run(0, jaw=SHUT)
        for _ in range(150):
            phantom.run(1)
            for pad, nodes in enumerate(phantom.grasp.touched()):
                touched[pad] += bool(nodes)
            assert phantom.grasp.held is None
        assert min(touched) == 0 < max(touched)


def test_jaws_that_close_on_nothing_hold_nothing(phantom: Phantom) -> None:
    phantom.go(phantom.bowel.nodes[18] + [0, 0, 0.04], 0.0, OPEN)
    phantom.run(200, jaw=SHUT)
    assert phantom.grasp.held is None
    assert not phantom.data.sensordata.any()
    assert np.linalg.norm(phantom.grasp.force) == 0.0


def test_shut_jaws_that_are_pushed_into_the_tube_hold_nothing(phantom: Phantom) -> None:
    place, roll = phantom.bowel.nodes[18], phantom.across(18)
    shaft = phantom.shaft(place)
    phantom.go(place - 0.03 * shaft, roll, OPEN)
    phantom.run(150, jaw=SHUT)  # the attempt to grasp was in the air
    phantom.go(place, roll, SHUT)
    first, second = phantom.grasp.touched()
    assert first and second
    assert phantom.grasp.held is None
    assert phantom.grasp.force[2] > 0.0  # the tissue pushes back


def test_jaws_on_the_tube_but_not_round_it_hold_nothing(phantom: Phantom) -> None:
    phantom.approach(18, depth=-0.012)
    phantom.run(200, jaw=SHUT)
    assert phantom.grasp.held is None


def test_opening_releases(phantom: Phantom) -> None:
    phantom.take(18)
    assert phantom.grasp.held is not None
    phantom.run(20, jaw=0.28)  # a little is not yet open
    assert phantom.grasp.held is not None
    phantom.run(60, jaw=OPEN)
    assert phantom.grasp.held is None
    assert phantom.grasp.slips == phantom.grasp.losses == 0
    phantom.go(phantom.assistant.p_WTip + 0.04 * LIFT, jaw=OPEN)
    phantom.run(800)
    assert phantom.bowel.energy < 1e-8
    phantom.take(18)
    assert phantom.grasp.held is not None


def test_a_pull_beyond_the_slip_force_slips_and_then_loses(phantom: Phantom, full: bool) -> None:
    limit = phantom.bowel.parameters.slip_force
    count, pulls = 10 if full else 2, []
    for seed in range(count):
        phantom.reset(seed)
        roll = phantom.take(17 + seed % 3)
        start, strongest, held = phantom.assistant.p_WTip, 0.0, []
        for tick in range(1500):
            if tick % 10 == 0:
                height = 8e-5 * tick
                place = start + phantom.site.R @ [0.0, -0.3 * height, height]
                phantom.run(0, joints_for(phantom.assistant, place, roll))
            phantom.run(1)
            if phantom.grasp.held is not None:
                strongest = max(strongest, float(np.linalg.norm(phantom.grasp.pull)))
            if not held or held[-1] != phantom.grasp.held:
                held.append(phantom.grasp.held)
        print(f"seed {seed}: held {held}, strongest pull {strongest:.2f} N of {limit} N")
        slides = [i for i in held if i is not None]
        assert held[-1] is None and None not in held[:-1]
        assert len(slides) == 1 + SLIDES
        assert np.abs(np.diff(slides)).max() == 1
        assert phantom.grasp.slips == len(slides)
        assert phantom.grasp.losses == 1
        assert limit < strongest < 1.6 * limit
        assert phantom.warnings == 0
        pulls.append(strongest)
    note(
        "slow pulls: slip, slip, loss",
        count,
        f"all; slip force {limit} N, strongest pull {min(pulls):.1f} to {max(pulls):.1f} N",
    )


def test_a_pull_below_the_slip_force_holds(phantom: Phantom) -> None:
    phantom.take(18)
    phantom.go(phantom.assistant.p_WTip + 0.035 * LIFT, ticks=1000)
    strength = np.linalg.norm(phantom.grasp.pull)
    print(f"{strength:.2f} N")
    assert 0.5 < strength < phantom.bowel.parameters.slip_force
    assert phantom.grasp.held is not None
    assert phantom.grasp.slips == 0


@pytest.mark.parametrize("way", [-1, 1])
def test_tissue_slides_towards_its_tight_side(phantom: Phantom, way: int) -> None:
    """Jaws that are pulled along the tube come nearer to the end towards which they are pulled."""
    phantom.take(18)
    nodes, roll = phantom.bowel.nodes, phantom.across(18)
    along = way * (nodes[22] - nodes[14])
    along = along / np.linalg.norm(along) + 0.2 * LIFT
    held = [phantom.grasp.held]
    for _ in range(40):
        phantom.go(phantom.assistant.p_WTip + 0.004 * along, roll, ticks=20)
        if phantom.grasp.held != held[-1]:
            held.append(phantom.grasp.held)
    print(f"pulled towards node {0 if way < 0 else 35}: held {held}")
    assert held[-1] is None
    assert all(isinstance(i, int) for i in held[:-1])
    assert np.diff(np.array(held[:-1], dtype=int)).tolist() == [way, way]


def test_a_jerk_takes_the_tissue_out_at_once(phantom: Phantom) -> None:
    phantom.take(18)
    held = phantom.grasp.held
    assert held is not None
    phantom.data.xfrc_applied[phantom.model.body(f"bowel_{held}").id, 2] = -40.0
    phantom.run(40)
    assert phantom.grasp.held is None
    assert phantom.grasp.losses == 1
    assert phantom.grasp.slips <= SLIDES  # no time to slide as far as a slow pull


def test_the_force_on_the_jaws_is_what_statics_demands(phantom: Phantom) -> None:
    """At rest, what all jaws carry is what mesentery and anchors pull at the bowel."""
    phantom.take(18)
    phantom.model.geom_contype[phantom.model.geom("bowel_floor").id] = 0
    errors = []
    for height in (0.02, 0.015, 0.015):
        phantom.go(phantom.assistant.p_WTip + height * LIFT, ticks=1300)
        expected = phantom.bowel.pulls.sum(axis=0)
        # On its way up the tube brushes against the robot's jaws: both tools' forces count.
        felt = phantom.grasp.force + phantom.robot_grasp.force
        errors.append(float(np.linalg.norm(felt - expected)))
        assert errors[-1] < 1e-6
        assert phantom.grasp.force[2] < 0.0
    strength = float(np.linalg.norm(phantom.grasp.force))
    note(
        "force on the jaws against statics",
        len(errors),
        f"within {max(max(errors), 1e-9):.0e} N at up to {strength:.1f} N",
    )


def test_pressing_on_the_tube_is_felt(phantom: Phantom) -> None:
    """Contact alone, above the floor: the same statics."""
    place, roll = phantom.bowel.nodes[18], phantom.across(18)
    shaft = phantom.shaft(place)
    phantom.go(place - 0.03 * shaft, roll, SHUT)
    phantom.go(place - 0.0080 * shaft, roll, ticks=1500)
    expected = phantom.bowel.pulls.sum(axis=0)
    assert expected[2] > 1e-4
    assert np.linalg.norm(phantom.grasp.force - expected) < 0.05 * np.linalg.norm(expected)
    assert phantom.grasp.pull.tolist() == [0.0, 0.0, 0.0]


def test_two_tools_never_hold_the_same_place(phantom: Phantom) -> None:
    phantom.take(18)
    held = phantom.grasp.held
    assert held is not None
    phantom.run(80, jaw=OPEN)
    other = 1 << 12
    for node in range(14, 23):
        phantom.bowel.hold(node, other)
    phantom.go(phantom.assistant.p_WTip + 0.03 * LIFT, jaw=OPEN)
    phantom.run(800)
    phantom.take(18)
    assert phantom.grasp.held is None
    for node in range(14, 23):
        assert not phantom.bowel.free(node)
        phantom.bowel.release(node)
    phantom.go(phantom.assistant.p_WTip + 0.03 * LIFT, jaw=OPEN)
    phantom.run(800)
    phantom.take(18)
    assert phantom.grasp.held == held


def test_held_tissue_does_not_slide_onto_another_tools_place(phantom: Phantom) -> None:
    phantom.take(18)
    held = phantom.grasp.held
    assert held is not None
    for node in (held - 1, held + 1):
        phantom.bowel.hold(node, 1 << 12)
    roll = phantom.across(held)
    for _ in range(12):
        phantom.go(phantom.assistant.p_WTip + 0.008 * LIFT, roll, ticks=60)
    assert phantom.grasp.held is None
    assert (phantom.grasp.slips, phantom.grasp.losses) == (1, 1)


def test_a_tool_without_jaws_is_refused() -> None:
    spec = mujoco.MjSpec()
    trocar, base = np.array([0.06, 0, 0.1]), np.array([-0.45, 0, 0])
    site = Site(np.zeros(3), trocar, base, np.eye(3), trocar[None], base[None])
    add_bowel(spec, site, TissueParameters())
    spec.worldbody.add_body(name="scope_tip")
    with pytest.raises(ValueError, match="'scope' has no joint 'jaw'"):
        add_grasp(spec, "scope")
