"""The small pictures of a LeRobot dataset (v2.1), decoded once for all trainings that need them.

    python3 -m surg_learn.bgr.cache_pictures datasets/bgr views/bgr

`train_cloned.py` reads a dataset or such a folder. A folder needs numpy and nothing else to be
read, so that it can go to a machine without PyAV and pyarrow: one `.npy` of all pictures for each
eye, which trainings map into memory together, and one `.npz` without pickle of all tables.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surg_learn.bgr.keypoint_network import SIDE
from surg_learn.bgr.state_policy import ACTION, STATE
from surg_learn.bgr.train_images import check_size, views_of
from surg_learn.bgr.training.lerobot_dataset import (
    Array,
    Progress,
    facts,
    file_of,
    flat_names,
    split_episodes,
    table,
)

FORMAT = "surg_bgr_views/1"
LEFT, RIGHT = (f"observation.images.endoscope.{side}" for side in ("left", "right"))
PHASE = "annotation.human.action.subtask_description"
"""Column of a frame's phase: a place in `meta/tasks.jsonl`. It is the recording's stage: the
task's own, or what a person marked with `./surg episode label`."""
WHOLE = "annotation.human.action.task_description"
"""The same of the whole task; it stands where no phase is."""
NO_PHASE = -1


@dataclass
class Recorded:
    """All steps of all episodes, one after the other; N steps, E episodes.

    Attributes:
        state: (N, n) `observation.state`.
        action: (N, 5) absolute: tip [m], roll [rad], jaw [rad].
        phase: (N,) place in ``phases``; `NO_PHASE` where the recording states none.
        begins: (E + 1,) first step of each episode, then N.
        split: Of each episode.
        views: (N, SIDE, SIDE, 3), uint8, for each eye.
        names: Columns of state and action.
        phases: Sentences, in the order in which they first appear.
        about: Facts of the dataset.
    """

    state: Array
    action: Array
    phase: Array
    begins: Array
    split: list[str]
    views: dict[str, Array]
    names: dict[str, list[str]]
    phases: list[str]
    about: dict[str, Any]

    def episodes(self, split: str) -> list[slice]:
        """Steps of each episode of a split."""
        ends = zip(self.begins[:-1], self.begins[1:], self.split, strict=True)
        return [slice(int(begin), int(end)) for begin, end, of in ends if of == split]


def eyes_of(eyes: int) -> tuple[str, ...]:
    """Pictures of one eye or of both."""
    return (LEFT, RIGHT)[:eyes]


def recorded(
    folder: Path, pictures: Sequence[str], progress: Progress = lambda part, note: None
) -> Recorded:
    """What a dataset, or a folder of `save`, holds.

    Raises:
        ValueError: It is neither, or lacks a feature or the pictures of an eye.
    """
    if (folder / "views.json").exists():
        return load(folder, pictures)
    return read(folder, pictures, progress)


def read(
    folder: Path, pictures: Sequence[str], progress: Progress = lambda part, note: None
) -> Recorded:
    """Read a dataset, with its videos.

    Raises:
        ValueError: The folder is no dataset, or lacks a feature or a picture.
    """
    info = facts(folder, (STATE, ACTION, *pictures))
    for key in pictures:
        check_size(folder, key, info["features"][key]["shape"])
    named = [PHASE, WHOLE] if {PHASE, WHOLE} <= set(info["features"]) else []
    found = list(split_episodes(info))
    tables: list[list[Array]] = []
    views: dict[str, list[Array]] = {key: [] for key in pictures}
    for n, (_, index) in enumerate(found):
        progress(n / len(found), f"pictures of episode {n + 1} of {len(found)}")
        tables.append(table(folder, info, index, (STATE, ACTION, *named)))
        for key in pictures:
            views[key].append(views_of(file_of(folder, info, "video_path", index, video_key=key)))
            if len(views[key][-1]) != len(tables[-1][0]):
                raise ValueError(
                    f"{folder}: episode {index} has {len(views[key][-1])} pictures of {key} and "
                    f"{len(tables[-1][0])} rows"
                )
    if not found:
        raise ValueError(f"{folder}: the dataset has no episode")
    columns = [np.concatenate(part) for part in zip(*tables, strict=True)]
    phase, phases = np.full(len(columns[0]), NO_PHASE), list[str]()
    if named:
        phase, phases = numbered(columns[2].ravel(), columns[3].ravel(), sentences(folder))
    shape = info["features"][pictures[0]]["shape"]
    return Recorded(
        columns[0],
        columns[1],
        phase,
        np.cumsum([0, *(len(part[0]) for part in tables)]),
        [split for split, _ in found],
        {key: np.concatenate(part) for key, part in views.items()},
        {key: flat_names(info["features"][key]["names"]) for key in (STATE, ACTION)},
        phases,
        {"fps": info["fps"], "robot": info["robot_type"], "picture": shape},
    )


