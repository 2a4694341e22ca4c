"""Made-up episodes for an evaluation: what each comes to is known by construction."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from helpers.recording.recording_synthetic import Synthetic, record

DONE = {"name": "bgr", "phase": "done", "done": True, "success": True, "reason": ""}


def episode(
    folder: Path,
    seed: int,
    what: Synthetic | None = None,
    *,
    task: dict[str, Any] | None = None,
    manifest: dict[str, Any] | None = None,
    **run: Any,
) -> Path:
    """Record an episode of a task.

    Args:
        folder: Where it goes.
        seed: Also makes its state hash, so that two seeds are two simulations.
        what: What to make up; by default 2 s with a deviation that grows with the seed.
        task: What the simulator said of the task; None: there was none.
        manifest: Keys of the manifest to replace.
        **run: Of the manifest's ``run``: setting, law, robot, …
    """
    what = what or Synthetic(seconds=2.0, kinematic_offset=(10 + seed) * 1e-6)
    made = record(folder, what, seed=seed, **run)
    file = made / "manifest.json"
    content = json.loads(file.read_text())
    content["task"] = None if task is None else task["name"]
    if content.get("sim"):
        content["sim"].update(state_hash=f"{seed:064x}", task=task)
    content.update(manifest or {})
    file.write_text(json.dumps(content))
    return made
