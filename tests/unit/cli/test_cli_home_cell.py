"""`./surg run TASK` without --robot takes the cell that the task names."""

from __future__ import annotations

from pathlib import Path

import pytest

from surg_cli.graph.episode_plans import cell_of
from surg_cli.host import paths
from surg_cli.host.terminal import CliError

PATIENT = paths.ROOT / "tests" / "helpers" / "sim" / "patient_task.py"


def test_the_home_cell_of_a_task_is_used(tmp_path: Path) -> None:
    assert cell_of(str(PATIENT), None).name == "sim_ur5e"
    assert cell_of("bgr", None).name == "sim_two_arms"
    lost = tmp_path / "lost_task.py"
    lost.write_text(PATIENT.read_text().replace('"sim_ur5e"', '"nowhere"'))
    with pytest.raises(CliError, match="home_cell"):
        cell_of(str(lost), None)
