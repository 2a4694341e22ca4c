"""Other Pythons of this machine, for what has to run on more than Debian's."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path


def find(version: str) -> Path | None:
    """An interpreter of a version such as ``3.8``, on PATH, of pyenv or uv; None: there is none."""
    candidates = [shutil.which(f"python{version}")]
    roots = [Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"]
    roots.append(Path.home() / ".local" / "share" / "uv" / "python")
    for root in roots:
        candidates += sorted(map(str, root.glob(f"*{version}*/bin/python{version}")))
    asks = "import sys; print('%d.%d' % sys.version_info[:2])"
    for candidate in candidates:
        if candidate is None:
            continue
        done = subprocess.run([candidate, "-c", asks], capture_output=True, text=True, check=False)
        if done.stdout.strip() == version:  # a shim of pyenv may be there and point nowhere
            return Path(candidate)
    return None