def sentences(folder: Path) -> dict[int, str]:
    """Those of `meta/tasks.jsonl`, by place.

    Raises:
        ValueError: The file is not there or cannot be read.
    """
    file = folder / "meta" / "tasks.jsonl"
    try:
        rows = [json.loads(line) for line in file.read_text("utf-8").splitlines() if line]
        return {int(row["task_index"]): str(row["task"]) for row in rows}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file}: no sentences of the phases ({error!r})") from None


def numbered(places: Array, whole: Array, said: dict[int, str]) -> tuple[Array, list[str]]:
    """Phases by the order of their first appearance, and their sentences.

    Args:
        places: (N,) in ``said``.
        whole: (N,) place of the whole task, which stands where no phase is.
        said: Sentences.
    """
    known = [int(p) for p, w in zip(places, whole, strict=True) if p != w]
    order = {place: n for n, place in enumerate(dict.fromkeys(known))}
    phase = [order[int(p)] if p != w else NO_PHASE for p, w in zip(places, whole, strict=True)]
    return np.array(phase), [said.get(place, str(place)) for place in order]


def save(found: Recorded, folder: Path) -> None:
    """Write a folder; whole or not at all.

    Raises:
        ValueError: It exists.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        for key, views in found.views.items():
            np.save(made / f"{key}.npy", views)
        arrays = ("state", "action", "phase", "begins")
        np.savez(made / "tables.npz", **{name: getattr(found, name) for name in arrays})
        head = {name: getattr(found, name) for name in ("split", "names", "phases", "about")}
        head |= {"format": FORMAT, "views": list(found.views)}
        (made / "views.json").write_text(json.dumps(head, indent=1) + "\n", "utf-8")
        made.chmod(0o755)
        os.rename(made, folder)
    except OSError as error:
        raise ValueError(f"{folder}: cannot be written ({error})") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def load(folder: Path, pictures: Sequence[str]) -> Recorded:
    """Read a folder of `save`; its pictures are mapped, not copied.

    Raises:
        ValueError: It is none, or lacks the pictures of an eye.
    """
    try:
        head = json.loads((folder / "views.json").read_text("utf-8"))
        if head.get("format") != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        missing = ", ".join(key for key in pictures if key not in head["views"])
        if missing:
            raise ValueError(f"it has no {missing}: make it with --eyes 2")
        with np.load(folder / "tables.npz", allow_pickle=False) as tables:
            arrays = {name: tables[name] for name in tables.files}
        views = {
            key: np.load(folder / f"{key}.npy", mmap_mode="r", allow_pickle=False)
            for key in pictures
        }
        shape = (len(arrays["state"]), SIDE, SIDE, 3)
        if any(each.shape != shape or each.dtype != np.uint8 for each in views.values()):
            raise ValueError(f"pictures of another shape than {shape}")
        return Recorded(
            **arrays, views=views, **{n: head[n] for n in ("split", "names", "phases", "about")}
        )
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{folder}: not usable as a folder of small pictures: {error}") from None


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for an unusable dataset."""
    parser = argparse.ArgumentParser(
        prog="cache_pictures", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("dataset", type=Path, help="folder written by ./surg episode export")
    parser.add_argument("out", type=Path, help="folder for the small pictures")
    parser.add_argument("--eyes", type=int, choices=(1, 2), default=1, help="left, or left + right")
    options = parser.parse_args(words)
    try:
        if options.out.exists():
            raise ValueError(f"{options.out} exists")
        found = read(options.dataset, eyes_of(options.eyes), lambda part, note: print(note))
        save(found, options.out)
    except ValueError as error:
        print(f"cache_pictures: {error}", file=sys.stderr)
        return 2
    print(f"{len(found.state)} steps of {len(found.split)} episodes, phases: {found.phases}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
