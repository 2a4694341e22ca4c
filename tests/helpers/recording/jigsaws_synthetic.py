"""A made-up task folder in the format of JIGSAWS: no sample of the real dataset is in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

FS = 30.0
SCORES = "{name}\t\t{skill}\t{score}\t{elements}"


def motion(seed: int, seconds: float, tremor: float = 0.2e-3) -> np.ndarray:
    """(N, 3) tip path [m]: a few slow waves and some tremor."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * FS)) / FS
    waves = [
        0.01 * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6.28, 3))
        for f in rng.uniform(0.1, 1.0, 4)
    ]
    return np.sum(waves, axis=0) + tremor * rng.normal(size=(len(t), 3))


def samples(seed: int, seconds: float) -> np.ndarray:
    """(N, 76) numbers of a trial; each manipulator moves in its own way."""
    parts = []
    for k in range(4):
        p = motion(10 * seed + k, seconds)
        n = len(p)
        angle = np.linspace(0, 0.5, n)
        R = np.zeros((n, 3, 3))
        R[:, 0, 0] = R[:, 1, 1] = np.cos(angle)
        R[:, 1, 0], R[:, 0, 1], R[:, 2, 2] = np.sin(angle), -np.sin(angle), 1.0
        v = np.gradient(p, 1 / FS, axis=0)
        w = np.tile([0.0, 0.0, 0.5 * FS / n], (n, 1))
        gripper = np.full((n, 1), -0.4 + 0.1 * k)
        parts.append(np.hstack([p, R.reshape(n, 9), v, w, gripper]))
    return np.hstack(parts)


def write_trial(file: Path, values: np.ndarray) -> Path:
    """One trial file, laid out with the dataset's runs of blanks."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join("".join(f"   {v:.6f}" for v in row) + " \n" for row in values))
    return file


def write_task(
    root: Path,
    skills: Mapping[str, str],
    task: str = "Knot_Tying",
    seconds: float = 12.0,
) -> Path:
    """A task's folder with these trials (``B001``: skill N, I or E); returns it."""
    folder = root / task
    lines = []
    for i, (name, skill) in enumerate(skills.items()):
        whole = f"{task}_{name}"
        file = folder / "kinematics" / "AllGestures" / f"{whole}.txt"
        write_trial(file, samples(i + 1, seconds + i))
        elements = "\t".join(["2"] * 6)
        lines.append(SCORES.format(name=whole, skill=skill, score=12, elements=elements))
    (folder / f"meta_file_{task}.txt").write_text("\n".join(lines) + "\n\n")
    return folder
