"""The bundled cells: calibrated exactly, reproducible, and homes with room to work in."""

import random
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import surg_core
from helpers.control.reach import sweep
from helpers.control.third_arm import write_third_arm
from surg_cli.host import paths
from surg_core import ConfigError
from surg_core.replace_file import yaml_text
from surg_core.urdf import fixed_transform
from surg_description.make_cell import home_pose, make_cell

DESCRIPTION = paths.ROOT / "src/surg_description"
GRASPER = DESCRIPTION / "instruments/grasper.yaml"
ROBOTS = ("ur5e", "panda")
OTHERS = ("ur3e", "ur10e", "fr3", "xarm7")
"""Robots without a bundled cell: `./surg demo --robot` makes one."""
DEPTH = 0.120


def robot_yaml(name: str, tmp_path: Path) -> Path:
    """A bundled robot's YAML, or the third arm's, written now."""
    if name == "third_arm":
        return write_third_arm(tmp_path / "third", DESCRIPTION / "robots/ur5e.yaml")
    return DESCRIPTION / f"robots/{name}.yaml"


@pytest.mark.parametrize("name", ROBOTS)
def test_bundled_cell_is_what_the_generator_writes(name: str, tmp_path: Path) -> None:
    bundled = paths.ROOT / f"cells/sim_{name}"
    fresh = tmp_path / f"sim_{name}"
    make_cell(robot_yaml(name, tmp_path), fresh, GRASPER)
    for file in ("calibration/tool_PSM1.yaml", "calibration/trocar_PSM1.yaml"):
        assert (fresh / file).read_text() == (bundled / file).read_text()

    def without_paths(cell: Path) -> str:
        return re.sub(r"(robot|instrument): .*", "", (cell / "cell.yaml").read_text())

    assert without_paths(fresh) == without_paths(bundled)
    arm = yaml.safe_load((bundled / "cell.yaml").read_text())["arms"]["PSM1"]
    assert (bundled / arm["robot"]).resolve() == robot_yaml(name, tmp_path).resolve()
    assert (bundled / arm["instrument"]).resolve() == GRASPER.resolve()


@pytest.mark.parametrize("name", [*ROBOTS, *OTHERS, "third_arm"])
def test_core_reads_the_cell_and_the_shaft_meets_the_trocar(name: str, tmp_path: Path) -> None:
    cell = paths.ROOT / f"cells/sim_{name}"
    if name not in ROBOTS:
        cell = tmp_path / "cell"
        make_cell(robot_yaml(name, tmp_path), cell, GRASPER)
    arm = surg_core.load_cell(cell).arms["PSM1"]
    X_BF = np.asarray(arm.chain.forward(arm.robot.home))
    shaft = surg_core.shaft_state(X_BF, arm.tool.s_F, arm.tool.p_FTip, arm.trocar.p_BRcm)
    assert np.linalg.norm(shaft.e) < 1e-9
    assert abs(shaft.depth - DEPTH) < 1e-9
    X_FTip = fixed_transform(arm.instrument_urdf, "mount", "tip")
    assert np.array_equal(arm.tool.p_FTip, X_FTip[:3, 3])
    assert np.array_equal(arm.tool.s_F, X_FTip[:3, 2])


@pytest.mark.parametrize("name", [*ROBOTS, *OTHERS])
def test_yaml_and_urdf_state_the_same_limits(name: str, tmp_path: Path) -> None:
    import xml.etree.ElementTree as ET

    joints = yaml.safe_load(robot_yaml(name, tmp_path).read_text())["joints"]
    limits = {
        joint.get("name"): joint.find("limit")
        for joint in ET.parse(DESCRIPTION / f"urdf/{name}.urdf").getroot().findall("joint")
    }
    for i, joint in enumerate(joints["names"]):
        limit = limits[joint]
        assert limit is not None
        if name == "fr3":  # tighter on purpose, see the test below
            assert float(limit.get("lower", "nan")) <= joints["position_min"][i]
            assert float(limit.get("upper", "nan")) >= joints["position_max"][i]
            assert float(limit.get("velocity", "nan")) >= joints["velocity"][i]
            continue
        assert float(limit.get("lower", "nan")) == pytest.approx(
            joints["position_min"][i], abs=1e-4
        )
        assert float(limit.get("upper", "nan")) == pytest.approx(
            joints["position_max"][i], abs=1e-4
        )
        assert float(limit.get("velocity", "nan")) == pytest.approx(joints["velocity"][i], abs=1e-4)
        assert float(limit.get("effort", "0")) > 0


