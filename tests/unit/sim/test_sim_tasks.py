"""Tasks are found and fit their cells; one from outside the tree is as good as a bundled one."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import surg_core
from surg_cli.host import paths
from surg_description.make_cell import make_cell
from surg_sim import tasks
from surg_sim.envs.cell_session import CellSession
from surg_sim.envs.episode_runner import run_episode
from surg_sim.physics import cell_files
from surg_sim.physics.patient_settings import find_setting
from surg_sim.tasks import TaskError, episode_seeds
from surg_sim.tasks.bgr.bgr_definition import PHASES

EXAMPLE = paths.ROOT / "examples/04_task.py"


def test_unknown_task_lists_what_exists() -> None:
    with pytest.raises(TaskError, match="bgr, endoscope_guidance, needle_driving, pick_and_place"):
        tasks.load("knitting")
    with pytest.raises(TaskError, match="no such file"):
        tasks.load("/nowhere/task.py")


@pytest.mark.parametrize("name", tasks.names())
def test_bundled_tasks_load(name: str) -> None:
    task = tasks.load(name)
    assert task.name == name
    assert task.title and task.time_limit > 0.0
    language = task.language()
    assert len(language["stages"]) >= 2
    for sentence in (language["instruction"], *language["stages"].values()):
        assert sentence[0].isupper() and sentence.endswith(".")


def test_bgr_says_what_to_do_in_every_phase() -> None:
    assert list(tasks.load("bgr").stages) == list(PHASES[:-1])


def test_unknown_setting_law_and_cell_list_what_exists() -> None:
    cell = cell_files.find("sim_ur5e")
    with pytest.raises(ValueError, match="phantom, ex_vivo, in_vivo"):
        CellSession(cell, "pick_and_place", "mars")
    with pytest.raises(ValueError, match="ours, velocity, paper"):
        CellSession(cell, "pick_and_place", law="mine")
    with pytest.raises(ValueError, match=r"sim_two_arms.*sim_ur5e"):
        cell_files.find("sim_nothing")


def test_a_cell_that_does_not_fit_is_refused_with_the_reason() -> None:
    said = (
        r"needs PSM1 with an instrument and ECM with an endoscope; the cell 'sim_ur5e' has PSM1 "
        r"with grasper\. Take a cell such as cells/sim_two_arms, cells/sim_two_arms_panda$"
    )
    with pytest.raises(TaskError, match=said):
        CellSession(cell_files.find("sim_ur5e"), "endoscope_guidance")


def cell_of(folder: Path, arm: str, instrument: str) -> Path:
    """A cell with one arm."""
    description = paths.ROOT / "src/surg_description"
    instruments = description / "instruments" / f"{instrument}.yaml"
    return make_cell(description / "robots/ur5e.yaml", folder, instruments, arm=arm)


@pytest.mark.parametrize(
    ("task", "arm", "instrument", "said"),
    [
        ("bgr", "PSM1", "endoscope", "needs PSM1 with an instrument that has jaws; .* endoscope"),
        ("bgr", "PSM2", "grasper", "needs the arms PSM1; .* has PSM2 with grasper"),
        ("needle_driving", "PSM1", "endoscope", "needs PSM1 with an instrument that has jaws"),
        ("thread_in_hole", "PSM1", "endoscope", "needs PSM1 with an instrument that has jaws"),
        ("pick_and_place", "PSM1", "endoscope", "needs PSM1 with an instrument that has jaws"),
        ("pick_and_place", "ECM", "endoscope", "needs the arms PSM1; .* has ECM with endoscope"),
        ("endoscope_guidance", "ECM", "endoscope", "needs PSM1 with an instrument and ECM"),
    ],
)
def test_arms_and_instruments_that_a_task_needs(
    task: str, arm: str, instrument: str, said: str, tmp_path: Path
) -> None:
    cell = surg_core.load_cell(cell_of(tmp_path / "cell", arm, instrument))
    with pytest.raises(TaskError, match=said):
        tasks.load(task).prepare(cell, find_setting("phantom"))


def test_a_force_on_the_jaws_is_said_in_the_base_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = cell_of(tmp_path / "cell", "PSM1", "grasper")
    content = yaml.safe_load(file.read_text("utf-8"))
    content["arms"]["PSM1"]["base"]["rpy"] = [0.0, 0.0, 0.7]
    file.write_text(yaml.safe_dump(content), "utf-8")
    session = CellSession(file, "pick_and_place")
    assert session.world.tip_force("PSM1") is None, "this task does not say what the jaws feel"
    monkeypatch.setattr(session.task, "jaw_force", lambda arm: np.array([1.0, 2.0, 3.0]))
    c, s = np.cos(0.7), np.sin(0.7)
    expected = [c + 2.0 * s, -s + 2.0 * c, 3.0]
    assert np.allclose(session.world.tip_force("PSM1"), expected, atol=1e-12)


@pytest.mark.parametrize("name", tasks.names())
def test_the_cells_that_a_refusal_names_do_fit(name: str) -> None:
    task = tasks.load(name)
    assert task.home_cell in task.fitting_cells
    for cell in task.fitting_cells:
        tasks.load(name).prepare(
            surg_core.load_cell(cell_files.find(cell)), find_setting("phantom")
        )


BROKEN = {
    "empty": ("", "defines 0 tasks"),
    "wrong": ("import nothing_of_this_name", "ModuleNotFoundError"),
    "half": (
        "from surg_sim.tasks import Task\nclass Half(Task):\n    name = 'half'\n",
        "Half lacks title, time_limit, bind, reset, state, verdict",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_file_is_named_with_what_is_wrong(kind: str, tmp_path: Path) -> None:
    text, part = BROKEN[kind]
    file = tmp_path / f"{kind}.py"
    file.write_text(text)
    with pytest.raises(TaskError, match=part):
        tasks.load(str(file))


def test_a_task_from_outside_the_tree_runs_by_path(tmp_path: Path) -> None:
    """The story of docs/guide/adding_a_task.md."""
    file = tmp_path / "touch_task.py"
    shutil.copy(EXAMPLE, file)
    session = CellSession(cell_files.find("sim_ur5e"), str(file))
    done = [run_episode(session, seed) for seed in episode_seeds.test_seeds(3)]
    assert [report.success for report in done] == [True] * 3
    idle = run_episode(session, episode_seeds.TEST.start, experts={})
    assert (idle.success, idle.reason) == (False, "time limit of 5 s in phase 'reach'")


def test_a_task_of_an_installed_package_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(EXAMPLE, tmp_path / "somebodys_touch.py")
    info = tmp_path / "somebody-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: somebody\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[surg_sim.tasks]\ntouch = somebodys_touch:Touch\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        assert "touch" in tasks.names()
        assert tasks.load("touch").title == "Touch the ball"
    finally:
        sys.modules.pop("somebodys_touch", None)
    monkeypatch.undo()
    assert "touch" not in tasks.names()


def test_seeds_of_training_tuning_and_test_have_nothing_in_common() -> None:
    ranges = [
        set(found) for found in (episode_seeds.TRAINING, episode_seeds.TUNING, episode_seeds.TEST)
    ]
    assert len(set.union(*ranges)) == sum(map(len, ranges))
    assert list(episode_seeds.training_seeds(1)) == [episode_seeds.TRAINING[0]]
    assert list(episode_seeds.test_seeds(2)) == [episode_seeds.TEST[0], episode_seeds.TEST[1]]
    with pytest.raises(ValueError, match="1 to 1000"):
        episode_seeds.test_seeds(1001)


def test_a_task_changes_nothing_that_a_recompile_would_be_needed_for() -> None:
    """Names and shapes of a task's state are the same in every episode and at every time."""
    session = CellSession(cell_files.find("sim_ur5e"), "bgr")
    shapes = {key: np.shape(value) for key, value in session.task.state().items()}
    sizes = (session.world.model.nq, session.world.model.nv, session.world.model.ngeom)
    for seed in (1, 2):
        session.reset(seed)
        for _ in range(30):
            session.tick()
        assert {key: np.shape(value) for key, value in session.task.state().items()} == shapes
        model = session.world.model
        assert (model.nq, model.nv, model.ngeom) == sizes


