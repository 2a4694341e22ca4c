"""What a policy planned and saw, for an episode's page: places as shares of the left picture."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from surg_core import ConfigError
from surg_core.pictures.camera_model import lens_of
from surg_core.pictures.eye_projection import EyeProjection
from surg_core.pictures.plan_projection import plan_pixels, rcm_in_world
from surg_core.transforms import FloatArray
from surg_recording.calibration.calibration_record import endoscope_of
from surg_recording.episode.episode_reader import Episode
from surg_recording.episode.table import Table
from surg_recording.recording_errors import EpisodeError

TOPIC, CAMERA, LEFT = "/policy/plan", "endoscope_left", "endoscope.left"
STEPS = 16
"""Steps of a plan on the page: more than an observation's age lets an arm play."""
MAX_PLANS = 4000
MAX_MAPS = 800
"""Maps of attention on the page; of more every second, third, … plan has one."""
FRAME = (*(f"q_br_{axis}" for axis in "xyzw"), *(f"p_rcm_{axis}" for axis in "xyz"))
"""Columns of a cycle that tell where the rcm frame is."""
COUNTS = ("accepted", "clipped", "rejected", "late", "stale")


def collect(episode: Episode, origin: int, missing: list[str]) -> list[dict[str, Any]]:
    """The recorded plans in order; ``t`` [ns] since ``origin``. ``missing`` gets what lacks."""
    if TOPIC not in episode.topics:
        return []
    try:
        tables = [_table(episode, name) for name in episode.topics[TOPIC]]
        rows = [(table, row) for table in tables for row in range(len(table))]
        place = _Places.of(episode)
    except (EpisodeError, ConfigError) as problem:
        missing.append(f"no plan of the policy: {problem}")
        return []
    if isinstance(place, str):
        missing.append(f"the policy's plan has no place in the picture: {place}")
    if len(rows) > MAX_PLANS:
        missing.append(f"only {MAX_PLANS} of {len(rows)} plans are shown, the first ones")
    every = max(1, math.ceil(len(rows) / MAX_MAPS))
    plans = []
    for number, (table, row) in enumerate(rows[:MAX_PLANS]):
        ways = [] if isinstance(place, str) else place.ways(table, row)
        plans.append(_plan(table, row, origin, ways, number % every == 0))
    return sorted(plans, key=lambda plan: int(plan["t"]))


def _table(episode: Episode, name: str) -> Table:
    """A table of plans without the session's number, which may need all 64 bits."""
    stated = episode.manifest["tables"][name]["columns"]
    return episode.columns(name, [column for column in stated if column != "session"])


def _plan(table: Table, row: int, origin: int, ways: list[Any], with_map: bool) -> dict[str, Any]:
    """One plan for the page."""
    value = _Row(table, row)
    here = value.text("picture") == "" or value.text("picture").endswith(LEFT)
    points = [
        [value.text(f"keypoints_{i}"), *(round(value.number(f"{n}_{i}"), 4) for n in "xy"),
         round(value.number(f"certainty_{i}"), 3)]
        for i in range(value.count("keypoints") if here else 0)
    ]  # fmt: skip
    sure = value.number("confidence")
    return {
        "t": int(table["stamp_ns"][row]) - origin,
        "ways": ways,
        "points": points,
        "map": _map(value) if here and with_map else None,
        "phase": value.text("phase"),
        "confidence": round(sure, 3) if math.isfinite(sure) else None,
        "counts": {name: value.whole(name) for name in COUNTS},
        "rule": value.text("rule"),
        "text": value.text("text"),
    }


def _map(value: _Row) -> dict[str, Any] | None:
    rows, columns = value.whole("map_rows"), value.whole("map_columns")
    try:
        data = bytes.fromhex(value.text("attention"))
    except ValueError:
        return None
    if not data or len(data) != rows * columns:
        return None
    area = [round(value.number(f"area_{i}"), 4) for i in range(4)]
    return {
        "rows": rows, "columns": columns, "area": area, "data": base64.b64encode(data).decode(),
    }  # fmt: skip


