"""Configuration files: a valid set is read, and every broken one is refused with file and key."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import surg_core
from surg_core import ConfigError, _core

FILES = {
    "robot.yaml": """\
format: surg_robot/1
name: six
urdf: six.urdf
base_link: l0
flange_link: l6
command: joint_velocity
joints:
  names: [j0, j1, j2, j3, j4, j5]
  home: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
  position_min: [-3, -3, -3, -3, -3, -3]
  position_max: [3, 3, 3, 3, 3, 3.0]
  velocity: [3, 3, 3, 3, 3, 3]
  acceleration: [40, 40, 40, 40, 40, 40]
limits:
  tip_velocity: 0.25
  tip_acceleration: 2
  tip_jerk: 40.0
  pivot_velocity: 1.5
  pivot_acceleration: 16
  pivot_jerk: 330
  roll_velocity: 3.0
  roll_acceleration: 40
  roll_jerk: 800
  flange_velocity: 0.25
  cone: 1.0
  depth_min: 0.02
  depth_slow: 3e-2
  depth_max: 0.22
  stop_deceleration: 4
  step_slack: 0.002
  step_roll_slack: 0.03
  step_dt_max: 0.1
  rcm_error_warn: 1.0e-3
  rcm_error_fault: 0.002
  tip_force_soft: 5.0
  tip_force_hard: 8.0
  trocar_force_warn: 10.0
  trocar_force_fault: 15.0
  joint_margin: 0.1
  roll_max: 6.2832
tuning:
  rcm_gain: 40
  tip_gain: 10
  roll_gain: 10
  posture_gain: 1
  profiler_duration: 0.5
  stream_delay: 0.01
  tremor: 10.0
  servo_timeout: 0.1
  track_noise: 0.0003
  track_jerk: 0.02
  track_timeout: 0.25
""",
    "grasper.yaml": """\
format: surg_instrument/1
name: grasper
urdf: grasper.urdf
mount_link: mount
tip_link: tip
jaw: {min: 0.0, max: 1.0, velocity: 3.0}
""",
    "cell/cell.yaml": """\
format: surg_cell/1
name: test
network: loopback
arms:
  PSM1:
    robot: ../robot.yaml
    instrument: ../grasper.yaml
    link: simulator
    base: {xyz: [0.1, 0, 0], rpy: [0, 0, 1.5707963267948966]}
    limits: {tip_velocity: 0.1}
""",
    "cell/calibration/tool_PSM1.yaml": """\
format: surg_tool/1
shaft_axis: [0, 0, 1]
tip: [0.06, 0, 0.3]
residual: 0
n: 12
condition: 3.5
date: 2026-11-21
""",
    "cell/calibration/trocar_PSM1.yaml": """\
