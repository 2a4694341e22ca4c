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


@pytest.mark.parametrize(
    ("extent_m", "status", "words"),
    [(0.3, 2, ["scale", "fit"]), (1e-5, 1, ["constant"])],
)
def test_bad_motion_is_refused(
    extent_m: float, status: int, words: list[str], refused: Callable[..., str], tmp_path: Path
) -> None:
    """A circle of 4 s that is too large or too small; the files that are none are the reader's."""
    t = np.arange(0.0, 4.0, 0.02)
    rows = np.column_stack((t, extent_m * np.cos(t), extent_m * np.sin(t), 0.0 * t))
    file = tmp_path / "motion.csv"
    np.savetxt(file, rows, delimiter=",", header="t_s,x_m,y_m,z_m", comments="")
    told = refused(status, "--motion", file)
    for word in (str(file), *words):
        assert word in told


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
