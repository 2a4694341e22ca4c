"""`./surg policy new` and `./surg task new`: what they write runs, and overwrites nothing."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from surg_cli import __main__ as cli
from surg_cli.commands.policy import new_file
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_core import make_pose
from surg_policy_client import ActionSpec, Feature, Observation, Spec
from surg_sim.tasks import load

STATE = ("tip_x", "tip_y", "tip_z", "roll", "jaw", "set_x", "set_y", "set_z", "roll_set")


def new(kind: str, name: str) -> int:
    """`./surg KIND new NAME`, in this process."""
    return cli.run([kind, "new", name])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_task_has_its_own_name(folder: Path) -> None:
    assert new("task", "my_task") == 0
    task = load(str(folder / "my_task.py"))
    assert (task.name, task.__class__.__name__) == ("my_task", "MyTask")


def test_the_policy_reaches_a_place_in_the_world(folder: Path) -> None:
    """10 mm up in the world, in a frame that is turned and moved; the rows are steps of 1 mm."""
    assert new("policy", "mine") == 0
    policy = runpy.run_path(str(folder / "mine.py"))["Policy"]()
    X_WR = make_pose([0.3, -0.2, 0.1], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    spec = Spec(
        observation={"observation.state": Feature(names=tuple(f"PSM1/{n}" for n in STATE))},
        action=ActionSpec.of_space("absolute"),
    )
    p = begin = np.array([0.01, 0.02, 0.12])
    policy.reset("", 0)
    for step in range(30):
        state = np.array([*p - 0.003, 0.4, 0.5, *p, 0.4])  # the measured tip lags
        arrays = {"observation.state": state, "observation.rcm_frame": X_WR[None]}
        row = policy.act(Observation(arrays, step, 0, 1, "", spec))
        assert np.linalg.norm(row[:3] - p) <= 0.001 + 1e-12
        assert row[3:].tolist() == [0.4, 0.5]
        p = row[:3]
    reached = X_WR[:3, :3] @ p + X_WR[:3, 3]
    begun = X_WR[:3, :3] @ begin + X_WR[:3, 3]
    np.testing.assert_allclose(reached - begun, [0.0, 0.0, 0.01], atol=1e-9)


def test_the_guide_shows_the_policy_that_is_written() -> None:
    guide = (paths.ROOT / "docs" / "guide" / "policy_client.md").read_text("utf-8")
    written = (paths.ROOT / new_file.SOURCES["policy"][0]).read_text("utf-8")
    code = re.search(r"```python\n(import sys.*?)```", guide, re.DOTALL)
    assert code is not None and code.group(1) in written


def test_nothing_is_overwritten(folder: Path) -> None:
    (folder / "mine.py").write_text("kept", "utf-8")
    with pytest.raises(CliError, match=r"mine\.py is there already") as refused:
        new("policy", "mine")
    assert refused.value.code == 2
    assert (folder / "mine.py").read_text("utf-8") == "kept"


@pytest.mark.parametrize("name", ["two words", "../up", "7th", "class", ""])
def test_what_is_no_name_is_refused(folder: Path, name: str) -> None:
    with pytest.raises(CliError, match="letters, digits and _") as refused:
        new("task", name)
    assert refused.value.code == 2 and not list(folder.iterdir())
