"""Environments with other people's software, beside the checkout and never in git."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from surg_cli.host import paths


def python(
    name: str,
    installs: Sequence[Sequence[str]],
    modules: Sequence[str],
    base: Path = paths.SYSTEM_PYTHON,
) -> Path:
    """The interpreter of an environment; made when it is missing, else the test is skipped.

    Args:
        name: Of the environment, in its folder's name and in the reason of a skip.
        installs: Words for `pip install`, call by call.
        modules: That must be there afterwards.
        base: The interpreter that it is made of.
    """
    folder = paths.ROOT / f".venv-oracle-{name}"
    interpreter, stamp = folder / "bin" / "python", folder / ".complete"
    if stamp.exists():
        return interpreter
    pip = [str(interpreter), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    steps = [
        [str(base), "-m", "venv", str(folder)],
        *([*pip, *words] for words in installs),
        [str(interpreter), "-c", f"import {', '.join(modules)}"],
    ]
    for step in steps:
        done = subprocess.run(step, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            last = done.stderr.strip().splitlines()[-1:]
            said = f"{' '.join(step[:5])} …: {last}"
            pytest.skip(f"missing: an environment with {name}: {said}")
    stamp.touch()
    return interpreter
