"""The cells with two arms: where they stand, what moves, what the stereo endoscope sees."""

from __future__ import annotations

import math
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

import surg_core
from helpers.control import dh
from helpers.sim.render_speed import stereo_speed
from surg_cli.host import paths
from surg_core import Motion, MotionCommand, StateCommand
from surg_description.make_cell import home_pose
from surg_sim.appearance import patient
from surg_sim.appearance.drawing import OUTSIDE
from surg_sim.appearance.opengl import NoOpenGL
from surg_sim.appearance.render import Renderer, show_only
from surg_sim.physics import endoscope_rig, scene
from surg_sim.physics.sim_arm import ArmCommand
from surg_sim.physics.trocar import wall_frame
from surg_sim.physics.world import World
from surg_sim.placement import arm_reserve, base_placement, placement_search
from surg_sim.placement.arm_clearance import ClearanceModel
from surg_sim.placement.arm_reserve import reserve
from surg_sim.placement.base_placement import ArmFiles
from surg_sim.placement.placement_search import Placement

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
CELLS = ("sim_two_arms", "sim_two_arms_panda")
ONE_CELL = [CELLS[0], pytest.param(CELLS[1], marks=pytest.mark.full)]
"""What depends on the endoscope alone, which is the same in both."""
EYES = [endoscope_rig.LEFT, endoscope_rig.RIGHT]
DESCRIPTION = paths.ROOT / "src/surg_description"
TASKS = {"PSM1": arm_reserve.INSTRUMENT, "ECM": arm_reserve.ENDOSCOPE}


@pytest.fixture(scope="module", params=CELLS)
def cell(request: pytest.FixtureRequest) -> surg_core.Cell:
    return surg_core.load_cell(paths.ROOT / "cells" / request.param)


@pytest.fixture(scope="module")
def seen(cell: surg_core.Cell) -> World:
    """The cell with looks, at home; nobody moves it."""
    return World(cell, visuals=True)


def stereo(model: mujoco.MjModel, **keys: object) -> Renderer:
    try:
        return Renderer(model, EYES, 640, 480, hidden=[OUTSIDE], **keys)
    except NoOpenGL as error:
        pytest.skip(str(error))


# --- cells ------------------------------------------------------------------------------------


def test_a_cell_of_two_arms_is_read_in_its_order(cell: surg_core.Cell) -> None:
    assert list(cell.arms) == ["PSM1", "ECM"]
    grasper, scope = (arm.instrument for arm in cell.arms.values())
    assert grasper.camera is None
    assert grasper.jaw_velocity > 0
    assert scope.jaw_min == scope.jaw_max == scope.jaw_velocity == 0.0
    assert scope.camera is not None
    assert scope.camera.frames == ("camera_left", "camera_right")
    assert scope.camera.baseline == 0.004
    assert math.degrees(scope.camera.fovy) == pytest.approx(56.0, abs=1e-4)
    for name, arm in cell.arms.items():
        X_BF = np.asarray(arm.chain.forward(arm.robot.home))
        shaft = surg_core.shaft_state(X_BF, arm.tool.s_F, arm.tool.p_FTip, arm.trocar.p_BRcm)
        assert np.linalg.norm(shaft.e) < 1e-9
        assert abs(shaft.depth - TASKS[name].depth) < 1e-9
        pose = home_pose(
            Path(arm.robot.file), Path(arm.instrument.file), TASKS[name].depth, arm.robot.home
        )
        assert np.abs(pose.p_BRcm - arm.trocar.p_BRcm).max() < 1e-11


def test_both_arms_in_the_scene_are_where_the_dh_formula_says(cell: surg_core.Cell) -> None:
    world = World(cell)
    rng = np.random.default_rng(3)
    worst, n = 0.0, 0
    for _ in range(200):
        for arm in cell.arms.values():
            q = rng.uniform(arm.robot.position_min, arm.robot.position_max)
            for name, angle in zip(arm.robot.joint_names, q, strict=True):
                world.data.qpos[world.model.joint(f"{arm.name}_robot_{name}").qposadr[0]] = angle
            mujoco.mj_kinematics(world.model, world.data)
            body = world.model.body(f"{arm.name}_robot_{arm.robot.flange_link}").id
            wanted = arm.X_WB @ (dh.ur5e(q) if arm.robot.name == "ur5e" else dh.panda(q))
            worst = max(worst, float(np.abs(world.data.xpos[body] - wanted[:3, 3]).max()))
            R = world.data.xmat[body].reshape(3, 3)
            worst = max(worst, float(np.abs(R - wanted[:3, :3]).max()))
            n += 1
    print(f"{n} postures of both arms: {worst:.1e}")
    assert worst < 1e-8


