"""What lerobot-doctor and lerobot-lint say of LeRobot 2.1 sets, in an environment of their own.

Usage: ``python set_checkers.py FOLDER``: per data set in the folder a JSON line with, per program,
the warnings and the errors. Numbers are left out of the words, so that those of two sets compare.
lerobot-lint opens sets of one version of lerobot only; its checks get the same rows here.
"""

from __future__ import annotations

import json
import re
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from lerobot_doctor.dataset_loader import load_dataset
from lerobot_doctor.runner import Severity, run_checks
from lerobot_lint import engine
from lerobot_lint.config import load_profile
from lerobot_lint.types import EpisodeData


def doctor(root: Path) -> dict[str, list[str]]:
    """By severity."""
    told: dict[str, list[str]] = {"warning": [], "error": []}
    for result in run_checks(load_dataset(str(root))).results:
        for each in result.messages:
            if each.severity != Severity.PASS:
                kind = "error" if each.severity == Severity.FAIL else "warning"
                told[kind].append(re.sub(r"[-+.\d]+", "#", each.message))
    return told


def lint(root: Path) -> dict[str, list[str]]:
    """By severity."""
    fps = float(json.loads((root / "meta/info.json").read_text())["fps"])
    lines = (root / "meta/tasks.jsonl").read_text().splitlines()
    texts = {row["task_index"]: row["task"] for row in map(json.loads, lines)}

    def episodes(*_: object) -> object:
        for number, file in enumerate(sorted((root / "data").rglob("*.parquet"))):
            columns = pq.read_table(file).to_pydict()
            yield (
                number,
                EpisodeData(
                    np.array(columns["observation.state"], np.float32),
                    np.array(columns["action"], np.float32),
                    np.array(columns["timestamp"], np.float64),
                    fps,
                    texts.get(columns["task_index"][0], ""),
                    {},
                ),
                None,
            )

    engine.iter_episodes = episodes
    told: dict[str, list[str]] = {"warning": [], "error": []}
    for each in engine.check_dataset(str(root), load_profile("default")):
        if each.severity in told:
            told[each.severity].append(f"{each.check} in episode {each.episode}")
    return told


programs = {"lerobot-doctor": doctor, "lerobot-lint": lint}
print(json.dumps({name: metadata.version(name) for name in programs}))
for _root in sorted(Path(sys.argv[1]).iterdir()):
    said = {}
    for _name, _check in programs.items():
        try:
            said[_name] = _check(_root)
        except Exception as problem:  # it ends over the set: that is a finding
            said[_name] = {"warning": [], "error": [f"ended: {type(problem).__name__}"]}
    print(json.dumps({"set": _root.name, **said}))
