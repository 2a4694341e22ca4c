"""`./surg demo --cell`: which cells it plays, and what it refuses before anything starts."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import pytest
import yaml

import surg_core
from helpers.hardware.emulated_cell import emulated_cell
from surg_cli.graph import motion_run
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import cells, link_environments
from surg_cli.host.terminal import CliError
from surg_cli.robots import emulated_arms
from surg_msgs.msg import SimStatus

Surg = Callable[..., int]
LIVES = ("DISABLED", "DISABLED", "ENABLED", "DISABLED", "DISABLED")
"""States of an arm that is homed, and stopped after it; none is heard at first."""


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[SystemPlan]:
    """Plans that would have been played."""
    plans: list[SystemPlan] = []

    def play(plan: SystemPlan, duration_s: float, robots: object) -> list[str]:
        plans.append(plan)
        raise CliError("enough", 1)

    monkeypatch.setattr(motion_run, "play", play)
    monkeypatch.setattr(link_environments, "make_ready", lambda arm: None)
    return plans


@pytest.mark.parametrize(
    "name", ["emulated_ur5e", "emulated_ur5e_wrist", "emulated_panda", "emulated_fr3"]
)
def test_an_emulated_arm_is_played_in_real_time_without_the_simulator(
    name: str, surg: Surg, played: list[SystemPlan], tmp_path: Path
) -> None:
    with pytest.raises(CliError, match="enough"):
        surg("demo", "--robot", name, "--out", tmp_path / "run")
    (plan,) = played
    assert plan.cell == cells.find(name) and plan.driven == ("PSM1",)
    assert not plan.simulates and not plan.lockstep and not plan.cameras
    assert plan.operator is not None and plan.operator["lockstep"] is False
    assert plan.run_info["timing"] == "freerun"


def test_a_cell_of_the_simulator_is_played_in_lock_step(
    surg: Surg, played: list[SystemPlan], tmp_path: Path
) -> None:
    with pytest.raises(CliError, match="enough"):
        surg("demo", "--robot", "sim_panda", "--no-video", "--out", tmp_path / "run")
    (plan,) = played
    assert plan.simulates and plan.lockstep and plan.driven == ()


class Robots:
    """Counts how often they are asked to start."""

    asked = 0

    def ask_again(self) -> None:
        self.asked += 1


def test_a_robot_is_asked_to_start_anew_only_before_its_arm_is_homed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robots, shown = Robots(), Mock()
    watch = Mock(fault="", states={}, sim=SimStatus())
    look = iter(LIVES)

    def see(*_: object) -> list[str]:
        state = next(look, "")
        watch.states = {"PSM1": state}
        return [] if state else ["over"]

    monkeypatch.setattr(motion_run.follow, "failure", see)
    monkeypatch.setattr(motion_run.follow, "LOOK_S", 0.0)
    operator = Mock(exit_code=None)
    reasons = motion_run._follow(watch, Mock(), operator, shown, 1.0, False, robots)
    assert reasons == ["over"]
    assert robots.asked == 1 + LIVES.index("ENABLED")


@pytest.mark.parametrize(
    ("said", "quoted", "added"),
    [
        (["link", "overrun"], "the operator did not end", ["overrun"]),
        (["link"], "PSM1 is PAUSED: link", []),
        ([], "the operator did not end", []),
    ],
)
def test_a_failed_run_ends_with_what_the_arm_said_last_and_says_it_once(
    said: list[str], quoted: str, added: list[str]
) -> None:
    watch = Mock(**{"news.return_value": [("PSM1 error", text) for text in said]})
    assert motion_run._last_complaint(watch, [quoted]) == added


def real(folder: Path) -> Path:
    """The cell of a real arm that is being commissioned."""
    return emulated_cell(folder, "192.168.56.2", commissioning=True)


def by_hand(folder: Path) -> Path:
    """A cell whose link somebody starts by hand."""
    cell = emulated_cell(folder, "127.0.0.1")
    (cell / "own.yaml").write_text(
        "format: surg_link/1\nname: own\nlink_timeout: 0.1\nlink_lag: 0.01\nacceleration: 1\n"
    )
    file = cell / "cell.yaml"
    document = yaml.safe_load(file.read_text("utf-8"))
    document["arms"]["PSM1"].update(link="own.yaml")
    del document["arms"]["PSM1"]["hardware"]
    file.write_text(yaml.safe_dump(document), "utf-8")
    return cell


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--robot", "nothing"], "no cell 'nothing'"),
        (["--robot", "sim_two_arms"], "has 2"),
        (["--robot", real], "real arm at 192.168.56.2"),
        (["--robot", by_hand], "started by hand"),
    ],
)
def test_what_it_does_not_play_is_refused_and_leaves_nothing(
    words: list[object],
    said: str,
    surg: Surg,
    played: list[SystemPlan],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(os.environ, "DISPLAY", ":7")
    given = [word(tmp_path) if callable(word) else word for word in words]
    with pytest.raises(CliError) as refused:
        surg("demo", *given, "--out", tmp_path / "run")
    assert refused.value.code == 2 and said in str(refused.value) and not played
    assert not (tmp_path / "run").exists()


def test_an_arm_that_nothing_emulates_is_refused(tmp_path: Path) -> None:
    arms = surg_core.load_cell(emulated_cell(tmp_path, "127.0.0.1")).arms
    emulated_arms.refuse_real(arms, "demo")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(CliError, match="'ur5e'"):
        patch.setattr(emulated_arms, "MODELS", {"fer": {"panda": "Panda"}})
        emulated_arms.refuse_real(arms, "demo")