def test_at_home_nothing_moves_or_touches(cell: surg_core.Cell) -> None:
    world = World(cell)
    for _ in range(500):
        world.step({})
    for arm in world.arms:
        assert world.truth(arm).deviation < 1e-9
        assert np.abs(world.state(arm).qd).max() < 1e-9
        assert np.linalg.norm(world.truth(arm).trocar_force) < 1e-6
    assert world.data.ncon == 0


def placements(cell: surg_core.Cell) -> list[Placement]:
    """The cell's arms as the search would have placed them."""
    site = scene.site_of(list(cell.arms.values()))
    X_WP = surg_core.make_pose(site.work, site.R)
    found = []
    for name, arm in cell.arms.items():
        X = np.linalg.inv(X_WP) @ arm.X_WB
        q = np.asarray(arm.robot.home)
        left = reserve(arm, q, TASKS[name])
        assert left is not None, f"{name}: a corner of its box is out of reach"
        found.append(Placement(X[:3, 3], float(np.arctan2(X[1, 0], X[0, 0])), q, left))
    return found


def test_the_places_are_as_a_surgeon_would_have_them(cell: surg_core.Cell) -> None:
    arms = list(cell.arms.values())
    site = scene.site_of(arms)
    (_, s_1), (_, s_2) = (wall_frame(arm) for arm in arms)
    angle = math.degrees(math.acos(float(s_1 @ s_2)))
    assert 45.0 <= angle <= 90.0
    X_WC = arms[1].X_WB @ np.asarray(arms[1].chain.forward(arms[1].robot.home))
    X_WC = X_WC @ endoscope_rig.camera_poses(arms[1])[0]
    to_work = site.work - X_WC[:3, 3]
    assert np.linalg.norm(to_work) == pytest.approx(0.100, abs=0.0005)
    assert abs(X_WC[2, 0]) < 1e-3, "the picture is upright"
    assert (X_WC[:3, :3].T @ to_work)[2] > 0.0999
    first, second = placements(cell)
    for stand in (first, second):
        table_edge = 0.32
        assert abs(stand.base[0]) > table_edge + 0.05 or abs(stand.base[1]) > 1.05
        assert stand.reserve.margin > 0.5
        assert stand.reserve.speed < 0.95
    model = ClearanceModel(arms, [first.X_PB, second.X_PB])
    home = model.clearance(first.q, second.q)
    corners = [(q, second.q) for q in first.reserve.postures]
    corners += [(first.q, q) for q in second.reserve.postures]
    nearest = min(model.clearance(*pair) for pair in corners)
    print(f"{angle:.0f} degrees; {1000 * home:.0f} mm at home, {1000 * nearest:.0f} mm in corners")
    assert home >= placement_search.CLEARANCE
    assert nearest >= placement_search.CORNER_CLEARANCE


def test_the_wall_goes_through_both_ports(cell: surg_core.Cell) -> None:
    site = scene.site_of(list(cell.arms.values()))
    for port in site.ports:
        x, y, z = site.local(port)
        assert abs(patient.wall_height(site, x, y) - z) < 0.002


@pytest.mark.skipif(not FULL, reason="half a minute: SURG_TEST_FULL=1 runs it")
@pytest.mark.parametrize(
    "robots", [("ur5e", "ur5e"), ("panda", "ur5e"), ("ur5e", "panda"), ("panda", "panda")]
)
def test_the_search_places_any_two_robots(robots: tuple[str, str], tmp_path: Path) -> None:
    names = {("ur5e", "ur5e"): "sim_two_arms", ("panda", "ur5e"): "sim_two_arms_panda"}
    out = tmp_path / names.get(robots, "cell")
    files = [
        ArmFiles(DESCRIPTION / f"robots/{robot}.yaml", DESCRIPTION / f"instruments/{tool}.yaml")
        for robot, tool in zip(robots, ("grasper", "endoscope"), strict=True)
    ]
    print(base_placement.make_two_arm_cell(out, *files))
    World(surg_core.load_cell(out))  # refuses what does not fit
    if robots in names:
        pattern = r"(robot|instrument): .*"
        fresh, bundled = (
            re.sub(pattern, "", (folder / "cell.yaml").read_text())
            for folder in (out, paths.ROOT / "cells" / names[robots])
        )
        assert fresh == bundled


