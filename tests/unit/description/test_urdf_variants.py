"""One verdict on a robot's files: for `robot check`, the controller's loader, simulator and pip."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import surg_core
from helpers.control import urdf_variants
from helpers.control.urdf_variants import Variant, write_cell
from surg_cli import command_table
from surg_cli.host.terminal import CliError
from surg_core.config import load_arm
from surg_sim.placement.chain_check import compare

COUNT, SEED = 60, 49


def by_pip(variant: Variant, _: Path) -> str:
    """What a pip user sees; empty: the arm is usable."""
    try:
        surg_core.load_chain(surg_core.load_robot(variant.robot))
    except surg_core.ConfigError as error:
        return str(error)
    return ""


def by_check(variant: Variant, _: Path) -> str:
    options, main = command_table.parse(*command_table.find(["robot", "check", str(variant.robot)]))
    try:
        return "not ready" if main(options, "check") else ""
    except CliError as error:
        return str(error)


def by_simulator(_: Variant, cell: Path) -> str:
    try:
        (arm,) = surg_core.load_cell(cell).arms.values()
        found = compare(arm, postures=10)
    except ValueError as error:
        return str(error)
    return "" if found.position < 1e-9 and found.angle < 1e-9 else str(found)


def by_controller(_: Variant, cell: Path) -> str:
    """The node's loader: `RcmLoop` calls it with cell and arm."""
    try:
        load_arm(str(cell), "")
    except surg_core.ConfigError as error:
        return str(error)
    return ""


ASKED: dict[str, Callable[[Variant, Path], str]] = {
    "pip": by_pip,
    "check": by_check,
    "simulator": by_simulator,
    "controller": by_controller,
}


def test_every_variant_has_one_verdict(tmp_path: Path) -> None:
    usable = dict.fromkeys(ASKED, 0)
    wrong = []
    for number, variant in enumerate(urdf_variants.draw(tmp_path, COUNT, SEED)):
        cell = write_cell(tmp_path / str(number), variant)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # what the simulator leaves out
            answers = {who: ask(variant, cell) for who, ask in ASKED.items()}
        for who, answer in answers.items():
            usable[who] += not answer
            if bool(answer) == variant.wanted:
                wrong.append((variant.changes, who, answer))
        if not variant.wanted:
            reason = answers["pip"]
            assert f"v{number}.urdf" in reason, reason
            for who, answer in answers.items():
                assert reason in answer, (who, answer, reason)
    print(f"{COUNT} variants, usable: {usable}")
    assert not wrong
    assert len(set(usable.values())) == 1
    assert 16 <= usable["pip"] <= 44
