"""`./surg robot check` and `home`: vendors' URDFs, kinematics, homes by another solver."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml

import surg_core
from helpers.control import reach
from surg_cli import command_table
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_description.make_cell import ArmPlan, make_cell, make_cell_of
from surg_sim.physics import scene
from surg_sim.physics.sim_arm import add_arm, robot_part, tip_in_flange
from surg_sim.placement import chain_check, home_search
from surg_sim.placement.placement_search import in_range

DESCRIPTION = paths.ROOT / "src" / "surg_description"
GRASPER = DESCRIPTION / "instruments" / "grasper.yaml"


def run(*words: str | Path) -> int:
    options, main = command_table.parse(*command_table.find(["robot", *map(str, words)]))
    return main(options, str(words[0]))


@pytest.fixture
def vendor(tmp_path: Path) -> Path:
    """A UR10e as vendors publish arms: meshes by package://, nothing for MuJoCo."""
    robot = tmp_path / "ur10.yaml"
    document = yaml.safe_load((DESCRIPTION / "robots" / "ur10e.yaml").read_text())
    urdf = (DESCRIPTION / "robots" / document["urdf"]).resolve()
    document["urdf"] = "ur10.urdf"
    robot.write_text(yaml.safe_dump(document))
    root = ElementTree.parse(urdf).getroot()
    root.remove(root.find("mujoco"))  # type: ignore[arg-type]
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            part = ElementTree.SubElement(ElementTree.SubElement(link, kind), "geometry")
            name = f"package://ur_description/meshes/ur10/{kind}/{link.get('name')}.dae"
            ElementTree.SubElement(part, "mesh", {"filename": name})
    ElementTree.ElementTree(root).write(tmp_path / "ur10.urdf")
    return robot


def load(robot: Path, folder: Path) -> surg_core.Arm:
    make_cell(robot, folder / "cell", GRASPER)
    return surg_core.load_cell(folder / "cell").arms["PSM1"]


def compiled(arm: surg_core.Arm) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_arm(spec, arm)
    return spec.compile()


def test_a_vendor_s_urdf_with_meshes_is_ready(
    vendor: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", vendor) == 0
    said = capsys.readouterr().out
    assert "meshes are left out" in said
    assert "wrist_3_joint" in said


@pytest.mark.filterwarnings("ignore:.*meshes are left out")
def test_without_its_meshes_it_has_the_same_masses_and_kinematics(
    vendor: Path, tmp_path: Path
) -> None:
    ours = compiled(load(DESCRIPTION / "robots" / "ur10e.yaml", tmp_path / "a"))
    theirs = compiled(load(vendor, tmp_path / "b"))
    assert ours.nbody == theirs.nbody
    assert ours.body_mass == pytest.approx(theirs.body_mass)
    for model in (ours, theirs):
        assert model.body("PSM1_robot_flange").id > 0
    flanges = []
    for model in (ours, theirs):
        data = mujoco.MjData(model)
        data.qpos[:6] = [0.3, -1.2, 1.4, -1.0, -1.5, 0.2]
        mujoco.mj_kinematics(model, data)
        flanges.append(np.array(data.body("PSM1_robot_flange").xpos))
    assert flanges[0] == pytest.approx(flanges[1], abs=1e-9)


def test_a_millimetre_between_chain_and_urdf_is_found(tmp_path: Path) -> None:
    arm = load(DESCRIPTION / "robots" / "ur5e.yaml", tmp_path)
    same = chain_check.compare(arm, postures=50)
    assert same.position < 1e-12
    text = arm.urdf_path.read_text()
    root = ElementTree.fromstring(text)
    joint = next(j for j in root.findall("joint") if j.get("name") == "elbow_joint")
    origin = joint.find("origin")
    assert origin is not None
    x, y, z = (float(word) for word in str(origin.get("xyz")).split())
    origin.set("xyz", f"{x + 0.001} {y} {z}")
    other = tmp_path / "other.urdf"
    other.write_bytes(ElementTree.tostring(root))
    assert chain_check.compare(replace(arm, urdf_path=other), 50).position == pytest.approx(1e-3)


@pytest.mark.filterwarnings("ignore:.*links without a mass")
def test_what_no_drive_moves_stands_still_and_nothing_collides(tmp_path: Path) -> None:
    """An instrument as others draw it: a plate above its mount, a free wheel, shapes that touch."""
    grasper = yaml.safe_load(GRASPER.read_text())
    text = (GRASPER.parent / grasper["urdf"]).resolve().read_text()
    ball = '<collision><geometry><sphere radius="0.2"/></geometry></collision>'
    text = text.replace("</inertial>", "</inertial>" + ball)
    more = "".join(
        f'<link name="{child}"/><joint name="{child}s" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{turned}"/><origin xyz="0 0.1 0.2"/></joint>'
        for child, kind, parent, turned in (
            ("sleeve", "fixed", "sleeve", "mount"),
            ("wheel", "continuous", "shaft", "wheel"),
        )
    )
    (tmp_path / "g.urdf").write_text(text.replace("</robot>", more + "</robot>"))
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(grasper | {"urdf": "g.urdf"}))
    make_cell(DESCRIPTION / "robots" / "ur5e.yaml", tmp_path / "cell", tmp_path / "g.yaml")
    (arm,) = surg_core.load_cell(tmp_path / "cell").arms.values()
    model = scene.build([arm])
    joints = {model.joint(i).name for i in range(model.njnt)}
    assert {name for name in joints if name[:5] == "PSM1_" and "robot" not in name} == {
        "PSM1_jaw",
        "PSM1_jaw_mirror",
    }
    data = mujoco.MjData(model)
    data.qpos[[model.joint(robot_part(arm, n)).qposadr[0] for n in arm.robot.joint_names]] = (
        arm.robot.home
    )
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    X_BTip = arm.chain.forward(np.array(arm.robot.home)) @ tip_in_flange(arm)
    assert data.body("PSM1_tip").xpos == pytest.approx(X_BTip[:3, 3], abs=1e-9)


