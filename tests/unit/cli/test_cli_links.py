"""A cell whose arm another link drives than the simulator: what `./surg up` starts and says."""

from __future__ import annotations

from pathlib import Path

import pytest

import surg_core
from helpers.graph.surg import printed
from surg_cli.commands import up
from surg_cli.graph import system
from surg_cli.graph.system_plan import SystemPlan
from surg_cli.host import cells, paths
from surg_cli.host.terminal import CliError
from surg_description.make_cell import make_cell

DESCRIPTION = paths.ROOT / "src" / "surg_description"
LINK = "format: surg_link/1\nname: bench\nlink_timeout: 0.04\nlink_lag: 0.0085\nacceleration: 0.5\n"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """The folder of a cell whose one arm is driven by bench.yaml."""
    robot = DESCRIPTION / "robots" / "ur5e.yaml"
    file = make_cell(robot, tmp_path / "cell", DESCRIPTION / "instruments" / "grasper.yaml")
    (file.parent / "bench.yaml").write_text(LINK, "utf-8")
    file.write_text(file.read_text("utf-8").replace("link: simulator", "link: bench.yaml"))
    return file.parent


def plan(cell: Path, simulated: tuple[str, ...]) -> SystemPlan:
    return SystemPlan(cell, ("PSM1",), False, (), cell / "out", simulated=simulated)


def test_the_simulator_starts_only_for_the_arms_that_it_drives(cell: Path) -> None:
    assert "/sim" not in [node.name for node in system.nodes(plan(cell, ()))]
    (sim,) = [node for node in system.nodes(plan(cell, ("PSM1",))) if node.name == "/sim"]
    assert sim.params["arms"] == ["PSM1"]


def test_up_prints_no_simulator_for_such_a_cell(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = "\n".join(printed(capsys, cell))
    assert "surg_control/RcmNodelet" in lines
    assert "bridge_node.py" not in lines and "endoscope" not in lines
    with pytest.raises(CliError, match="--lock-step"):
        printed(capsys, cell, "--lock-step")


def test_the_links_own_parameters_are_in_force(cell: Path) -> None:
    arm = surg_core.load_cell(cell).arms["PSM1"]
    simulated = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e").arms["PSM1"]
    assert (arm.robot.tuning.link_timeout, arm.robot.tuning.link_lag) == (0.04, 0.0085)
    assert (simulated.robot.tuning.link_timeout, simulated.robot.tuning.link_lag) == (0.1, 0.012)
    assert list(arm.robot.acceleration) == [20.0] * 6
    assert list(simulated.robot.acceleration) == [40.0] * 6


def test_a_link_that_is_not_there_is_named_with_where_it_was_looked_for(cell: Path) -> None:
    (cell / "bench.yaml").unlink()
    with pytest.raises(surg_core.ConfigError) as caught:
        surg_core.load_cell(cell)
    for part in ("cell.yaml", "arms.PSM1.link", "'bench.yaml'", str(cell / "bench.yaml")):
        assert part in str(caught.value)


def test_what_nobody_measured_is_said(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arms = cells.load(cell).arms
    assert arms["PSM1"].tool.source == "computed"
    up.describe_arms(arms)
    said = capsys.readouterr()
    assert "bench.yaml" in said.out
    assert (said.out + said.err).count("computed, not measured") == 2
