"""The newest lerobot with our plug-ins, as a user has it: its commands, in a newer Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from helpers.policy import lerobot_venv
from surg_cli.host import paths

VERSION = "0.6.1"
PLUGINS = ("env", "robot", "teleoperator")
MADE_UP = Path(__file__).parent
"""Folder of the package `made_up_lerobot`: a device and a policy, as a user would write."""


class LeRobot:
    """Its commands. What they keep lies in a folder of its own, and nothing is fetched from a hub.

    Args:
        home: The folder; our packages are installed there.
    """

    def __init__(self, home: Path) -> None:
        self.home, self._python = home, lerobot_venv.python(VERSION)
        site = home / "site"
        src = paths.ROOT / "src"
        ours = [src / "surg_core", src / "surg_sim", src / "surg_policy_bridge" / "client"]
        ours += [src / "surg_lerobot" / name for name in PLUGINS]
        self.env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        pip = [str(self._python), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
        pip += ["--no-deps", "--target", str(site), *map(str, ours)]
        done = subprocess.run(pip, env=self.env, capture_output=True, text=True, check=False)
        for each in ours:  # pip builds beside the source
            for made in (each / "build", *each.rglob("*.egg-info")):
                shutil.rmtree(made, ignore_errors=True)
        if done.returncode != 0:
            pytest.skip(f"missing: our packages in {self._python}: {done.stderr.strip()[-300:]}")
        self.env.update(PYTHONPATH=f"{site}:{MADE_UP}", HF_HUB_OFFLINE="1")
        self.env.update(HF_HOME=str(home / "hf"), TORCH_HOME=str(home / "torch"), HOME=str(home))

    def start(self, command: str, *words: object) -> subprocess.Popen[str]:
        """Start a command such as ``lerobot-train``, in the folder."""
        argv = [str(self._python.with_name(command)), *map(str, words)]
        log = tempfile.TemporaryFile("w+", dir=self.home)  # noqa: SIM115 (the process has it)
        started = subprocess.Popen(
            argv, cwd=self.home, env=self.env, stdout=log, stderr=subprocess.STDOUT, text=True
        )
        started.stdout = log
        return started

    def run(self, command: str, *words: object, timeout_s: float = 900.0) -> str:
        """Run one to its end; returns what it said."""
        return self.end(self.start(command, *words), timeout_s)

    @staticmethod
    def end(started: subprocess.Popen[str], timeout_s: float) -> str:
        """Wait for a command that must succeed; returns what it said."""
        try:
            status = started.wait(timeout_s)
        finally:
            started.kill()
            assert started.stdout is not None
            started.stdout.seek(0)
            said = started.stdout.read()
            started.stdout.close()
        assert status == 0, said[-4000:]
        return said


def options(**words: object) -> list[str]:
    """``--dataset.root=…`` for ``dataset__root=…``."""
    return [f"--{key.replace('__', '.')}={value}" for key, value in words.items()]
