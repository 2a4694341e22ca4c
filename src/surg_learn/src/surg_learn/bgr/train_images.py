"""Trains the policy of `image_policy.py` on a LeRobot dataset (v2.1) with pictures.

    python3 -m surg_learn.bgr.train_images datasets/bgr --out weights.npz --seed 0

First the eye (`keypoint_training.py`, PyTorch), with labels from the simulator's truth. Then the
hand, as in `train_state.py`, in numpy, from what the trained eye says: it learns with the eye's
errors. It reads the left endoscope's video (PyAV). The policy reads no ground truth.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from surg_learn.bgr.image_policy import (
    DISTANCE,
    PICTURE,
    EyeAndHand,
    ImagePolicy,
    features,
    remembered,
)
from surg_learn.bgr.keypoint_network import Eye, small
from surg_learn.bgr.state_policy import ACTION, SET, STATE, TASK, Columns
from surg_learn.bgr.training.action_head import HandOptions, Samples, fit_hand, may_move
from surg_learn.bgr.training.keypoint_training import (
    DEVICES,
    EyeOptions,
    Labels,
    device_for,
    errors,
    labels,
    lens_of,
    plane_of,
    train_eye,
)
from surg_learn.bgr.training.lerobot_dataset import (
    Array,
    Dataset,
    Progress,
    facts,
    file_of,
    flat_names,
    jaw_range,
    last_commands,
    normalised,
    scales_of,
    split_episodes,
    table,
    targets_of,
    world_of,
)
from surg_learn.bgr.training.perceptron import mean_error, size_of
from surg_learn.bgr.training.trainer_options import brief_of, chosen, parser_of, trained

CAMERA = "observation.camera_pose"
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
SHUT = 0.1
"""Commanded jaws less open than this close on something [rad]."""


@dataclass(frozen=True)
class Options(HandOptions):
    """Training options of hand and eye."""

    steps: int = 10000
    noise: float = 0.3
    """Standard deviation of the noise on normalised inputs. What the eye says of pictures that it
    was trained on is better than what it says of others: with little noise the hand believes it."""
    device: str = "auto"
    """Where the eye is trained, see `keypoint_training.device_for`."""
    eye: EyeOptions = field(default_factory=EyeOptions)


@dataclass
class Episode:
    """One recording of T steps."""

    state: Array
    task: Array
    action: Array
    camera: Array
    """(T, 4, 4) pose of the left camera in the world."""
    views: Array
    """(T, SIDE, SIDE, 3), uint8, of `small`."""


def read(folder: Path, progress: Progress = lambda part, note: None) -> Dataset[Episode]:
    """Read the tables and the videos of a dataset.

    Raises:
        ValueError: The folder is no dataset, or a required feature is missing.
    """
    needed = (STATE, TASK, ACTION, CAMERA)
    info = facts(folder, (*needed, PICTURE))
    names = {name: flat_names(info["features"][name]["names"]) for name in needed}
    shape, K = info["features"][PICTURE]["shape"], intrinsics(folder)
    check_size(folder, PICTURE, shape)
    if shape[0] != K[3]:
        raise ValueError(
            f"{folder}: {PICTURE} has the shape {list(shape)} (meta/info.json), but the camera's "
            f"model is for a height of {K[3]:g} pixels (meta/calibration/index.json): export the "
            "recordings again, which scales both alike"
        )
    episodes: dict[str, list[Episode]] = {}
    found = list(split_episodes(info))
    for n, (split, index) in enumerate(found):
        progress(0.1 * n / len(found), f"pictures of episode {n + 1} of {len(found)}")
        state, task, action, camera = table(folder, info, index, needed)
        views = views_of(file_of(folder, info, "video_path", index, video_key=PICTURE))
        if len(views) != len(state):
            raise ValueError(
                f"{folder}: episode {index} has {len(views)} pictures and {len(state)} rows"
            )
        poses = matrices(camera, names[CAMERA])
        episodes.setdefault(split, []).append(Episode(state, task, action, poses, views))
    about = {"fps": info["fps"], "robot": info["robot_type"], "picture": shape, "K": K}
    return Dataset(episodes, names, about)


def check_size(folder: Path, key: str, shape: Sequence[int]) -> None:
    """Refuse pictures that the eye cannot take.

    Args:
        folder: Of the dataset.
        key: Of the pictures.
        shape: Height, width, 3 [px].

    Raises:
        ValueError: They do not fit.
    """
    try:
        small(np.zeros(shape, np.uint8))
    except ValueError as problem:
        where = f"{folder}: {key} has the shape {list(shape)} (meta/info.json)"
        raise ValueError(f"{where}; {problem}") from None


def intrinsics(folder: Path) -> list[float]:
    """Focal length, principal point right and down, and height of the left camera's pictures [px].

    Raises:
        ValueError: The dataset does not state them, or two cameras took its pictures.
    """
    file = folder / "meta" / "calibration" / "index.json"
    try:
        sets = json.loads(file.read_text("utf-8"))["sets"]
        models = [each["camera_info"]["endoscope_left"] for each in sets]
        found = [[m["K"][0], m["K"][2], m["K"][5], float(m["height"])] for m in models]
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise ValueError(f"{file}: no model of the left endoscope camera ({error!r})") from None
    if any(each != found[0] for each in found):
        raise ValueError(f"{file}: the pictures are of different cameras: {found}")
    return found[0]


def views_of(file: Path) -> Array:
    """All pictures of a video, scaled by `small`.

    Raises:
        ValueError: The video cannot be read.
    """
    try:
        import av
    except ImportError:
        raise ValueError("PyAV reads the videos: apt install python3-av") from None
    try:
        with av.open(str(file)) as container:
            shown = container.decode(video=0)
            return np.stack([small(frame.to_ndarray(format="rgb24")) for frame in shown])
    except (av.error.FFmpegError, IndexError) as problem:
        raise ValueError(f"{file}: no readable video ({problem})") from None


def matrices(poses: Array, names: Sequence[str]) -> Array:
    """Poses (T, 7) with columns x, y, z, qx, qy, qz, qw in the order of ``names``, as (T, 4, 4)."""
    order = [[name.rpartition("/")[2] for name in names].index(n) for n in POSE]
    x, y, z, w = poses[:, order[3:]].T
    found = np.zeros((len(poses), 4, 4))
    found[:, :3, 3], found[:, 3, 3] = poses[:, order[:3]], 1.0
    found[:, 0, :3] = np.column_stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]
    )
    found[:, 1, :3] = np.column_stack(
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]
    )
    found[:, 2, :3] = np.column_stack(
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
    )
    return found


def missed(jaw: Array) -> Array:
    """Steps that lead to a grasp that holds nothing, (T,): from open jaws to the closing.

    Jaws that close and open again have held nothing. How to aim is not learned from these steps.

    Args:
        jaw: (T,) commanded jaw angles [rad].
    """
    shut = jaw < SHUT
    closes = np.flatnonzero(shut[1:] & ~shut[:-1]) + 1
    found = np.zeros(len(jaw), bool)
    for begin, end in zip(closes, [*closes[1:], len(jaw)], strict=True):
        if not shut[begin:end].all():
            before = np.flatnonzero(shut[:begin])
            found[(before[-1] + 1 if len(before) else 0) : begin + 1] = True
    return found


def samples(
    episodes: Sequence[Episode],
    seen: Sequence[Array],
    columns: Columns,
    chunk: int,
    behind: int = 0,
) -> Samples:
    """The steps of all episodes, in order, but for those that lead to a miss.

    Args:
        episodes: Of the dataset.
        seen: (T, n) of `remembered`, for each episode.
        columns: Of the observations.
        chunk: Actions ahead.
        behind: Each step appears with its own observation and with each of the ``behind`` earlier
            ones. Last command and target are those of the step itself.
    """
    parts = []
    for episode, view in zip(episodes, seen, strict=True):
        last = last_commands(episode.state, episode.action, columns.state[SET])
        moved = np.diff(last, axis=0, prepend=last[:1])
        targets = targets_of(episode.action, last, chunk)
        good = ~missed(episode.action[:, 4])
        for steps in range(behind + 1):
            row = np.maximum(np.arange(len(last)) - steps, 0)
            state, task = episode.state[row], episode.task[row]
            inputs = features(columns.state, state, view[row], last, moved)
            jaw, held = state[:, columns.state[4]], task[:, columns.task["held"]].ravel()
            free = may_move(held, jaw, inputs[:, DISTANCE])
            parts.append((inputs[good], targets[good], free[good], jaw[good]))
    return Samples.joined(parts, places=DISTANCE)


def train(
    dataset: Dataset[Episode], options: Options, progress: Progress = lambda part, note: None
) -> ImagePolicy:
    """Train on the split ``train``: the eye, then the hand.

    Raises:
        ValueError: The split is empty, or the device is not there.
    """
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    shown = dataset.episodes.get("train")
    if not shown:
        raise ValueError("the dataset has no episode in its split 'train'")
    options = replace(options, device=device_for(options.device))
    marked = marks(dataset, columns)
    views = np.concatenate([episode.views for episode in shown])
    eye = train_eye(
        views,
        marked["train"],
        options.eye,
        options.seed,
        lambda part, note: progress(0.1 + 0.7 * part, note),
        device=options.device,
    )
    progress(0.8, "what the eye sees in all pictures")
    return train_hand(dataset, options, eye, marked, progress)


def marks(dataset: Dataset[Episode], columns: Columns) -> dict[str, Labels]:
    """Labels of all pictures of each split."""
    X_RW = world_of(dataset.episodes["train"], columns)
    found, names = {}, [each.name for each in fields(Labels)]
    for split, episodes in dataset.episodes.items():
        parts = [labels(e.task, columns.task, X_RW, e.camera, dataset.about["K"]) for e in episodes]
        found[split] = Labels(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))
    return found


def look(eye: Eye, views: Array) -> Array:
    """What the eye says of an episode's views, (T, SAID)."""
    parts = np.array_split(views, len(views) // 64 + 1)
    return np.concatenate([eye(part) for part in parts])


def train_hand(
    dataset: Dataset[Episode],
    options: Options,
    eye: Eye,
    marked: dict[str, Labels],
    progress: Progress = lambda part, note: None,
) -> ImagePolicy:
    """Train the hand with a trained eye; see `train`."""
    columns = Columns(dataset.names[STATE], dataset.names[TASK])
    tip = columns.state[:3]
    shown = dataset.episodes["train"]
    plane = plane_of(marked["train"])
    tips = np.concatenate([episode.state[:, tip] for episode in shown])
    lens = lens_of(tips, marked["train"].marks[:, 1])
    seen = {
        split: [remembered(look(eye, e.views), e.state[:, tip], plane, lens) for e in episodes]
        for split, episodes in dataset.episodes.items()
    }
    parts = {
        split: samples(episodes, seen[split], columns, options.chunk, options.behind)
        for split, episodes in dataset.episodes.items()
    }
    known = parts["train"]
    scales = {
        **scales_of(known.inputs, known.targets),
        "jaw_range": jaw_range(known.targets),
        "plane": plane,
        "lens": lens,
        "pointed": eye.pointed,
    }

    def show(part: float, note: str) -> None:
        progress(0.85 + 0.15 * part, f"hand, {note}")

    hand = fit_hand(known, scales, options, dataset.about["fps"], show)
    losses = {
        split: mean_error(hand, *normalised(scales, part.inputs, part.targets))
        for split, part in parts.items()
    }
    network = EyeAndHand([*eye.layers, *hand.layers], eye.pointed)
    about = {
        "options": asdict(options),
        "dataset": dataset.about,
        "episodes": {split: len(found) for split, found in dataset.episodes.items()},
        "frames": sum(len(episode.state) for episode in dataset.episodes["train"]),
        "parameters": size_of(network),
        "network": "an eye of convolutions and a hand of a multilayer perceptron",
        "loss": losses,
        "eye": {
            split: errors(np.concatenate(found), marked[split]) for split, found in seen.items()
        },
        "observation": [STATE, PICTURE],
        "privileged": [],
        "labels": [TASK],
    }
    return ImagePolicy(network, scales, dataset.names, options.chunk, about)


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns 0, or 2 for an unusable dataset."""
    parser = parser_of("train_images", (__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--device",
        choices=DEVICES,
        default=argparse.SUPPRESS,
        help=f"where it trains ({DEVICES[0]})",
    )
    given = parser.parse_args(words)

    def make(show: Progress) -> ImagePolicy:
        options = chosen(Options, given)
        if options.device != "auto":
            device_for(options.device)  # before minutes of reading
        return train(read(given.dataset, show), options, show)

    return trained(parser.prog, given, make, brief_of)


if __name__ == "__main__":
    sys.exit(main())
