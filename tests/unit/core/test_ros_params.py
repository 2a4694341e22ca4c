"""Parameters of a node: every type, its range, and one error for whatever must not be used."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, dataclass
from pathlib import Path
from typing import Any

import pytest

from surg_ros import params


@dataclass(frozen=True)
class Settings:
    """One parameter of every type."""

    cell: str = params.text()
    note: str = params.text("", empty=True, longest=3)
    mode: str = params.one_of(("lockstep", "freerun"), "lockstep")
    view: bool = params.flag(False)
    port: int = params.whole(1, 65535, 80)
    rate: float = params.real(1.0, 240.0, 20.0)
    any_number: float = params.real(default=0.0)
    frame: tuple[float, ...] = params.vector(4, (0.0, 0.0, 0.0, 1.0), meaning="x, y, z, w")
    arms: tuple[str, ...] = params.names(("PSM1",), least=1)
    eyes: tuple[str, ...] = params.names((), options=("left", "right"), most=2)
    about: dict[str, Any] = params.dictionary()
    out: Path | None = params.path(None)
    lowest: int = params.whole(0, 9, 0)

    def __post_init__(self) -> None:
        if self.lowest > self.port:
            raise params.ParamError("lowest", self.lowest, f"at most ~port, {self.port}")


def read(**given: Any) -> Settings:
    return params.read(Settings, {"cell": "cells/sim_ur5e", **given})


def test_defaults_stand_where_nothing_is_given_and_nothing_changes_afterwards() -> None:
    settings = read()
    assert (settings.mode, settings.port, settings.arms, settings.about) == (
        "lockstep", 80, ("PSM1",), {},
    )  # fmt: skip
    with pytest.raises(FrozenInstanceError):
        settings.port = 81  # type: ignore[misc]
    assert read().about is not settings.about


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("arms", "PSM1, PSM2", ("PSM1", "PSM2")),
        ("arms", "[PSM1, 'PSM2']", ("PSM1", "PSM2")),
        ("arms", ["PSM1", "PSM2"], ("PSM1", "PSM2")),
        ("arms", "/PSM[12]", ("/PSM[12]",)),
        ("port", 65535.0, 65535),
        ("rate", 30, 30.0),
        ("about", '{"a": 1}', {"a": 1}),
        ("about", "", {}),
        ("out", "", None),
        ("out", "/runs/e", Path("/runs/e")),
        ("frame", [0, 0, 1, 0], (0.0, 0.0, 1.0, 0.0)),
    ],
)
def test_what_a_command_line_can_pass_is_understood(name: str, given: Any, expected: Any) -> None:
    found = getattr(read(**{name: given}), name)
    assert found == expected and type(found) is type(expected)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", ""), ("cell", 3), ("note", "four"), ("mode", "fast"), ("mode", ["lockstep"]),
        ("view", "yes"), ("view", 1), ("port", 0), ("port", 65536), ("port", True), ("port", "80"),
        ("port", 80.5), ("port", math.nan), ("port", math.inf), ("rate", 0.999), ("rate", True),
        ("rate", math.nan), ("any_number", math.inf), ("any_number", "1"), ("arms", []),
        ("arms", ["PSM1", "PSM1"]), ("arms", [1]), ("arms", 3), ("eyes", "middle"),
        ("frame", [0, 0, 0, 0]), ("frame", [0, 0, 1]), ("frame", "none"), ("frame", None),
        ("about", "[1]"), ("about", "{"), ("out", 3), ("lowest", 10), ("speed", 3),
    ],
)  # fmt: skip
def test_what_must_not_be_used_is_named_with_its_value(name: str, value: Any) -> None:
    with pytest.raises(params.ParamError) as caught:
        read(**{name: value})
    assert caught.value.name == name
    assert repr(caught.value.value) == repr(value)
    assert caught.value.allowed


def test_rules_between_parameters_raise_the_same_error() -> None:
    with pytest.raises(params.ParamError, match=r"~lowest is 9; allowed: at most ~port, 2"):
        read(lowest=9, port=2)


def test_a_missing_parameter_is_named() -> None:
    with pytest.raises(params.ParamError) as caught:
        params.read(Settings, {})
    assert (caught.value.name, caught.value.value) == ("cell", None)


def test_an_unknown_parameter_lists_those_there_are_and_namespaces_are_others() -> None:
    with pytest.raises(params.ParamError) as caught:
        read(modes="freerun")
    assert all(f"~{name}" in caught.value.allowed for name in ("cell", "mode", "lowest"))
    assert read(left={"compressed": {"quality": 80}}).cell