@pytest.mark.parametrize("name", [*ROBOTS, *OTHERS])
def test_every_number_of_a_robot_says_why(name: str, tmp_path: Path) -> None:
    """Each limit and tuning value stands with a comment that holds its unit."""
    section = ""
    checked = 0
    for line in robot_yaml(name, tmp_path).read_text().splitlines():
        if re.fullmatch(r"\w+:", line):
            section = line[:-1]
        match = re.fullmatch(r"  \w+: [-\d.e]+\s*(#.*)?", line)
        if section in ("limits", "tuning") and match:
            assert match.group(1), line
            assert re.search(r"\b(m|rad|s|1|N|Hz)\b", match.group(1)), line
            checked += 1
    assert checked == 37


@pytest.mark.parametrize("name", [*ROBOTS, *OTHERS, "third_arm"])
def test_home_has_room_to_work(name: str, tmp_path: Path) -> None:
    """Over ±35, ±35, ±30 mm round the home tip and ±57 degrees of roll: far from every limit."""
    result = sweep(robot_yaml(name, tmp_path), GRASPER, DEPTH)
    print(f"{name}: {result}")
    assert result.tilt_deg < 50.0  # downwards rather than sideways
    assert result.joint_margin > 0.3  # three times the margin at which joints slow down
    assert result.singular_value > 0.10  # smallest of the flange Jacobian, m and rad mixed
    assert result.velocity < 0.90  # of each joint's limit at 0.12 m/s and 1 rad/s of roll
    assert result.flange_velocity < 0.25  # m/s at 0.12 m/s, 90 mm deep and deeper


def test_home_posture_accelerations(tmp_path: Path) -> None:
    """At the tip's own acceleration limit only the Panda's joints may need scaling."""
    shares = {
        name: sweep(robot_yaml(name, tmp_path), GRASPER, DEPTH).acceleration
        for name in (*ROBOTS, *OTHERS, "third_arm")
    }
    print(shares)
    assert shares.pop("panda") < 1.4
    assert max(shares.values()) < 1.0


# Franka's limit of an FR3's joint velocity towards a position limit p, for each joint:
# min(v, max(0, -offset + sqrt(slope (p + beyond - q)))). Source: rate_limiting.h of libfranka.
FR3_OFFSET = np.array([0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35])
FR3_SLOPE = np.array([12.0, 5.17, 7.0, 8.0, 34.0, 11.0, 34.0])
FR3_UPPER = np.array([2.75010, 1.79180, 2.90650, -0.1458, 2.81010, 4.52050, 3.01960])
FR3_LOWER = np.array([-2.75010, -1.79180, -2.90650, -3.04810, -2.81010, 0.54092, -3.01960])
FR3_FASTEST = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])


def fr3_allows(left: np.ndarray) -> np.ndarray:
    """Fastest motion [rad/s] at a distance [rad] to the ends of the formula."""
    root = np.sqrt(FR3_SLOPE * np.maximum(left, 0))
    return np.minimum(FR3_FASTEST, np.maximum(0, root - FR3_OFFSET))


def test_the_fr3_keeps_the_velocity_limits_of_every_posture(tmp_path: Path) -> None:
    """A joint that runs at its limit as fast as the core lets it: below Franka's formula."""
    robot = yaml.safe_load(robot_yaml("fr3", tmp_path).read_text())
    joints, margin = robot["joints"], robot["limits"]["joint_margin"]
    low, high, fastest, a = (
        np.array(joints[key], dtype=float)
        for key in ("position_min", "position_max", "velocity", "acceleration")
    )
    least = np.inf
    for left in np.linspace(0, 3, 3001):  # [rad] to the YAML's limit
        before = np.sqrt(2 * 0.8 * a * max(left - margin, 0))
        speed = np.minimum(fastest, np.hypot(5 * min(left, margin), before))
        for beyond in (FR3_UPPER - high, low - FR3_LOWER):
            least = min(least, float((fr3_allows(left + beyond) - speed).min()))
    print(f"below the formula by {least:.4f} rad/s and more")
    assert least >= 0


