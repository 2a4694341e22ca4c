"""Replays the actions of one recorded episode open loop.

The episode is part of a LeRobot dataset of `./surg episode export` (needs pyarrow), or a CSV file
with a header of action names, such as ``PSM1/x``, and one row per grid time.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from surg_policy_client.action_spec import CHANGES, ActionSpec
from surg_policy_client.errors import SpecMismatch
from surg_policy_client.observation import STATE, Observation
from surg_policy_client.policies.command_line import run
from surg_policy_client.spec import Feature, Spec

ROWS = 10


class Replay:
    """Sends row k for the k-th grid time after the first observation, and holds the last target.

    Columns are matched by name; a recording that lacks one is refused. The server is asked for the
    action space of the recording.

    Args:
        names: Of the columns.
        rows: [K, A].
    """

    def __init__(self, names: list[str], rows: np.ndarray) -> None:
        if rows.ndim != 2 or rows.shape[1] != len(names) or not len(rows):
            raise ValueError(f"{len(names)} names for an array {list(rows.shape)}")
        if not np.isfinite(rows).all():
            raise ValueError("the recording has actions that are no numbers")
        rest = rows[-1].copy()
        rest[[name.rpartition("/")[2] in CHANGES for name in names]] = 0.0
        self._names, self._rows = names, np.vstack([rows, rest])
        self.wants = Spec(observation={STATE: Feature()}, action=_action(names))
        self._begun: int | None = None

    def reset(self, instruction: str, seed: int | None) -> None:
        """A new episode: from the first row again."""
        self._begun = None

    def act(self, observation: Observation) -> np.ndarray:
        """The next rows of the recording."""
        action = observation.spec.action
        assert action is not None  # of every server
        missing = [name for name in action.names if name not in self._names]
        if missing:
            raise SpecMismatch(
                f"the recording has no {', '.join(missing)}; it has {', '.join(self._names)}"
            )
        columns = [self._names.index(name) for name in action.names]
        self._begun = observation.step if self._begun is None else self._begun
        steps = observation.step - self._begun + np.arange(ROWS)
        return self._rows[np.minimum(steps, len(self._rows) - 1)][:, columns]


def load(path: Path, index: int = 0) -> Replay:
    """The policy of a CSV file, or of an episode in the folder of a LeRobot dataset (2.1 or 3.0).

    Raises:
        ValueError: There is no such episode, or it is invalid.
    """
    if path.is_dir():
        return _of_dataset(path, index)
    with path.open(encoding="utf-8", newline="") as stream:
        names, *lines = csv.reader(stream)
    try:
        rows = np.array([[float(cell) for cell in line] for line in lines])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Replay(names, rows)


def _of_dataset(root: Path, index: int) -> Replay:
    try:
        from pyarrow import parquet
    except ImportError:
        raise ValueError("a LeRobot dataset is read with pyarrow: pip install pyarrow") from None
    info = root / "meta" / "info.json"
    if not info.is_file():
        raise ValueError(f"{root} is no LeRobot dataset: it has no meta/info.json")
    feature: dict[str, Any] = json.loads(info.read_text("utf-8"))["features"]["action"]
    for file in sorted(root.glob("data/**/*.parquet")):
        table = parquet.read_table(file, columns=["episode_index", "frame_index", "action"])
        here = np.flatnonzero(table["episode_index"].to_numpy() == index)
        if len(here):
            order = here[np.argsort(table["frame_index"].to_numpy()[here], kind="stable")]
            rows = np.array(table["action"].to_pylist(), dtype=np.float64)[order]
            return Replay(_flat(feature["names"]), rows)
    raise ValueError(f"{root} has no episode {index}")


def _action(names: list[str]) -> ActionSpec | None:
    """The actions of the space of which the recording has all columns; None: none of them."""
    found = ActionSpec.among(names)
    return found[1] if found is not None and found[0] != "absolute" else None


def _flat(names: Any) -> list[str]:
    """Names of a feature: a list, or (as some write them) a map with one list."""
    if isinstance(names, dict):
        (names,) = names.values()
    return [str(name) for name in names]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is replayed."""
    parser.add_argument("episode", type=Path, help="CSV file or folder of a LeRobot dataset")
    parser.add_argument("--index", type=int, default=0, help="episode of the dataset (default 0)")


if __name__ == "__main__":
    sys.exit(run(lambda options: load(options.episode, options.index), __doc__, add_arguments))
