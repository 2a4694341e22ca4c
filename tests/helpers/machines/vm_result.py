"""Runs a program of the tests in the emulated machine, and reads the one line that it reports."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any

import pytest

from helpers.machines import vm
from surg_cli.host import paths

TIMEOUT_S = 1800.0


def result_of(module: str, *words: str, modules: Sequence[str] = ()) -> dict[str, Any]:
    """What ``python -m MODULE WORDS`` in the guest prints as ``RESULT {JSON}``.

    The test is skipped where the machine's parts are missing.

    Args:
        module: Such as ``helpers.machines.vm_devices``.
        words: Its arguments.
        modules: Further modules of the guest's kernel.
    """
    env = {
        "PATH": "/usr/bin:/bin",
        "PYTHONPATH": f"{paths.ROOT / 'tests'}:{paths.ROOT / 'tools'}:{os.environ['PYTHONPATH']}",
        "PYTHONDONTWRITEBYTECODE": "1",
        "LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", ""),
        "HOME": "/run",
    }
    argv = [str(paths.VENV_PYTHON), "-m", module, *words]
    try:
        status, said = vm.run(argv, env, TIMEOUT_S, modules)
    except vm.MissingError as missing:
        pytest.skip(f"missing: {missing}")
    lines = [line for line in said.splitlines() if line.startswith("RESULT ")]
    assert status == 0, said[-4000:]
    assert lines, said[-4000:]
    result: dict[str, Any] = json.loads(lines[-1].removeprefix("RESULT "))
    print(json.dumps(result, indent=2))
    return result
