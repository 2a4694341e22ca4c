"""Trains the policy of `image_policy.py` on a LeRobot dataset (v2.1) with pictures.

    python3 -m surg_learn.bgr.train_images datasets/bgr --out weights.npz --seed 0

First the eye (`keypoint_training.py`, PyTorch), with labels from the simulator's truth. Then the
hand, as in `train_state.py`, in numpy, from what the trained eye says: it learns with the eye's
errors. The policy reads no ground truth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np

from surg_learn.bgr.image_policy import (
    DISTANCE,
    PICTURE,
    EyeAndHand,
    ImagePolicy,
    features,
    remembered,
)
from surg_learn.bgr.keypoint_network import Eye
from surg_learn.bgr.observed_features import Columns, world_of
from surg_learn.bgr.training.action_head import HandOptions, Samples, hand_of
from surg_learn.bgr.training.keypoint_labels import Labels, labels, lens_of, plane_of
from surg_learn.bgr.training.keypoint_training import EyeOptions, errors, train_eye
from surg_learn.bgr.training.perceptron import size_of
from surg_learn.bgr.training.picture_dataset import Episode, read
from surg_learn.cloning.arm_columns import STATE, TASK, Array
from surg_learn.cloning.training.lerobot_dataset import Dataset, Progress
from surg_learn.cloning.training.recorded_steps import missed
from surg_learn.cloning.training.torch_device import DEVICES, device_for
from surg_learn.cloning.training.trainer_options import brief_of, chosen, parser_of, trained


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


def samples(
    episodes: Sequence[Episode],
    seen: Sequence[Array],
    columns: Columns,
    chunk: int,
    behind: int = 0,
) -> Samples:
    """The steps of all episodes but for those that lead to a miss, see `Samples.of`.

    Args:
        episodes: Of the dataset.
        seen: (T, n) of `remembered`, for each episode.
        columns: Of the observations.
        chunk: Actions ahead.
        behind: Of the observations.
    """

    def inputs(state: Array, view: Array, row: Array, last: Array) -> Array:
        moved = np.diff(last, axis=0, prepend=last[:1])
        return features(columns.state, state[row], view[row], last, moved)

    steps = [
        (episode, partial(inputs, episode.state, view), ~missed(episode.action[:, 4]))
        for episode, view in zip(episodes, seen, strict=True)
    ]
    return Samples.of(steps, columns, chunk, behind, DISTANCE)


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

    def show(part: float, note: str) -> None:
        progress(0.85 + 0.15 * part, f"hand, {note}")

    hand, scales, about = hand_of(parts, dataset, options, show)
    scales |= {"plane": plane, "lens": lens, "pointed": eye.pointed}
    network = EyeAndHand([*eye.layers, *hand.layers], eye.pointed)
    about |= {
        "parameters": size_of(network),
        "network": "an eye of convolutions and a hand of a multilayer perceptron",
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
