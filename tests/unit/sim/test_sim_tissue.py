"""The bowel: rest, energy, hard pulls, tension, symmetry, breathing, determinism."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from helpers.results.tissue_results import note
from helpers.sim.phantom import Phantom, arm_of
from surg_sim.physics import scene
from surg_sim.physics.patient_settings import SETTINGS
from surg_sim.physics.sim_arm import ArmCommand, ArmLink
from surg_sim.physics.tissue import TissueParameters, add_bowel, rest_shape
from surg_sim.physics.trocar_motion import Sinusoid

LIFT = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def phantom() -> Phantom:
    return Phantom()


def pull(phantom: Phantom, node: int, force: np.ndarray) -> None:
    """Pull at a node [N] from now on."""
    phantom.data.xfrc_applied[phantom.model.body(f"bowel_{node}").id, :3] = force


def saved(model: mujoco.MjModel) -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def test_every_drawn_shape_is_at_rest_and_evenly_spaced(phantom: Phantom, full: bool) -> None:
    spacing, worst, places = phantom.bowel.parameters.spacing, 0.0, []
    count = 200 if full else 20
    for seed in range(count):
        phantom.reset(seed)
        steps = np.linalg.norm(np.diff(phantom.bowel.nodes, axis=0), axis=1)
        assert np.abs(steps[4:-4] / spacing - 1).max() < 0.05
        phantom.run(50)
        worst = max(worst, float(np.abs(phantom.bowel.velocities).max()))
        assert np.abs(phantom.bowel.tensions).max() < 1e-9
        places.append(phantom.bowel.nodes[18])
    spread = np.ptp(places, axis=0) * 1e3
    x, y, _ = spread
    note(
        "a drawn shape is at rest",
        count,
        f"below {max(worst, 1e-12):.0e} m/s; node 18 lies within {x:.0f} x {y:.0f} mm",
    )
    assert worst < 1e-9
    assert spread[:2].min() > 10


def test_an_episode_needs_no_compilation(phantom: Phantom) -> None:
    """A new shape, and a hold, change only springs' references and what meets what."""
    plain = saved(phantom.model)
    phantom.reset(3)
    phantom.bowel.hold(7, 1 << 9)
    assert saved(phantom.model) != plain
    phantom.bowel.release(7)
    fresh = Phantom()
    for name in ("qpos_spring", "tendon_lengthspring"):
        getattr(phantom.model, name)[:] = getattr(fresh.model, name)
    assert saved(phantom.model) == saved(fresh.model)


def test_energy_only_decays_when_nobody_pulls(phantom: Phantom, full: bool) -> None:
    count = 20 if full else 3
    left = []
    for seed in range(count):
        phantom.reset(seed)
        rng = np.random.default_rng(seed)
        start = int(phantom.model.joint("bowel_0_x").dofadr[0])
        phantom.data.qvel[start : start + 108] = rng.normal(0, 0.3, 108)
        energies = [phantom.bowel.energy]
        for _ in range(100):
            phantom.run(5)
            energies.append(phantom.bowel.energy)
        ratio = np.array(energies[1:]) / np.array(energies[:-1])
        assert ratio.max() < 1.0, f"seed {seed}: energy grows by {ratio.max():.4f}"
        left.append(energies[-1] / energies[0])
        assert left[-1] < 1e-3
    note(
        "a kick dies out in 1 s",
        count,
        f"energy falls every 10 ms, to {max(left):.0e} of what it was at most",
    )