class _Row:
    """One message of a topic's table; what the table lacks is empty."""

    def __init__(self, table: Table, row: int) -> None:
        self._table, self._row = table, row

    def text(self, name: str) -> str:
        return str(self._table[name][self._row] or "") if name in self._table else ""

    def number(self, name: str) -> float:
        if name not in self._table:
            return math.nan
        try:
            return float(self._table[name][self._row])
        except (TypeError, ValueError):
            return math.nan

    def whole(self, name: str) -> int:
        number = self.number(name)
        return int(number) if math.isfinite(number) else 0

    def count(self, name: str) -> int:
        """Length of an array."""
        return self.whole(f"{name}.length")


class _Places:
    """Where recorded plans are in the left picture."""

    def __init__(self, episode: Episode, eye: EyeProjection, held: Any, bases: Mapping[str, Any]):
        self._eye, self._size = eye, np.array(eye.size)
        self._bases = {arm: np.array(X) for arm, X in bases.items()}
        joints = [f"q{i}" for i in range(len(held.chain.joints))]
        scope = episode.columns(f"cycle_{held.arm}", joints)
        self._held, self._scope = held, scope["stamp_ns"]
        self._q = np.stack([scope[joint] for joint in joints], axis=1)
        self._arms = {arm: episode.columns(f"cycle_{arm}", FRAME) for arm in episode.arms}

    @classmethod
    def of(cls, episode: Episode) -> _Places | str:
        """For an episode, or why there is none.

        Raises:
            EpisodeError, ConfigError: Something recorded is broken.
        """
        held = endoscope_of(episode.folder, episode.manifest)
        if held is None:
            return "no arm holds the endoscope"
        if held.arm not in episode.arms:
            return f"{held.arm}, which holds the endoscope, was not recorded"
        model = (episode.manifest.get("camera_info") or {}).get(CAMERA)
        if model is None:
            return "the endoscope's lens was not recorded"
        where = f"{episode.folder}: camera_info.{CAMERA}"
        eye = EyeProjection(lens_of(where, CAMERA, model), np.eye(4))
        bases = episode.manifest["cell"]["endoscope"].get("bases") or {}
        return cls(episode, eye, held, bases)

    def ways(self, table: Table, row: int) -> list[list[list[float] | None]]:
        """The planned way of each arm: shares of the picture, None where it is not seen."""
        value = _Row(table, row)
        names = [value.text(f"names_{i}") for i in range(value.count("names"))]
        steps = min(value.whole("rows"), STEPS)
        stamp = int(table["stamp_ns"][row])
        X_WV = self._held.poses(self._q[_at(self._scope, stamp)][None])[0]
        found = []
        for arm in dict.fromkeys(name.rpartition("/")[0] for name in names):
            columns = [f"{arm}/{axis}" for axis in "xyz"]
            if not steps or not set(columns) <= set(names) or arm not in self._bases:
                continue
            at = [names.index(column) for column in columns]
            p_R = np.array(
                [[value.number(f"values_{n * len(names) + i}") for i in at] for n in range(steps)]
            )
            shares = (plan_pixels(p_R, self._frame(arm, stamp), X_WV, self._eye) + 0.5) / self._size
            found.append([_place(share) for share in shares])
        return found

    def _frame(self, arm: str, stamp: int) -> FloatArray:
        """X_WR (4, 4) of an arm at a time."""
        cycle = self._arms[arm]
        row = _at(cycle["stamp_ns"], stamp)
        numbers = [float(cycle[column][row]) for column in FRAME]
        return rcm_in_world(self._bases[arm], numbers[:4], numbers[4:])


def _at(stamps: Any, stamp: int) -> int:
    return max(int(np.searchsorted(stamps, stamp, side="right")) - 1, 0)


def _place(share: FloatArray) -> list[float] | None:
    return np.round(share, 4).tolist() if np.isfinite(share).all() else None
