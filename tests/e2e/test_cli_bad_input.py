"""`./surg demo` refuses bad input before anything moves or is written."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from surg_cli.host import paths
from surg_cli.host.terminal import CliError

pytestmark = [pytest.mark.ros, pytest.mark.untimed]

ROBOTS = paths.ROOT / "src" / "surg_description" / "robots"


@pytest.fixture
def refused(surg: Callable[..., int], tmp_path: Path) -> Callable[..., str]:
    """Runs a demo that is refused with a status; what it says. Nothing is written."""

    def run(status: int, *words: object) -> str:
        with pytest.raises(CliError) as error:
            surg("demo", *words, "--out", tmp_path / "run")
        assert error.value.code == status
        assert not (tmp_path / "run").exists()
        return str(error.value)

    return run


def motion_lines(extent_m: float = 0.02) -> list[str]:
    """A small circle of 4 s at 50 Hz, as the lines of a motion file."""
    t = np.arange(0.0, 4.0, 0.02)
    x, y = extent_m * np.cos(t), extent_m * np.sin(t)
    rows = [f"{a:.3f},{b:.6f},{c:.6f},0.0" for a, b, c in zip(t, x, y, strict=True)]
    return ["t_s,x_m,y_m,z_m", *rows]


def changed(number: int, line: str) -> list[str]:
    lines = motion_lines()
    lines[number - 1] = line
    return lines


BAD_MOTIONS = {
    "missing column": (changed(1, "t_s,x_m,y_m,depth"), ["line 1", "z_m"]),
    "NaN": (changed(40, "0.760,nan,0.0,0.0"), ["motion.csv:40: ", "x_m", "nan"]),
    "text": (changed(40, "0.760,left,0.0,0.0"), ["motion.csv:40: ", "x_m", "left"]),
    "time backwards": (changed(40, "0.100,0.014,0.014,0.0"), ["line 40", "0.100"]),
    "jump": (changed(40, "0.760,0.514,0.014,0.0"), ["line 40", "jump"]),
    "does not fit": (motion_lines(0.3), ["scale", "fit"]),
    "no data": (["t_s,x_m,y_m,z_m"], ["0 samples"]),
}


@pytest.mark.parametrize("what", BAD_MOTIONS)
def test_bad_motion_is_refused(what: str, refused: Callable[..., str], tmp_path: Path) -> None:
    lines, words = BAD_MOTIONS[what]
    file = tmp_path / "motion.csv"
    file.write_text("\n".join(lines) + "\n")
    told = refused(2, "--motion", file)
    for word in (str(file), *words):
        assert word in told


def test_constant_motion_is_refused(refused: Callable[..., str], tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text("\n".join(motion_lines(1e-5)) + "\n")
    assert "constant" in refused(1, "--motion", file)


def broken_robot(folder: Path, key: str, line: str) -> Path:
    """A copy of the UR5e's YAML with the line of one key replaced."""
    text = (ROBOTS / "ur5e.yaml").read_text("utf-8")
    changed_text, count = re.subn(rf"^( *){key}:.*$", rf"\1{line}", text, flags=re.MULTILINE)
    assert count == 1
    (folder / "robots").mkdir()
    shutil.copytree(ROBOTS.parent / "urdf", folder / "urdf")
    path = folder / "robots" / "broken.yaml"
    path.write_text(changed_text)
    return path


@pytest.mark.parametrize(
    ("key", "line", "words"),
    [
        ("tip_velocity", "tip_velocity: 25.0", ["broken.yaml", "limits.tip_velocity", "25"]),
        ("tip_velocity", "tip_velocity: fast", ["limits.tip_velocity", "fast"]),
        ("tip_velocity", "tip_velocity: .nan", ["limits.tip_velocity", "nan"]),
        ("rcm_gain", "rcm_gian: 20.0", ["rcm_gain"]),
        ("servo_timeout", "servo_timeout: 0.1\n  haste: 3.0", ["haste"]),
        ("flange_link", "flange_link: hand", ["hand"]),
        ("urdf", "urdf: ../urdf/none.urdf", ["none.urdf"]),
    ],
)
def test_broken_robot_is_refused(
    key: str, line: str, words: list[str], refused: Callable[..., str], tmp_path: Path
) -> None:
    robot = broken_robot(tmp_path, key, line)
    told = refused(2, "--robot", robot)
    for word in words:
        assert word in told