def test_out_of_reach_is_seen_by_the_search() -> None:
    arm = surg_core.load_cell(paths.ROOT / "cells/sim_ur5e").arms["PSM1"]
    X = np.asarray(arm.chain.forward(arm.robot.home)).copy()
    q = arm_reserve.inverse(arm.chain, np.asarray(arm.robot.home) + 0.3, X)
    assert q is not None
    assert np.abs(np.asarray(arm.chain.forward(q)) - X).max() < 1e-8
    X[0, 3] += 1.0
    assert arm_reserve.inverse(arm.chain, np.asarray(arm.robot.home), X) is None


# --- under control ----------------------------------------------------------------------------


def test_both_arms_keep_their_pivots_and_an_arm_without_a_jaw_has_none(
    cell: surg_core.Cell,
) -> None:
    world = World(cell)
    controllers, start, worst = {}, {}, dict.fromkeys(cell.arms, 0.0)
    for name, arm in cell.arms.items():
        controller = surg_core.Controller(
            arm.chain, arm.robot, arm.limits, arm.instrument, arm.tool
        )
        assert controller.set_rcm(arm.trocar.p_BRcm) == surg_core.Reason.NONE
        state = world.state(name)
        controller.step(state.q, state.qd, jaw=state.jaw)
        for word in (StateCommand.ENABLE, StateCommand.HOME):
            assert controller.request(word) == surg_core.Reason.NONE
        start[name] = controller.step(state.q, state.qd, jaw=state.jaw).virtual_q[2]
        controllers[name] = controller
    moved = dict.fromkeys(cell.arms, 0.0)
    for k in range(1500):
        t, commands = 0.002 * k, {}
        for name, controller in controllers.items():
            side, along = (0.03, 0.02) if name == "PSM1" else (0.012, 0.015)
            grow = min(t, 1.0)
            p = np.array(
                [
                    side * grow * math.sin(1.2 * t),
                    side * grow * math.sin(0.9 * t),
                    start[name] + along * grow * math.sin(0.6 * t),
                ]
            )
            state = world.state(name)
            asked = [
                MotionCommand(Motion.SERVO_CP, 1, p=p, rotation=[0.0, 0.0, 0.0, 1.0]),
                MotionCommand(Motion.JAW_SERVO_JP, 1, jaw=0.5),
            ]
            out = controller.step(state.q, state.qd, asked, jaw=state.jaw)
            assert out.refused == 0, surg_core.sentence(out.verdicts[0].reason)
            commands[name] = ArmCommand(velocity=out.qd_command, jaw=out.jaw_set)
            worst[name] = max(worst[name], world.truth(name).deviation)
            moved[name] = max(moved[name], float(np.linalg.norm(out.virtual_q[:2])))
        world.step(commands)
    print({name: f"{1e3 * value:.3f} mm" for name, value in worst.items()})
    assert max(worst.values()) < 1e-4
    assert min(moved.values()) > 0.15
    assert world.state("PSM1").jaw == pytest.approx(0.5)
    assert world.state("ECM").jaw == 0.0


# --- what is refused --------------------------------------------------------------------------