def test_a_found_home_is_a_good_one_by_another_solver(tmp_path: Path) -> None:
    robot = tmp_path / "ur5e.yaml"
    document = yaml.safe_load((DESCRIPTION / "robots" / "ur5e.yaml").read_text())
    shutil.copy(DESCRIPTION / "robots" / document["urdf"], tmp_path / "ur5e.urdf")
    document["urdf"] = "ur5e.urdf"
    document["joints"]["home"] = [0.0, -1.57, 0.1, -1.57, 0.1, 0.0]  # stretched upwards
    robot.write_text(yaml.safe_dump(document))
    arm = load(robot, tmp_path)
    assert home_search.judge(arm, np.array(arm.robot.home)) is None
    found = home_search.search(arm, seed=1, draws=60, rounds=4)
    document["joints"]["home"] = [float(angle) for angle in found.q]
    robot.write_text(yaml.safe_dump(document))
    seen = reach.sweep(robot, GRASPER, 0.120)
    print(seen)
    assert seen.tilt_deg <= 50.0
    assert seen.joint_margin > 0.3
    assert seen.singular_value > 0.1
    assert seen.velocity < 1.0
    assert seen.velocity == pytest.approx(found.reserve.speed, rel=0.05)


@pytest.mark.parametrize("rpy", [(np.pi, 0.0, 0.0), (0.0, np.pi / 2, 0.0)], ids=["ceiling", "wall"])
def test_a_home_hangs_as_the_cell_mounts_the_arm(
    rpy: tuple[float, float, float], tmp_path: Path
) -> None:
    plan = ArmPlan(DESCRIPTION / "robots" / "ur5e.yaml", GRASPER, base_xyz=(0, 0, 1), base_rpy=rpy)
    cell = make_cell_of(tmp_path / "cell", {"PSM1": plan}).parent
    assert run("check", cell) == 1  # the shaft of the robot's own home points elsewhere
    (arm,) = surg_core.load_cell(cell).arms.values()
    found = home_search.search(arm, draws=80, rounds=4)
    X_WTip = arm.X_WB_stated @ arm.chain.forward(found.q) @ tip_in_flange(arm)
    assert -X_WTip[2, 2] >= np.cos(np.radians(50.0))
    plan = replace(plan, home=found.q.tolist())
    assert run("check", make_cell_of(tmp_path / "found", {"PSM1": plan}).parent) == 0


def test_a_search_goes_on_where_it_has_found_no_good_home_yet(tmp_path: Path) -> None:
    document = yaml.safe_load((DESCRIPTION / "robots" / "ur3e.yaml").read_text())
    shutil.copy((DESCRIPTION / "robots" / document["urdf"]).resolve(), tmp_path / "ur3e.urdf")
    document["urdf"] = "ur3e.urdf"
    document["limits"]["tip_acceleration"] = 1.4
    (tmp_path / "ur3e.yaml").write_text(yaml.safe_dump(document))
    arm = load(tmp_path / "ur3e.yaml", tmp_path)
    found = home_search.search(arm, draws=40, rounds=4)
    assert found.score >= 1.0, "0.96 after the first round of changes"
    margin = np.minimum(found.q - arm.robot.position_min, arm.robot.position_max - found.q).min()
    assert margin > 0.3


def test_angles_are_those_of_each_joint_s_own_range(tmp_path: Path) -> None:
    """A joint from 0 to 2 pi, as some makers count."""
    arm = load(DESCRIPTION / "robots" / "ur5e.yaml", tmp_path)
    robot = SimpleNamespace(position_min=[0.0, -6.0], position_max=[6.2, 6.0])
    q = in_range(replace(arm, robot=robot), np.array([-1.0, 4.0]))
    assert q == pytest.approx([2 * np.pi - 1.0, 4.0 - 2 * np.pi])


def test_the_term_that_fails_is_named_with_the_value_that_would_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = yaml.safe_load((DESCRIPTION / "robots" / "ur5e.yaml").read_text())
    shutil.copy(DESCRIPTION / "urdf" / "ur5e.urdf", tmp_path)
    document["urdf"] = "ur5e.urdf"
    document["joints"]["acceleration"] = [10.0] * 6
    robot = tmp_path / "slow.yaml"
    robot.write_text(yaml.safe_dump(document))
    assert run("check", robot) == 1
    words = r"limits.tip_acceleration 2; .*: ([0-9.]+) m/s\^2 would do at this home"
    found = re.search(words, "".join(capsys.readouterr()))
    assert found
    for value, status in ((float(found[1]) + 0.02, 1), (float(found[1]), 0)):
        document["limits"]["tip_acceleration"] = value
        robot.write_text(yaml.safe_dump(document))
        assert run("check", robot) == status


def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, vendor: Path) -> None:
    assert run("check", "ur5e") == 0
    with pytest.raises(CliError, match="no such file"):
        run("check", tmp_path / "none.yaml")
    document = yaml.safe_load(vendor.read_text())
    document["flange_link"] = "nowhere"
    vendor.write_text(yaml.safe_dump(document))
    with pytest.raises(CliError, match="nowhere"):
        run("home", vendor)
