"""Unsafe commands are found in the recording alone: each kind planted, one at a time."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surg_recording.episode import table_columns
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.metrics import unsafe_commands
from surg_recording.recording_errors import EpisodeError

N, JOINTS, TICK_NS = 600, 6, 2_000_000
LIMITS = {
    "tip_velocity": 0.25,
    "roll_velocity": 2.0,
    "cone": 1.0472,
    "depth_min": 0.02,
    "depth_max": 0.22,
    "step_slack": 0.002,
    "step_roll_slack": 0.0349,
    "step_dt_max": 0.1,
    "rcm_error_fault": 0.002,
}
JOINT = {
    "velocity": [3.0] * JOINTS,
    "acceleration": [40.0] * JOINTS,
    "position_min": [-6.0] * JOINTS,
    "position_max": [6.0] * JOINTS,
}
MANIFEST: dict[str, Any] = {
    "arms": ["PSM1"],
    "tables": {"cycle_PSM1": {}},
    "videos": {},
    "cell": {
        "arms": {
            "PSM1": {
                "limits": LIMITS,
                "robot": {"joints": JOINT},
                "instrument": {"jaw": {"min": 0.0, "max": 0.7}},
            }
        }
    },
}
# A base frame that stands askew, so that a frame that is mixed up is noticed.
AXIS = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
Q_BR = np.append(np.sin(0.4) * AXIS, np.cos(0.4))
P_RCM = np.array([0.3, -0.2, 0.1])


def turned(v: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of the rcm frame in the base."""
    u, w = Q_BR[:3], Q_BR[3]
    return v + 2.0 * np.cross(u, np.cross(u, v) + w * v)