def copied(tmp_path: Path, edit: Callable[[dict[str, object]], None] | None = None) -> Path:
    """The UR5e cell beside a copy of the description, changed."""
    bundled = paths.ROOT / "cells/sim_two_arms"
    folder = tmp_path / "cell"
    shutil.copytree(bundled, folder)
    shutil.copytree(DESCRIPTION / "instruments", tmp_path / "instruments")
    shutil.copytree(DESCRIPTION / "urdf", tmp_path / "urdf")
    content = yaml.safe_load((folder / "cell.yaml").read_text())
    for arm in content["arms"].values():
        arm["robot"] = str((bundled / arm["robot"]).resolve())
        arm["instrument"] = f"../instruments/{Path(arm['instrument']).name}"
    if edit is not None:
        edit(content["arms"]["ECM"])
    (folder / "cell.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder


def test_a_trocar_off_the_shaft_or_too_deep_is_refused(tmp_path: Path) -> None:
    folder = copied(tmp_path)
    file = folder / "calibration/trocar_ECM.yaml"
    text = file.read_text()
    point = np.array(yaml.safe_load(text)["point"])
    arm = surg_core.load_cell(folder).arms["ECM"]
    R = np.asarray(arm.chain.forward(arm.robot.home))[:3, :3]
    for shift, words in (
        (0.03 * R[:, 0], "the shaft passes 30.0 mm beside it; allowed are 10 mm"),
        (-0.15 * R[:, 2], "the tip is 210 mm behind it; allowed are 20 to 160 mm"),
    ):
        shifted = (point + shift).tolist()
        file.write_text(re.sub(r"point: .*", f"point: {shifted}", text))
        with pytest.raises(ValueError, match=re.escape(words)) as caught:
            World(surg_core.load_cell(folder))
        assert "arm ECM" in str(caught.value)
        assert "trocar_ECM.yaml" in str(caught.value)


def test_arms_at_two_patients_or_a_scope_that_looks_away_are_refused(tmp_path: Path) -> None:
    def elsewhere(ecm: dict[str, object]) -> None:
        ecm["base"] = {"xyz": [-0.1, -3.0, 0.1], "rpy": [0.0, 0.0, 0.879]}

    with pytest.raises(ValueError, match=r"PSM1 and ECM are 2\.\d+ m apart; allowed are 0\.35 m"):
        World(surg_core.load_cell(copied(tmp_path / "a", elsewhere)))

    def beside(ecm: dict[str, object]) -> None:
        ecm["base"] = {"xyz": [-0.106, -0.508, 0.1], "rpy": [0.0, 0.0, 0.879]}

    with pytest.raises(ValueError, match="does not see where PSM1 works"):
        World(surg_core.load_cell(copied(tmp_path / "b", beside)))


@pytest.mark.parametrize(
    ("home", "words"),
    [
        ([0.0, 0.0], "arms.ECM.home: has 2 values; ur5e has 6 joints"),
        ([0.0, 0.0, 3.5, 0.0, 0.0, 0.0], "elbow_joint: 3.5 rad is outside its limits"),
        ([float("nan")] * 6, "is outside its limits"),
        ("up", "is not a list of numbers"),
    ],
)
def test_a_home_that_does_not_fit_the_robot_is_refused(
    home: object, words: str, tmp_path: Path
) -> None:
    folder = copied(tmp_path, lambda ecm: ecm.update(home=home))
    with pytest.raises(surg_core.ConfigError, match=re.escape(words)):
        surg_core.load_cell(folder)


def test_a_home_of_the_cell_is_the_arms_home(tmp_path: Path) -> None:
    folder = copied(tmp_path, lambda ecm: ecm.pop("home") and None)
    robot = surg_core.load_robot(DESCRIPTION / "robots/ur5e.yaml")
    assert np.array_equal(surg_core.load_cell(folder).arms["ECM"].robot.home, robot.home)
    stated = yaml.safe_load((paths.ROOT / "cells/sim_two_arms/cell.yaml").read_text())
    cell = surg_core.load_cell(paths.ROOT / "cells/sim_two_arms")
    assert list(cell.arms["ECM"].robot.home) == stated["arms"]["ECM"]["home"]


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (("frames: [camera_left, camera_right]", "frames: []"), "[] is not a list of texts"),
        (("frames: [camera_left, camera_right]", "frames: [a, b, c]"), "3 links; allowed are one"),
        (("frames: [camera_left, camera_right]", "frames: [a, a]"), "names 'a' twice"),
        (("fovy: 0.977384", "fovy: 56"), "56 rad is out of range"),
        (("baseline: 0.004", "baseline: 0"), "0 m is out of range"),
        (("  baseline: 0.004", "  base: 0.004"), "camera.baseline: is missing"),
        (("camera:", "jaw:\n  min: 0.1\ncamera:"), "jaw.max: is missing"),
        (("tip_link: tip", "tip_link: tip\nlens: 1"), "lens: is not a known key"),
    ],
)
def test_a_broken_endoscope_is_refused(edit: tuple[str, str], words: str, tmp_path: Path) -> None:
    folder = copied(tmp_path)
    file = tmp_path / "instruments/endoscope.yaml"
    assert edit[0] in file.read_text()
    file.write_text(file.read_text().replace(*edit))
    with pytest.raises(surg_core.ConfigError, match=re.escape(words)) as caught:
        surg_core.load_cell(folder)
    assert "endoscope.yaml" in str(caught.value)