def test_hard_pulls_break_nothing(phantom: Phantom, full: bool) -> None:
    """Random pulls of up to a hundred newton, ten times what any instrument gives."""
    count, furthest = (30 if full else 2), 0.0
    for seed in range(count):
        phantom.reset(seed)
        rng, start = np.random.default_rng(seed), phantom.bowel.nodes
        for _ in range(20):
            phantom.data.xfrc_applied[:] = 0.0
            for node in rng.integers(0, 36, 3):
                pull(phantom, int(node), rng.uniform(0, 100) * _unit(rng))
            phantom.run(15)
            moved = np.linalg.norm(phantom.bowel.nodes - start, axis=1)
            furthest = max(furthest, float(moved.max()))
        assert phantom.warnings == 0
        assert np.isfinite(phantom.data.qpos).all()
        phantom.data.xfrc_applied[:] = 0.0
        phantom.run(1500)
        # Back at rest; a fold in itself may keep a little energy, for nothing stops one.
        assert phantom.bowel.energy < 1e-3
    note(
        "pulls of up to 100 N at three nodes",
        20 * count,
        f"no NaN, no warning; furthest node {furthest:.2f} m away",
    )


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def test_the_tension_grows_with_the_pull(phantom: Phantom) -> None:
    heights, tensions = [], []
    for force in (0.25, 0.5, 1.0, 2.0, 3.0, 4.0):
        pull(phantom, 18, force * LIFT)
        phantom.run(700)
        heights.append(phantom.bowel.nodes[18, 2])
        tensions.append([phantom.bowel.tensions[17], phantom.bowel.tensions[18]])
    print("N:", np.round(tensions, 2).tolist())
    assert (np.diff(heights) > 0).all()
    assert (np.diff(tensions, axis=0) > 0).all()


def test_the_tension_is_what_statics_demands(phantom: Phantom) -> None:
    """At rest the springs across a cut carry what pulls at the piece before it."""
    bowel = phantom.bowel
    force = np.array([0.0, -1.0, 2.0])
    pull(phantom, 18, force)
    phantom.run(1500)
    total = bowel.pulls.sum(axis=0) + force
    assert np.abs(total).max() < 1e-6
    checked, worst = 0, 0.0
    for cut in range(35):
        before = bowel.pulls[: cut + 1].sum(axis=0)
        if cut >= 18:
            before = before + force
        carried = np.linalg.norm(before)
        nodes = bowel.nodes[max(cut - 3, 0) : cut + 5]
        straight = np.linalg.norm(nodes[-1] - nodes[0])
        bent = np.linalg.norm(np.diff(nodes, axis=0), axis=1).sum() / straight - 1
        if bent < 0.005 and carried > 0.3:
            checked += 1
            worst = max(worst, abs(bowel.tensions[cut] / carried - 1))
            assert worst < 0.05
    note(
        "tension along the tube against statics",
        checked,
        f"within {100 * worst:.1f} % at straight pieces",
    )
    assert checked >= 8


def test_stretch_stiffness_is_the_parameter() -> None:
    """Force per strain of the springs side by side, from their definition."""
    for name, setting in SETTINGS.items():
        p = setting.tissue
        k = p.springs
        assert p.spacing * (k[0] + 4 * k[1] + 16 * k[2]) == pytest.approx(p.stretch), name


def test_mirrored_pulls_give_mirrored_shapes(full: bool) -> None:
    rng, count, worst = np.random.default_rng(4), 10 if full else 3, 0.0
    for _ in range(count):
        node, force = int(rng.integers(6, 18)), rng.uniform([-1, -1, -0.3], [1, 1, 2])
        left, right = Phantom(), Phantom()
        R = left.site.R
        for phantom in (left, right):  # the instruments are not mirrored: they keep out
            pads = [i for i in range(phantom.model.ngeom) if "pad" in phantom.model.geom(i).name]
            phantom.model.geom_contype[pads] = 0
        pull(left, node, R @ force)
        pull(right, 35 - node, R @ (force * [-1, 1, 1]))
        left.run(200)
        right.run(200)
        a = (left.bowel.nodes - left.site.work) @ R
        b = (right.bowel.nodes - right.site.work) @ R
        assert np.abs(a - b[::-1] * [-1, 1, 1]).max() < 1e-9
        worst = max(worst, float(np.abs(a - b[::-1] * [-1, 1, 1]).max()))
        assert np.abs(left.bowel.tensions - right.bowel.tensions[::-1]).max() < 1e-6
    note("mirrored pulls", count, f"mirrored shapes within {max(worst, 1e-15):.0e} m")