def cycles() -> dict[str, np.ndarray]:
    """A calm motion inside every limit: a new goal on every 25th cycle."""
    k = np.arange(N)
    t = k * 0.002
    p = np.column_stack([0.02 * np.sin(t), 0.01 * t, 0.12 + 0.005 * t])
    goal = p[np.minimum(25 * (k // 25) + 25, N - 1)]
    found: dict[str, np.ndarray] = {name: np.zeros(N) for name in table_columns.cycle(JOINTS)}
    found["stamp_ns"] = found["receive_ns"] = (k + 1) * TICK_NS
    found["tick"] = k + 1
    for name, value in (("state", 1), ("homed", 1), ("command", 1)):
        found[name] = np.full(N, value)
    found["accepted"] = 1 + k // 25
    found["jaw_set"] = np.full(N, 0.3)
    for prefix, vectors in (("p_set", p), ("p_tip", p), ("p_goal", goal)):
        for i, axis in enumerate("xyz"):
            found[f"{prefix}_{axis}"] = (P_RCM + turned(vectors))[:, i]
    s = turned(p / np.linalg.norm(p, axis=1, keepdims=True))
    for i, axis in enumerate("xyz"):
        found[f"s_{axis}"], found[f"p_rcm_{axis}"] = s[:, i], np.full(N, P_RCM[i])
    for i, axis in enumerate("xyzw"):
        found[f"q_br_{axis}"] = np.full(N, Q_BR[i])
    for j in range(JOINTS):
        found[f"q{j}"] = np.sin(t)
        found[f"qd_command{j}"] = 0.5 * np.cos(t)
    return found


def episode(arrays: dict[str, np.ndarray], manifest: dict[str, Any] = MANIFEST) -> Episode:
    made = Episode(Path("made_up"), manifest)
    made._tables["cycle_PSM1"] = Table("cycle_PSM1", arrays)
    return made


def broken(found: list[unsafe_commands.Rule]) -> dict[str, int]:
    return {rule.name: rule.cycles for rule in found if rule.cycles}


def test_a_calm_motion_has_none() -> None:
    found = unsafe_commands.examine(episode(cycles()), "PSM1")
    assert broken(found) == {}
    print(f"{len(found)} rules over {N} cycles")
    assert len({rule.name for rule in found}) == len(found) == 13


def in_base(v: tuple[float, float, float]) -> np.ndarray:
    return turned(np.array([v]))[0]


def move(prefix: str, v: tuple[float, float, float], rows: Any) -> Callable[[dict[str, Any]], None]:
    def plant(arrays: dict[str, Any]) -> None:
        for i, axis in enumerate("xyz"):
            arrays[f"{prefix}_{axis}"][rows] += in_base(v)[i]

    return plant


def put(name: str, value: float, rows: Any) -> Callable[[dict[str, Any]], None]:
    def plant(arrays: dict[str, Any]) -> None:
        arrays[name][rows] = value

    return plant


PLANTED: dict[str, tuple[Callable[[dict[str, Any]], object], dict[str, int]]] = {
    # What is not finite counts as no velocity, and so as a jump to none and back.
    "not a number on the wire": (
        put("qd_command2", np.nan, 100),
        {"not finite": 1, "joint acceleration": 2},
    ),
    "infinity on the wire": (
        put("qd_command0", np.inf, [7, 8]),
        {"not finite": 2, "joint acceleration": 2},
    ),
    "a joint too fast": (
        put("qd_command1", 3.1, slice(200, 210)),
        {"joint velocity": 10, "joint acceleration": 2},
    ),
    "a joint commanded to jump": (put("qd_command1", 1.2, 300), {"joint acceleration": 2}),
    "a joint beyond its range": (put("q5", 6.01, 10), {"joint position, from the middle": 1}),
    "motion while disabled": (
        put("state", 0, slice(0, 50)),
        {"motion while not enabled": 50},
    ),
    "motion long after a fault": (
        put("state", 3, slice(400, 600)),
        {"motion while not enabled": 50},  # a ramp may last 150 cycles
    ),
    "a set-point that jumps": (
        move("p_set", (0.0, 0.0006, 0.0), slice(250, 600)),
        {"speed of the tip's set-point": 1},
    ),
    "a tip below what the shaft reaches": (
        lambda arrays: [
            move(prefix, (0.0, 0.0, 0.2), slice(0, 600))(arrays) for prefix in ("p_set", "p_goal")
        ],
        {"depth": 600},
    ),
    "a goal that is too far away": (
        move("p_goal", (0.02, 0.0, 0.0), slice(300, 600)),
        {"step of the tip's goal, beyond what is allowed": 1},
    ),
    "a goal in other units": (
        put("roll_goal", 90.0, slice(300, 600)),
        {"step of the roll's goal, beyond what is allowed": 1},
    ),
    "jaws beyond their range": (put("jaw_set", 0.71, slice(0, 5)), {"jaw beyond its range": 5}),
    "a shaft beside its pivot": (
        move("p_tip", (0.0021, 0.0, 0.0), slice(500, 520)),
        {"RCM deviation": 20},
    ),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_a_planted_one_is_found(kind: str) -> None:
    plant, expected = PLANTED[kind]
    arrays = cycles()
    plant(arrays)
    assert broken(unsafe_commands.examine(episode(arrays), "PSM1")) == expected


def test_the_first_and_the_worst_are_named() -> None:
    arrays = cycles()
    arrays["qd_command4"][[100, 101]] = [3.5, 4.0]
    rules = {rule.name: rule for rule in unsafe_commands.examine(episode(arrays), "PSM1")}
    fast = rules["joint velocity"]
    assert dataclasses.astuple(fast) == ("joint velocity", "rad/s", 2, 4.0, 3.0, 101 * TICK_NS)


@pytest.mark.parametrize(
    ("rule", "place"),
    [
        ("lean of the shaft", (0.12 * np.sin(1.06), 0.0, 0.12 * np.cos(1.06))),
        ("too shallow", (0.001, 0.0, 0.0195)),
    ],
)
def test_a_tip_that_stands_where_it_must_not(rule: str, place: tuple[float, ...]) -> None:
    arrays = cycles()
    there = P_RCM + turned(np.array([place]))[0]
    for i, axis in enumerate("xyz"):
        arrays[f"p_set_{axis}"][:] = arrays[f"p_goal_{axis}"][:] = there[i]
    assert broken(unsafe_commands.examine(episode(arrays), "PSM1")) == {rule: N}


def test_a_stream_that_begins_far_from_the_set_point() -> None:
    """The first goal after a pause is compared with where the set-point is."""
    arrays = cycles()
    arrays["command"][200:300] = 0
    far = move("p_goal", (0.01, 0.0, 0.0), slice(300, 600))
    far(arrays)
    assert broken(unsafe_commands.examine(episode(arrays), "PSM1")) == {
        "step of the tip's goal, beyond what is allowed": 1
    }


def test_what_the_controller_says_of_itself_is_not_read() -> None:
    arrays = cycles()
    for name in ("rcm_error", "depth", "v_set_x", "scale"):
        arrays[name][:] = 1e6
    assert broken(unsafe_commands.examine(episode(arrays), "PSM1")) == {}


@pytest.mark.parametrize("missing", ["arm", "limit", "joints"])
def test_limits_that_are_not_recorded_are_no_limits_that_are_met(missing: str) -> None:
    manifest = copy.deepcopy(MANIFEST)
    arm = manifest["cell"]["arms"]["PSM1"]
    if missing == "arm":
        manifest["cell"]["arms"] = {}
    elif missing == "limit":
        del arm["limits"]["cone"]
    else:
        del arm["robot"]["joints"]["velocity"]
    with pytest.raises(EpisodeError, match=r"manifest\.json"):
        unsafe_commands.examine(episode(cycles(), manifest), "PSM1")