format: surg_trocar/1
point: [0.5, 0.0, 0.2]
residual: 1e-5
n: 12
condition: 3.5
date: "2026-11-21"
""",
    "six.urdf": "<robot name='six'>"
    + "".join(f"<link name='l{i}'/>" for i in range(7))
    + "".join(
        f"<joint name='j{i}' type='revolute'><parent link='l{i}'/><child link='l{i + 1}'/>"
        f"<origin xyz='0 0 0.2'/><axis xyz='{'0 1 0' if i % 2 else '0 0 1'}'/>"
        "<limit lower='-3' upper='3' velocity='3'/></joint>"
        for i in range(6)
    )
    + "</robot>",
    "grasper.urdf": "<robot name='grasper'><link name='mount'/><link name='tip'/><joint name='s' "
    "type='fixed'><parent link='mount'/><child link='tip'/></joint></robot>",
}

ROBOT, GRASPER, CELL = "robot.yaml", "grasper.yaml", "cell/cell.yaml"
TOOL, TROCAR = "cell/calibration/tool_PSM1.yaml", "cell/calibration/trocar_PSM1.yaml"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A valid cell with everything it refers to."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_a_valid_cell_is_read_whole(folder: Path) -> None:
    cell = surg_core.load_cell(folder / "cell")
    assert cell.config.name == "test"
    assert list(cell.arms) == ["PSM1"]
    arm = cell.arms["PSM1"]
    assert arm.link == "simulator"
    assert arm.robot.joint_names == ("j0", "j1", "j2", "j3", "j4", "j5")
    assert arm.robot.command == _core.Command.JOINT_VELOCITY
    np.testing.assert_array_equal(arm.robot.home, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert arm.robot.limits.tip_velocity == 0.25
    assert arm.limits.tip_velocity == 0.1
    assert arm.limits.depth_slow == 0.03
    assert arm.tool.n == 12
    assert arm.tool.date == arm.trocar.date == "2026-11-21"
    np.testing.assert_array_equal(arm.trocar.p_BRcm, [0.5, 0.0, 0.2])
    np.testing.assert_allclose(arm.X_WB[:3, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(arm.X_WB[:3, 3], [0.1, 0, 0])
    assert arm.chain.dof == 6
    assert arm.chain.forward(np.zeros(6))[2, 3] == pytest.approx(1.2)
    assert arm.urdf_path == (folder / "six.urdf").resolve()
    assert arm.instrument_urdf.is_absolute()
    by_file = surg_core.load_cell(folder / "cell" / "cell.yaml")
    assert by_file.arms["PSM1"].limits.as_dict() == arm.limits.as_dict()


def test_what_was_read_is_frozen(folder: Path) -> None:
    cell = surg_core.load_cell(folder / "cell")
    arm = cell.arms["PSM1"]
    with pytest.raises(AttributeError):
        arm.name = "PSM2"  # type: ignore[misc]
    with pytest.raises(TypeError):
        cell.arms["PSM2"] = arm  # type: ignore[index]
    with pytest.raises(AttributeError):
        arm.limits.tip_velocity = 9.0  # type: ignore[misc]
    for array in (arm.X_WB, arm.robot.home, arm.tool.s_F, arm.trocar.p_BRcm):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


# file, (text, replacement), words that the message must hold beside the file's name
MUTANTS: list[tuple[str, tuple[str, str], list[str]]] = [
    (ROBOT, ("format: surg_robot/1", "format: surg_robot/2"), ["format", "surg_robot/2", ":1:"]),
    (ROBOT, ("format: surg_robot/1\n", ""), ["format", "missing"]),
    (ROBOT, ("name: six", "name: ''"), ["name", "empty", ":2:"]),
    (ROBOT, ("name: six", "name:"), ["name", "empty", ":2:"]),
    (ROBOT, ("name: six", "name: 6"), ["name", "6 is not"]),
    (ROBOT, ("urdf: six.urdf", "urdf: seven.urdf"), ["urdf", "seven.urdf", "cannot be"]),
    (ROBOT, ("base_link: l0", "base_link: foot"), ["urdf", "six.urdf", "no link 'foot'"]),
    (ROBOT, ("joint_velocity", "torque"), ["command", "torque", "joint_velocity"]),
    (ROBOT, ("[j0, j1,", "[j1, j0,"), ["joints.names", "j1, j0"]),
    (ROBOT, ("[j0, j1,", "[j0, j0,"), ["joints.names", "twice"]),
    (ROBOT, ("[j0, j1, j2, j3, j4, j5]", "[j0, j1]"), ["joints.names", "2 joints", "6 to 8"]),
    (ROBOT, ("[j0, j1,", "[j0, 1,"), ["joints.names", "one kind", ":8:"]),
    (ROBOT, ("[j0, j1,", "[j0, [j1],"), ["joints.names", "list"]),
    (ROBOT, ("home: [0.1,", "home: [0.1, 0.1,"), ["joints.home", "7 values", ":9:"]),
    (ROBOT, ("home: [0.1,", "home: [3.5,"), ["joints.home", "j0", "outside"]),
    (ROBOT, ("3.0]", ".nan]"), ["joints.position_max", "nan"]),
    (ROBOT, ("velocity: [3,", "velocity: [0,"), ["joints.velocity", "out of range"]),
    (ROBOT, ("velocity: [3,", "velocity: [3.0001,"), ["joints.velocity", "j0"]),
    (ROBOT, ("position_max: [3,", "position_max: [3.0001,"), ["joints.position_max", "j0"]),
    (ROBOT, ("position_min: [-3,", "position_min: [-3.1,"), ["joints.position_min", "j0"]),
    (ROBOT, ("position_min: [-3,", "position_min: [3,"), ["joints.position_min", "j0", "below"]),
    *[
        (ROBOT, ("limits:", f"  braking: {value}\nlimits:"), ["joints.braking", word])
        for value, word in (
            ("[2, 0.25]", "range"),
            ("[0.25]", "range"),
            ("[0.25, 1, 2]", "range"),
            ("[0.04, 2]", "0.05"),
            ("[0.25, 21]", "20"),
            ("[-1, 2]", "range"),
            ("[0.25, .nan]", "range"),
            ("0.25", "list"),
            ("[a, b]", "list"),
        )
    ],
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: 25"), ["limits.tip_velocity", "25 m/s", ":15:"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: -.inf"), ["limits.tip_velocity", "-inf"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: fast"), ["limits.tip_velocity", "'fast'"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: '0.25'"), ["limits.tip_velocity", "'0.25'"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: true"), ["limits.tip_velocity", "true"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_velocity: {a: 1}"), ["limits.tip_velocity", "section"]),
    (ROBOT, ("tip_velocity: 0.25", "tip_veloctiy: 0.25"), ["limits.tip_velo", "limits."]),
    (ROBOT, ("  cone: 1.0\n", "  cone: 1.0\n  cone: 0.9\n"), ["limits.cone", "twice", ":26:"]),
    (ROBOT, ("depth_min: 0.02", "depth_min: 0.04"), ["limits", "depth_min", "depth_slow"]),
    (ROBOT, ("rcm_error_fault: 0.002", "rcm_error_fault: 0.001"), ["rcm_error_fault"]),
    (ROBOT, ("rcm_gain: 40", "rcm_gain: 150"), ["tuning.rcm_gain", "150", "75"]),
    (ROBOT, ("  servo_timeout: 0.1\n", ""), ["tuning.servo_timeout", "missing"]),
    (ROBOT, ("tuning:", "colour: red\ntuning:"), ["colour", "not a known key"]),
    (ROBOT, ("tuning:", "tuning: [\n"), ["is not YAML"]),
    (ROBOT, ("tuning:", "'a.b': 1\ntuning:"), ["a.b", "without dots"]),
    (ROBOT, ("tuning:", "tuning: &t\n  again: *t"), ["tuning.again", "itself"]),
    (GRASPER, ("max: 1.0", "max: -0.1"), ["jaw.min", "jaw.max"]),
    (GRASPER, ("velocity: 3.0", "velocity: 300"), ["jaw.velocity", "300"]),
    (GRASPER, ("urdf: grasper.urdf", "urdf: other.urdf"), ["urdf", "other.urdf", "cannot be"]),
    (GRASPER, ("tip_link: tip", "tip_link: top"), ["urdf", "no link 'top'"]),
    (CELL, ("network: loopback", "network: internet"), ["network", "internet", "isolated"]),
    (CELL, ("arms:", "machines: {robot: 10.7.0.1}\narms:"), ["machines", "network: isolated"]),
    *[
        (CELL, ("network: loopback", f"network: isolated\nmachines: {machines}"), words)
        for machines, words in (
            ("{operator: 10.7.0.2}", ["machines.robot", "missing"]),
            ("{robot: 8.8.8.8}", ["machines.robot", "8.8.8.8", "routable", "192.168"]),
            ("{robot: 127.0.0.1}", ["machines.robot", "127.0.0.1", "allowed"]),
            ("{robot: 172.32.0.1}", ["machines.robot", "172.32.0.1"]),
            ("{robot: 10.7.0.256}", ["machines.robot", "'10.7.0.256'", "IPv4"]),
            ("{robot: 10.7.0.01}", ["machines.robot", "IPv4"]),
            ("{robot: 10.7.0.1.}", ["machines.robot", "IPv4"]),
            ("{robot: robot.local}", ["machines.robot", "robot.local", "IPv4"]),
            ("{robot: 10.7}", ["machines.robot", "text"]),
            ("{robot: 10.7.0.1, operator: 192.169.0.1}", ["machines.operator", "192.169.0.1"]),
            ("{robot: 10.7.0.1, surgeon: 10.7.0.2}", ["machines.surgeon", "known"]),
        )
    ],
    *[
        (CELL, ("arms:", f"endoscope: {{{section}}}\narms:"), [f"endoscope.{key}", *words])
        for section, key, words in (
            ("layout: sbs", "source", ["missing"]),
            ("source: /dev/video0, layout: sbs", "source", ["'/dev/video0'", "v4l2:/dev/video0"]),
            ("source: 'v4l2:', layout: sbs", "source", ["'v4l2:'", "KIND:ADDRESS"]),
            ("source: 'file:a.mp4'", "layout", ["missing"]),
            ("source: 'file:a.mp4', layout: 3d", "layout", ["'3d'", "'sbs_half'", "'rows'"]),
            ("source: 'file:a.mp4', layout: sbs, size: [1920]", "size", ["width, height"]),
            ("source: 'file:a.mp4', layout: sbs, size: [8, 8]", "size", ["16 to 7680"]),
            ("source: 'file:a.mp4', layout: sbs, size: [640.5, 480]", "size", ["whole"]),
            ("source: 'file:a.mp4', layout: sbs, rate: 0", "rate", ["0 1/s", "1 to 240"]),
            ("source: 'file:a.mp4', layout: sbs, swap: 1", "swap", ["true or false"]),
            ("source: 'file:a.mp4', layout: sbs, flip: both", "flip", ["'both'", "'rotate_180'"]),
            ("source: 'file:a.mp4', layout: sbs, latency: 80", "latency", ["80 s", "0 to 1"]),
            ("source: 'file:a.mp4', layout: sbs, port: 1", "port", ["known", "endoscope.layout"]),
        )
    ],
    (CELL, ("robot: ../robot.yaml", "robot: ../robt.yaml"), ["robt.yaml", "there is no"]),
    (CELL, ("link: simulator", "link: telepathy"), ["arms.PSM1.link", "telepathy"]),
    (CELL, ("xyz: [0.1, 0, 0]", "xyz: [0.1, 0]"), ["arms.PSM1.base.xyz", "three"]),
    (CELL, ("{tip_velocity: 0.1}", "{tip_velocity: 0.3}"), ["PSM1.limits.tip_velocity", "tighten"]),
    (CELL, ("{tip_velocity: 0.1}", "{tip_speed: 0.1}"), ["PSM1.limits.tip_speed", "not a limit"]),
    (CELL, ("  PSM1:", "  PSM 1:"), ["arms.PSM 1", "letters"]),
    (CELL, ("    link: simulator\n", ""), ["arms.PSM1.link", "missing"]),
    (TOOL, ("shaft_axis: [0, 0, 1]", "shaft_axis: [0, 0, 0.9]"), ["shaft_axis", "0.9", "unit"]),
    (TOOL, ("residual: 0", "residual: 0.01"), ["residual", "0.01"]),
    (TOOL, ("tip: [0.06, 0, 0.3]", "tip: [60, 0, 300]"), ["tip", "60 m"]),
    (TROCAR, ("condition: 3.5", "condition: 1e9"), ["condition", "1e+09"]),
    (TROCAR, ("n: 12", "n: 0"), ["n", "0"]),
    (TROCAR, ("surg_trocar", "surg_tool"), ["format", "surg_tool/1"]),
]


def test_an_endoscope_is_read_with_its_defaults(folder: Path) -> None:
    assert surg_core.load_cell(folder / "cell").config.endoscope is None
    path = folder / CELL
    text = path.read_text(encoding="utf-8")
    least = "endoscope:\n  source: v4l2:/dev/video0\n  layout: mono\n"
    path.write_text(least + text, encoding="utf-8")
    found = surg_core.load_cell(folder / "cell").config.endoscope
    assert (found.source, found.layout) == ("v4l2:/dev/video0", "mono")
    assert (found.size, found.rate, found.swap, found.flip, found.latency) == (
        (0, 0), 0.0, False, "none", 0.0,
    )  # fmt: skip
    more = (
        "  size: [1920, 1080]\n  rate: 29.97\n  swap: true\n  flip: rotate_180\n  latency: 0.08\n"
    )
    path.write_text(least + more + text, encoding="utf-8")
    found = surg_core.load_cell(folder / "cell").config.endoscope
    assert (found.size, found.rate, found.swap, found.flip, found.latency) == (
        (1920, 1080), 29.97, True, "rotate_180", 0.08,
    )  # fmt: skip


def test_machines_are_read_by_role(folder: Path) -> None:
    assert surg_core.load_cell(folder / "cell").config.machines == {}
    path = folder / CELL
    machines = {"robot": "10.7.0.1", "operator": "172.31.255.254", "endoscope": "169.254.3.4"}
    lines = "".join(f"\n  {role}: {address}" for role, address in machines.items())
    text = path.read_text(encoding="utf-8")
    text = text.replace("network: loopback", f"network: isolated\nmachines:{lines}")
    path.write_text(text, encoding="utf-8")
    assert surg_core.load_cell(folder / "cell").config.machines == machines


@pytest.mark.parametrize(
    ("file", "change", "words"), MUTANTS, ids=[f"{k:02d}" for k in range(len(MUTANTS))]
)
def test_a_broken_file_is_refused_with_file_and_key(
    folder: Path, file: str, change: tuple[str, str], words: list[str]
) -> None:
    path = folder / file
    text = path.read_text(encoding="utf-8")
    assert change[0] in text
    path.write_text(text.replace(change[0], change[1], 1), encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        surg_core.load_cell(folder / "cell")
    message = str(error.value)
    for word in [*words, path.name]:
        assert word in message, message


def test_an_arm_and_a_calibration_that_are_not_there(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"cell\.yaml.*'PSM9'.*PSM1"):
        _core.load_arm(str(folder / "cell"), "PSM9")
    (folder / TROCAR).unlink()
    with pytest.raises(ConfigError, match=r"trocar_PSM1\.yaml.*No such file"):
        surg_core.load_cell(folder / "cell")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not a mapping"),
        ("- a\n- b\n", "is not a mapping"),
        ("just text", "is not a mapping"),
        ("a: 1\n\tb: 2\n", ":2: is not YAML"),
        ("a: 1\n---\na: 2\n", "is not YAML"),
        ("a: !!python/object/apply:os.system [echo]\n", "format"),
        ("a: \x07\n", "is not YAML"),
        ("[" * 5000, "is not YAML|nested too deeply"),
        ("1: {2: {}}\n", "format"),
    ],
)
def test_a_file_that_is_no_configuration(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=words) as error:
        surg_core.load_robot(path)
    assert str(path) in str(error.value)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    for load in (surg_core.load_robot, surg_core.load_instrument, surg_core.load_cell):
        with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
            load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match=r"cell\.yaml: cannot be read"):
        surg_core.load_cell(tmp_path)
    with pytest.raises(ConfigError, match="Is a directory"):
        surg_core.load_robot(tmp_path)
    large = tmp_path / "large.yaml"
    large.write_bytes(b"x" * (2 << 20))
    with pytest.raises(ConfigError, match=r"large\.yaml.*1 MiB"):
        surg_core.load_robot(large)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes("name: Müller".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"latin\.yaml: is not UTF-8"):
        surg_core.load_robot(latin)


def test_nested_aliases_do_not_unfold_without_end() -> None:
    lines = ["a0: &a0 {x: 1, y: 2}"]
    lines += [f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}" for i in range(1, 40)]
    with pytest.raises(ConfigError, match="more than"):
        _core.parse_document("\n".join(lines), "bomb.yaml")


def test_scalars_are_read_by_yaml_1_2() -> None:
    text = """\
