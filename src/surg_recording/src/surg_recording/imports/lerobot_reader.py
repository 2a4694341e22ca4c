"""Imports the episodes of LeRobot data sets.

Data sets of ``./surg episode export`` name their columns (``PSM1/tip_x``) and need nothing. For
others a map says which column is what (docs/reference/imports.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from surg_recording.imports.arm_series import ArmSeries, Picture, header, write
from surg_recording.imports.bag_map import FACTS, three
from surg_recording.imports.ledger import Ledger
from surg_recording.imports.lerobot_columns import ArmColumns, check_keys, columns_of
from surg_recording.imports.lerobot_set import LeRobotData
from surg_recording.imports.lerobot_times import row_times
from surg_recording.imports.picture_decoder import PictureDecoder, image_message
from surg_recording.recording_errors import EpisodeError

Array = npt.NDArray[np.float64]


def import_episode(
    data: LeRobotData,
    episode: int,
    folder: Path,
    stated: Mapping[str, Any] | None = None,
    ledger: Ledger | None = None,
) -> Path:
    """Write one episode of a data set as an episode folder; an EpisodeError says why not.

    Args:
        data: The data set.
        episode: Its number.
        folder: The new folder.
        stated: A map; None: the data set's names say which column is what.
        ledger: Receives what was kept and dropped.
    """
    stated, ledger = stated or {}, Ledger() if ledger is None else ledger
    check_keys("", stated, ("arms", *FACTS))
    table, where = data.table(episode), f"{data.root}, episode {episode}"
    times = row_times(table, data.fps, where, ledger)
    arms = [
        _series(table, each, times, stated, ledger) for each in columns_of(data, stated.get("arms"))
    ]
    cameras = _cameras(data.cameras)
    for camera in [name for name, feature in cameras.items() if feature in data.depth_maps]:
        del cameras[camera]  # since LeRobot 0.6; as a picture their logarithms would be wrong
        ledger.hold(camera, len(times))
        ledger.drop(camera, "depth maps, which are not imported", len(times))
    ledger.check()
    texts = data.instructions(table)
    different = list(dict.fromkeys(texts))
    success = None
    if "next.success" in table.column_names:
        last = _numbers(table, "next.success")[-1, 0]
        success = None if np.isnan(last) else bool(last)
    facts = {key: stated.get(key) for key in ("task", "operator") if stated.get(key)}
    instruction = stated.get("instruction") or "; ".join(different)
    run: dict[str, Any] = {
        "instruction": instruction,
        "setting": stated.get("setting"),
        "robot": arms[0].robot,
    }
    source = {"format": "lerobot", "from": str(data.root), "episode": episode}
    manifest: dict[str, Any] = {
        **facts,
        "run": {**run, **facts},
        "imported": {**source, "fps": str(data.fps)},
        "clock": "data set",
    }
    manifest.setdefault("task", instruction)
    stages: list[tuple[int, str]] = []
    if len(different) > 1:
        ledger.converted["instructions"] = f"{len(different)} of one episode to its stages"
        stages = [
            (int(stamp), text)
            for row, (stamp, text) in enumerate(zip(times, texts, strict=True))
            if row == 0 or text != texts[row - 1]
        ]
    pictures = _pictures(data, episode, cameras, times, table, ledger)
    return write(folder, arms, list(cameras), pictures, manifest, ledger, success, stages)


def _cameras(features: Sequence[str]) -> dict[str, str]:
    """Features by the camera's name, which is also that of a file."""
    cameras: dict[str, str] = {}
    for feature in features:
        plain = feature.removeprefix("observation.images.")
        name = re.sub(r"[^A-Za-z0-9_-]", "_", plain).strip("_") or "camera"
        if name in cameras:
            raise EpisodeError(f"the features {cameras[name]} and {feature} give the same name")
        cameras[name] = feature
    return cameras