@pytest.mark.parametrize(
    "edit", [('xyz="0.002 0 0"', 'xyz="0.003 0 0"'), ('xyz="0.002 0 0"', 'xyz="0 0.002 0"')]
)
def test_cameras_that_do_not_fit_their_baseline_are_refused(
    edit: tuple[str, str], tmp_path: Path
) -> None:
    folder = copied(tmp_path)
    file = tmp_path / "urdf/endoscope.urdf"
    assert edit[0] in file.read_text()
    file.write_text(file.read_text().replace(*edit))
    with pytest.raises(ValueError, match=r"camera\.baseline: 0\.004 m, but the right frame"):
        World(surg_core.load_cell(folder))


# --- what it sees -----------------------------------------------------------------------------


def test_the_instrument_is_in_both_views(cell: surg_core.Cell, seen: World) -> None:
    world = seen
    show_only(world.model, lamps=False)
    renderer = stereo(world.model)
    left, right = renderer.render(np.array(world.data.qpos))
    X_WC = renderer.camera_pose()
    X_WB = cell.arms["PSM1"].X_WB
    tip = X_WB[:3, :3] @ world.truth("PSM1").tip + X_WB[:3, 3]
    pixel = renderer.intrinsics.project(X_WC[:3, :3].T @ (tip - X_WC[:3, 3]))
    # 10 mm towards the shaft: there is metal, and metal is grey among red.
    _, s = wall_frame(cell.arms["PSM1"])
    metal = renderer.intrinsics.project(X_WC[:3, :3].T @ (tip - 0.010 * s - X_WC[:3, 3]))
    shift = renderer.intrinsics.f * 0.004 / 0.100
    for picture, x in ((left, metal[0]), (right, metal[0] - shift)):
        patch = picture[round(metal[1]) - 2 : round(metal[1]) + 3, round(x) - 2 : round(x) + 3]
        mean = patch.reshape(-1, 3).mean(axis=0)
        assert np.ptp(mean) < 25, f"grey is expected, not {mean}"
    assert np.abs(pixel - [319.5, 239.5]).max() < 3 + shift
    assert min(left.std(), right.std()) > 20
    renderer.close()


def test_skins_are_drawn_once_per_pair(seen: World) -> None:
    class Counter:
        drawn = 0

        def draw(self, scene_: mujoco.MjvScene, data: mujoco.MjData) -> None:
            assert scene_.ngeom > 10, "after the scene is laid out"
            assert np.array_equal(data.qpos, home)
            self.drawn += 1

    counter = Counter()
    home = np.array(seen.data.qpos)
    renderer = stereo(seen.model, skins=[counter])
    renderer.render(home)
    assert counter.drawn == 1
    renderer.render(home)
    assert counter.drawn == 2
    renderer.close()


def test_a_pair_needs_two_cameras() -> None:
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><camera name="{endoscope_rig.LEFT}"/></worldbody></mujoco>'
    )
    with pytest.raises(ValueError, match="no camera 'endoscope_right'; a pair needs a cell with"):
        Renderer(model, EYES, 640, 480)


@pytest.mark.parametrize("cell", ONE_CELL, indirect=True)
def test_stereo_is_fast_enough_for_two_cores(seen: World) -> None:
    """Processor time, as wall-clock time says little here: 0.2 s are 10 pairs/s on 2 cores."""
    try:
        speed = stereo_speed(seen, pairs=60 if FULL else 12)
    except NoOpenGL as error:
        pytest.skip(str(error))
    print(f"{speed.pairs_per_s:.1f} pairs/s, {1e3 * speed.cpu_s_per_pair:.0f} ms of processor each")
    assert speed.cpu_s_per_pair < 0.2
    assert speed.pairs_per_s > 0
