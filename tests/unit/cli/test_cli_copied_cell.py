"""A cell that was copied out of the checkout: refused with the cure, which works."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import surg_core
from surg_cli.host import cells, paths
from surg_cli.host.terminal import CliError


@pytest.mark.parametrize("name", ["sim_ur5e", "sim_two_arms_panda"])
def test_what_is_said_about_a_copied_cell_cures_it(name: str, tmp_path: Path) -> None:
    copied = shutil.copytree(paths.CELLS / name, tmp_path / "mine")
    file = copied / "cell.yaml"
    for _ in range(10):
        try:
            found = cells.load(copied)
            break
        except CliError as problem:
            said = re.search(
                r"cell\.yaml:(\d+): arms\.\w+\.(\w+): '(\S+)': .* absolute path: (/\S+)$",
                str(problem),
            )
            assert said, problem
            lines = file.read_text().splitlines()
            assert f"{said[2]}: {said[3]}" in lines[int(said[1]) - 1]
            file.write_text(file.read_text().replace(said[3], said[4]))
    ours = surg_core.load_cell(paths.CELLS / name)
    assert list(found.arms) == list(ours.arms)
    for arm in ours.arms:
        assert found.arms[arm].robot.file == ours.arms[arm].robot.file


def test_a_file_of_ones_own_that_is_not_there_is_named(tmp_path: Path) -> None:
    copied = shutil.copytree(paths.CELLS / "sim_ur5e", tmp_path / "mine")
    file = copied / "cell.yaml"
    robot = "../../src/surg_description/robots/ur5e.yaml"
    file.write_text(file.read_text().replace(robot, "robots/mine.yaml"))
    with pytest.raises(CliError, match=r"robots/mine\.yaml': there is no /.*absolute path$"):
        cells.load(copied)