a: 1
b: 1e-3
c: -.5
d: 1_000
e: 12:30
f: yes
g: 'true'
h: False
i: [1, 2.5]
j: []
k: [x, "2"]
l: -.inf
m: 1e999
n: {}
o: 010
p:
  q: {r: "12"}
"""
    document = _core.parse_document(text, "x.yaml")
    values = document.values
    assert values == {
        "a": 1.0,
        "b": 1e-3,
        "c": -0.5,
        "d": "1_000",
        "e": "12:30",
        "f": "yes",
        "g": "true",
        "h": False,
        "i": [1.0, 2.5],
        "j": [],
        "k": ["x", "2"],
        "l": -math.inf,
        "m": math.inf,
        "o": 10.0,
        "p.q.r": "12",
    }
    assert type(values["a"]) is float
    assert (document.lines["j"], document.lines["p.q.r"]) == (10, 17)
    assert math.isnan(_core.parse_document("a: .NaN", "x.yaml").values["a"])


def test_limits_are_told_by_name(folder: Path) -> None:
    robot = surg_core.load_robot(folder / ROBOT)
    names = robot.limits.as_dict()
    assert names["tip_jerk"] == 40.0
    assert len(names) == 26
    assert robot.tuning.as_dict()["rcm_gain"] == 40.0
    assert "tip_jerk=40.0" in repr(robot.limits)
