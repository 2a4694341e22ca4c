"""What earlier versions of the command line called otherwise."""

from __future__ import annotations

COMMANDS = {
    "view": "episode view",
    "film": "episode film",
    "label": "episode label",
    "depth": "episode depth",
    "recover": "episode recover",
    "export": "episode export",
    "import": "episode import",
    "evaluate": "episode evaluate",
    "keys": "policy keys",
    "setup": "dev setup",
    "build": "dev build",
    "bench": "dev bench",
    "shell": "dev shell",
    "doctor": "dev doctor",
    "topics": "dev topics",
}
"""Old name -> new name."""

OPTIONS = {
    ("demo", "--task"): "./surg run TASK",
    ("demo", "--full"): "./surg learn TASK",
}
"""(command, option) -> what does the same now."""
