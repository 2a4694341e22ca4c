"""Fixtures in cell.yaml: what is allowed, and errors that name file, key, value."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import surg_core
from surg_cli.host import paths

CELL = paths.ROOT / "cells" / "sim_ur5e" / "cell.yaml"
BALL = {
    "shape": "sphere",
    "side": "keep_out",
    "of": "tip",
    "point": [0.4, 0.1, 0.1],
    "radius": 0.01,
}
KEY = "arms.PSM1.fixtures.ball"


def arm_with(tmp_path: Path, fixtures: dict[str, object]) -> tuple[surg_core.Fixture, ...]:
    """The fixtures of a cell that states these."""
    cell = yaml.safe_load(CELL.read_text())
    cell["arms"]["PSM1"]["fixtures"] = fixtures
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(cell, sort_keys=False))
    document = surg_core.config.read_document(file)
    return tuple(surg_core._core.parse_cell(document).arms[0].fixtures)


def test_each_shape_is_read(tmp_path: Path) -> None:
    plane = {"shape": "plane", "side": "stay_in", "of": "tip"}
    plane |= {"point": [0.0, 0.0, 0.1], "normal": [0.0, 0.0, 1.0]}
    capsule = BALL | {"shape": "capsule", "of": "shaft", "end": [0.4, 0.2, 0.1]}
    read = arm_with(tmp_path, {"ball": BALL, "floor": plane, "vessel": capsule})
    assert [(f.name, f.shape, f.side, f.of, f.of_cell) for f in read] == [
        ("ball", "sphere", "keep_out", "tip", True),
        ("floor", "plane", "stay_in", "tip", True),
        ("vessel", "capsule", "keep_out", "shaft", True),
    ]
    assert read[2].axis == pytest.approx([0.0, 0.1, 0.0])


@pytest.mark.parametrize(
    ("change", "key", "part"),
    [
        ({"radius": 0.0}, ".radius", "allowed is 0.001 to 1 m"),
        ({"radius": 0.002, "side": "stay_in"}, ".radius", "allowed is 0.005 to 1 m"),
        ({"shape": "cube"}, ".shape", "'plane', 'sphere', 'capsule'"),
        ({"side": "out"}, ".side", "'keep_out', 'stay_in'"),
        ({"of": "shaft", "side": "stay_in"}, "", "keep_out"),
        ({"point": [0.0, 0.0, 9.0]}, ".point", "allowed is -3 to 3 m"),
        ({"shape": "plane", "normal": [0.0, 0.0, 0.5]}, "", "unit vector"),
        ({"radius": None}, ".radius", "is empty"),
        ({"colour": "red"}, ".colour", "is not a known key"),
    ],
)
def test_an_error_names_file_key_and_what_is_allowed(
    tmp_path: Path, change: dict[str, object], key: str, part: str
) -> None:
    wrong = BALL | change
    if change.get("shape") == "plane":
        del wrong["radius"]
    with pytest.raises(surg_core.ConfigError) as caught:
        arm_with(tmp_path, {"ball": wrong})
    text = str(caught.value)
    assert str(tmp_path / "cell.yaml") in text
    assert f"{KEY}{key}: " in text
    assert part in text


def test_at_most_sixteen(tmp_path: Path) -> None:
    names = [f"ball_{i}" for i in range(17)]
    assert len(arm_with(tmp_path, dict.fromkeys(names[:16], BALL))) == 16
    with pytest.raises(surg_core.ConfigError, match="allowed are 16"):
        arm_with(tmp_path, dict.fromkeys(names, BALL))