def test_the_floor_carries_what_is_pressed_down(phantom: Phantom) -> None:
    pull(phantom, 18, np.array([0.0, 0.0, -0.2]))
    before = phantom.bowel.nodes[18, 2]
    phantom.run(500)
    free = Phantom()
    free.model.geom_contype[free.model.geom("bowel_floor").id] = 0
    pull(free, 18, np.array([0.0, 0.0, -0.2]))
    free.run(500)
    sinks = 1e3 * (before - phantom.bowel.nodes[18, 2]), 1e3 * (before - free.bowel.nodes[18, 2])
    print(f"0.2 N presses {sinks[0]:.1f} mm with, {sinks[1]:.1f} mm without the floor")
    assert sinks[0] < 6.0 < sinks[1]


def test_breathing_carries_the_bowel(phantom: Phantom) -> None:
    motion = SETTINGS["in_vivo"].breathing.bed()
    assert isinstance(motion, Sinusoid)
    phantom.bowel.bed.move(motion)
    start, heights, worst = phantom.bowel.nodes, [], 0.0
    for _ in range(100):
        phantom.run(20)
        moved = phantom.bowel.nodes - start
        heights.append(float(moved[:, 2].mean()))
        if len(heights) > 20:  # it begins with a jerk
            worst = max(worst, float(np.abs(moved - phantom.bowel.bed.p_B).max()))
    low, high = min(heights) * 1e3, max(heights) * 1e3
    note("the bed breathes", 36, f"{low:.2f} to {high:.2f} mm, nodes off by {worst * 1e6:.0f} µm")
    assert max(heights) == pytest.approx(motion.amplitude, rel=0.02)
    assert min(heights) == pytest.approx(-motion.amplitude, rel=0.02)
    assert worst < 0.02 * motion.amplitude
    assert phantom.bowel.tensions.max() < 0.05
    phantom.reset()
    phantom.run(20)
    assert np.abs(phantom.bowel.nodes - start).max() < 1e-12


def test_one_seed_one_motion() -> None:
    def run(seed: int) -> str:
        phantom = Phantom()
        phantom.reset(seed)
        phantom.take(18)
        return phantom.hash

    first = run(5)
    again = Phantom()
    again.reset(9)
    again.take(17)  # what happened before a reset leaves nothing behind
    again.reset(5)
    again.take(18)
    assert first == run(5) == again.hash
    assert first != run(6)


def test_the_robot_does_not_feel_a_bowel_that_it_does_not_touch() -> None:
    """Pads and tissue change neither the arm's masses nor its motion."""
    arm, parameters = arm_of("sim_ur5e"), TissueParameters()
    q = []
    for add in (None, lambda spec, site: add_bowel(spec, site, parameters)):
        model = scene.build([arm], add=add)
        data = mujoco.MjData(model)
        link = ArmLink(model, data, arm)
        mujoco.mj_step1(model, data)
        for tick in range(300):
            link.accept(ArmCommand(velocity=0.2 * np.sin(0.02 * tick + np.arange(6))))
            for _ in range(2):
                link.substep()
                mujoco.mj_step(model, data)
        q.append(link.q)
    print(f"difference {np.abs(q[0] - q[1]).max():.1e} rad")
    assert np.abs(q[0] - q[1]).max() < 1e-9
    phantom = Phantom()
    mass = phantom.model.body_mass[phantom.model.body("PSM1_jaw_upper").id]
    assert mass == scene.build([arm]).body("PSM1_jaw_upper").mass[0]


def test_the_plain_shape_fits_every_setting() -> None:
    site = scene.site_of([arm_of("sim_ur5e")])
    for setting in SETTINGS.values():
        nodes = rest_shape(site, setting.tissue)
        assert nodes.shape == (setting.tissue.nodes, 3)
        middle = site.local(nodes.mean(axis=0))
        assert np.abs(middle[:2]).max() < 0.05