def _pictures(
    data: LeRobotData,
    episode: int,
    cameras: Mapping[str, str],
    times: npt.NDArray[np.int64],
    table: Any,
    ledger: Ledger,
) -> Iterator[Picture]:
    named = "timestamp" in table.column_names
    seconds = _numbers(table, "timestamp" if named else "frame_index")[:, 0]
    seconds = seconds if named else seconds / float(data.fps)
    for camera, feature in cameras.items():
        decoder = PictureDecoder(camera, ledger)
        ledger.hold(camera, len(times))
        if data.features[feature]["dtype"] == "image":
            made = stored_pictures(data, table, feature, camera, ledger)
        else:
            shown = data.pictures(episode, feature, seconds, camera, ledger)
            made = ((row, image_message(image, rgb=True)) for row, image in shown)
        for row, message in made:
            message.header = header(int(times[row]))
            ready = decoder(message)
            if ready is not None:
                yield Picture(camera, ready, int(times[row]))


def stored_pictures(
    data: LeRobotData, table: Any, feature: str, camera: str, ledger: Ledger
) -> Iterator[tuple[int, SimpleNamespace]]:
    """Pictures in the table itself: compressed, or in a file of the data set beside it."""
    for row, stored in enumerate(table.column(feature).to_pylist()):
        content = (stored or {}).get("bytes")
        if content is None:
            path = Path(str((stored or {}).get("path") or ""))
            inside = not path.is_absolute() and ".." not in path.parts
            file = data.root / path
            content = file.read_bytes() if inside and file.is_file() else None
        if content is None:
            ledger.drop(camera, "rows without a picture")
            continue
        yield row, SimpleNamespace(format="", data=content)


def _series(
    table: Any,
    arm: ArmColumns,
    times: npt.NDArray[np.int64],
    stated: Mapping[str, Any],
    ledger: Ledger,
) -> ArmSeries:
    measured = _picked(table, *arm.measured)
    q = np.zeros((len(times), 0)) if arm.joints is None else _picked(table, *arm.joints)
    goal = measured if arm.goal is None else _held(_picked(table, *arm.goal), measured)
    stream = f"{arm.name} ({arm.measured[0]})"
    ledger.hold(stream, len(times))
    good = np.ones(len(times), bool)
    broken = ~np.isfinite(np.hstack([measured, q, goal])).all(axis=1)
    good = ledger.sieve(stream, broken, "rows with an empty value or one that is no number", good)
    times, measured, q, goal = times[good], measured[good], q[good], goal[good]
    about = (stated.get("arms") or {}).get(arm.name) or {}
    return ArmSeries(
        name=arm.name,
        stamps=times,
        p_BTip=measured[:, :3],
        roll=measured[:, 3],
        jaw=measured[:, 4],
        q=q,
        qd=np.gradient(q, times * 1e-9, axis=0) if q.size and len(q) > 1 else 0.0 * q,
        p_BGoal=goal[:, :3],
        roll_goal=goal[:, 3],
        jaw_goal=goal[:, 4],
        p_BRcm=np.array(three(about.get("rcm", [0, 0, 0]), f"--map, arms.{arm.name}.rcm")),
        rpy_BR=np.array(three(about.get("rcm_rpy", [0, 0, 0]), f"--map, arms.{arm.name}.rcm_rpy")),
        robot=str(about.get("robot", "unknown")),
        instrument=str(about.get("instrument", "unknown")),
    )


def _held(goal: Array, measured: Array) -> Array:
    """Commands in force at each frame: the action of frame k is that of frame k + 1."""
    held = np.vstack([goal[:1], goal[:-1]])
    return np.where(np.isnan(held), measured, held)


def _picked(table: Any, feature: str, columns: Sequence[int]) -> Array:
    """(N, columns) numbers; NaN for column -1 except roll and jaw, which are then 0."""
    values = _numbers(table, feature)
    picked = [values[:, i] if i >= 0 else np.zeros(len(values)) for i in columns]
    return np.column_stack(picked)


def _numbers(table: Any, name: str) -> Array:
    """A column as (N, D) float64; NaN where it is empty."""
    if name not in table.column_names:
        raise EpisodeError(f"the data set has no column {name}")
    values = table.column(name).to_pylist()
    full = next((value for value in values if value is not None), None)
    blank = [None] * len(full) if isinstance(full, list) else None
    filled = [blank if value is None else value for value in values]
    try:
        return np.array(filled, dtype=np.float64).reshape(len(values), -1)
    except (TypeError, ValueError) as problem:
        raise EpisodeError(f"column {name}: not numbers of one width ({problem})") from None
