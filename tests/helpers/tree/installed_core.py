"""surg_core for a test that installs another package: this workspace's build, copied."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import surg_core
from surg_cli.host import paths


def provide(site: Path) -> None:
    """Puts surg_core into a folder of packages; its own installation is tested elsewhere."""
    shutil.copytree(paths.ROOT / "src/surg_core/python/surg_core", site / "surg_core")
    shutil.copy(surg_core._core.__file__, site / "surg_core")


def libraries() -> str:
    """LD_LIBRARY_PATH with the library behind the compiled half."""
    folder = Path(surg_core._core.__file__).parents[3]
    return os.pathsep.join([str(folder), os.environ.get("LD_LIBRARY_PATH", "")])