def test_home_pose_puts_the_trocar_on_the_shaft() -> None:
    rng = np.random.default_rng(7)
    for depth in rng.uniform(0.02, 0.22, 20):
        pose = home_pose(DESCRIPTION / "robots/ur5e.yaml", GRASPER, depth)
        assert np.linalg.norm(pose.p_BTip - pose.p_BRcm - depth * pose.s_B) < 1e-15
        assert np.linalg.norm(pose.s_B) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("edit", "error", "words"),
    [
        (("name: ur5e\n", "name: ur5e  # mine\n"), None, ""),
        (("name: ur5e\n", ""), ConfigError, "name"),
        (("urdf: ../urdf/ur5e.urdf\n", ""), ConfigError, "urdf"),
        (("flange_link: flange", "flange_link: hand"), ConfigError, "no link 'hand'"),
        (("elbow_joint", "knee_joint"), ConfigError, "knee_joint"),
        (("  home: [", "  home: [0.0, "), ConfigError, "home"),
        (("joints:", "joints: ["), ConfigError, "robot.yaml"),
    ],
)
def test_broken_robots_are_refused(
    edit: tuple[str, str], error: type[Exception] | None, words: str, tmp_path: Path
) -> None:
    text = (DESCRIPTION / "robots/ur5e.yaml").read_text()
    assert edit[0] in text
    text = text.replace("../urdf/", f"{DESCRIPTION}/urdf/") if "urdf" not in edit[0] else text
    (tmp_path / "robot.yaml").write_text(text.replace(*edit))
    if error is None:
        make_cell(tmp_path / "robot.yaml", tmp_path / "cell", GRASPER)
        return
    with pytest.raises(error, match=re.escape(words)) as caught:
        make_cell(tmp_path / "robot.yaml", tmp_path / "cell", GRASPER)
    assert str(tmp_path / "robot.yaml") in str(caught.value) or "ur5e.urdf" in str(caught.value)
    assert not (tmp_path / "cell").exists()


NAMES = ["a #b", "#a", "a: b", "it's", 'say "a"', "~", "null", "2026", "2026-11-21", "1e3", ".5e3"]
NAMES += [
    "0x1F",
    "0o7",
    "nan",
    ".inf",
    "yes",
    "On",
    "TRUE",
    "- a",
    "? a",
    "[x], y",
    "{x}",
    "&a",
    "*a",
]
NAMES += ["!t", "%d", "`x`", "back\\slash", "end ", " a  b", "Jürgen 🤖"]


@pytest.mark.parametrize("name", NAMES)
def test_names_and_paths_survive_the_round_trip(name: str, tmp_path: Path) -> None:
    """By the core's reader and by PyYAML: folders and files that people name as they like."""
    robot, instrument = tmp_path / name / "arm.yaml", tmp_path / name / "tool" / f"{name}.yaml"
    instrument.parent.mkdir(parents=True)
    for bundled, file in ((DESCRIPTION / "robots/ur5e.yaml", robot), (GRASPER, instrument)):
        text = bundled.read_text().replace("../urdf/", f"{DESCRIPTION}/urdf/")
        file.write_text(text)
    cell = make_cell(robot, tmp_path / name / name, instrument)
    read = surg_core.load_cell(cell)
    assert read.config.name == yaml.safe_load(cell.read_text())["name"] == name
    assert Path(read.arms["PSM1"].robot.file).resolve() == robot
    assert Path(read.arms["PSM1"].instrument.file).resolve() == instrument


def test_no_text_leaves_its_line_in_yaml() -> None:
    rng = random.Random(7)
    signs = "ab01 #:-'\"\\~!&*[]{},?|>@%`\t\n\r\x85\u2028\u00e9\x07🤖."
    for _ in range(2000):
        text = "".join(rng.choices(signs, k=rng.randrange(8)))
        line = f"key: {yaml_text(text)}  # as it is"
        assert len(line.splitlines()) == 1
        assert yaml.safe_load(line) == {"key": text}


def test_a_trocar_that_no_cell_may_state_is_blamed_on_the_home(tmp_path: Path) -> None:
    """A long arm, stretched upwards: the file at fault is the robot's, not one that we write."""
    robot = robot_yaml("third_arm", tmp_path)
    urdf = robot.with_suffix(".urdf")
    assert "0 0 0.46" in urdf.read_text()
    urdf.write_text(urdf.read_text().replace("0 0 0.46", "0 0 2.46"))
    with pytest.raises(ValueError, match=r"joints\.home: .*allowed are 2: bend") as caught:
        make_cell(robot, tmp_path / "cell", GRASPER)
    assert str(robot) in str(caught.value)
    assert not (tmp_path / "cell").exists()


@pytest.mark.parametrize("depth", [0.0, -0.1, 0.6, float("nan")])
def test_depth_out_of_range_is_refused(depth: float) -> None:
    with pytest.raises(ValueError, match=r"allowed: 0\.005 to 0\.5 m"):
        home_pose(DESCRIPTION / "robots/ur5e.yaml", GRASPER, depth)
