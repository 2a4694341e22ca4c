"""One verdict on a robot's files: for `robot check`, the controller's loader, simulator and pip."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

import surg_core
from helpers.control import urdf_variants
from helpers.control.urdf_variants import CHANGES, DESCRIPTION, Variant, write_cell
from surg_cli import command_table
from surg_cli.host.terminal import CliError
from surg_core.config import load_arm
from surg_description.make_cell import make_cell
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


KINDS = ("fixed", "revolute", "continuous", "prismatic")


@pytest.mark.parametrize("number", range(12))
def test_whatever_stands_below_the_base_is_the_simulators_too(number: int, tmp_path: Path) -> None:
    draws, kind = random.Random(number), KINDS[number % len(KINDS)]
    place = " ".join(f"{draws.uniform(-1.5, 1.5):.3f}" for _ in range(3))
    turn = " ".join(f"{draws.uniform(-3.1, 3.1):.3f}" for _ in range(3))
    name, robot = f"below {number}", draws.choice(["ur5e", "panda", "xarm7"])
    make = urdf_variants.standing("stand", kind, f'<origin xyz="{place}" rpy="{turn}"/>')
    document = yaml.safe_load((DESCRIPTION / "robots" / f"{robot}.yaml").read_text("utf-8"))
    text = (DESCRIPTION / "robots" / document["urdf"]).resolve().read_text("utf-8")
    text = make(text.replace(f'"{document["base_link"]}"', '"base_link"'), "")
    (tmp_path / f"{name}.urdf").write_text(text)
    document |= {"urdf": f"{name}.urdf", "base_link": "base_link"}
    (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(document))
    instrument = DESCRIPTION / "instruments" / "grasper.yaml"
    cell = make_cell(tmp_path / f"{name}.yaml", tmp_path / "cell", instrument)
    found = compare(surg_core.load_cell(cell).arms["PSM1"], postures=50)
    assert found.position < 1e-9 and found.angle < 1e-9, (kind, place, turn)


IN_THE_CHAIN = ("root", "mujoco")
OF_ARMS = [
    "no range",
    "no speed",
    "no limits",
    "speed 0",
    "YAML",
    "endless",
    "slides",
    "an instrument's",
]
"""Changes that mean nothing to an instrument, by their part or words of theirs."""
OF_INSTRUMENTS = [
    name
    for name, change in CHANGES.items()
    if change.part not in IN_THE_CHAIN and not any(word in name for word in OF_ARMS)
]


@pytest.mark.parametrize("name", OF_INSTRUMENTS)
def test_an_instrument_is_read_as_a_robot_is_and_blamed_for_itself(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bundled = DESCRIPTION / "instruments" / "grasper.yaml"
    document = yaml.safe_load(bundled.read_text("utf-8"))
    text = (bundled.parent / document["urdf"]).resolve().read_text("utf-8")
    changed = CHANGES[name].make(text.replace('"mount"', '"base_link"'), "jaw")
    assert changed != text or name == "byte order mark"
    document |= {"urdf": "g.urdf", "mount_link": "base_link"}
    (tmp_path / "g.urdf").write_bytes(changed.encode(CHANGES[name].encoding))
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(document))
    words = ["robot", "check", "ur5e", "--instrument", str(tmp_path / "g.yaml")]
    options, main = command_table.parse(*command_table.find(words))
    if CHANGES[name].usable:
        assert main(options, "check") == 0
        assert "ready" in capsys.readouterr().out
        return
    with pytest.raises(CliError) as refused:
        main(options, "check")
    said = str(refused.value)
    assert refused.value.code == 2 and "\n" not in said
    assert str(tmp_path / "g.urdf") in said and "ur5e.urdf" not in said, said