def test_home_frame_is_what_homing_finds() -> None:
    """Senders compute the rcm frame from the cell; the controller measures it."""
    from surg_sim.tasks.scripted_sender import home_frame

    session = CellSession(cell_files.find("sim_ur5e"), "pick_and_place")
    session.tick()  # homing looks at a joint state that has come
    session.tick({"PSM1": [surg_core.StateCommand.HOME]})
    arm = session.cell.arms["PSM1"]
    X_WR = np.asarray(arm.X_WB) @ np.asarray(session.controllers["PSM1"].X_BR)
    assert np.abs(X_WR - home_frame(arm)).max() < 1e-4


@pytest.mark.parametrize(
    ("members", "named"),
    [
        ({"done": "yes"}, "done"),
        ({"done": True, "success": None}, "success"),
        ({"reason": None}, "reason"),
        ({"phase": 3}, "phase"),
        ({"reward": "0.5"}, "reward"),
        ({"reward": float("nan")}, "reward"),
        ({"success": True}, "success"),
    ],
)
def test_a_wrong_verdict_is_refused_where_it_is_made(members: dict[str, Any], named: str) -> None:
    with pytest.raises(TaskError, match=rf"Verdict\.{named} "):
        tasks.Verdict(**members)


def test_verdicts_may_hold_numpys_scalars() -> None:
    verdict = tasks.Verdict(done=np.bool_(True), success=np.bool_(True), reward=np.float32(1.0))
    assert verdict.success
