"""The operator on a second machine: drives, sees, and what a bad cable does to it.

Two network namespaces with a relay in user space between them. The steady clock is one and the same
on both, so that lags are exact.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from helpers.machines import Machines, ip, two_machines
from helpers.surg import argv, environment
from surg_cli import network, paths, processes, roles
from surg_cli.environment import for_nodes

pytestmark = pytest.mark.ros

FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
PORT = 11377  # namespaces have ports of their own
CYCLE_S = 0.002
TIP_VELOCITY = 0.25  # [m/s] of an axis, as shipped
F03 = 51  # cycles
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def machines() -> Iterator[Machines]:
    try:
        with two_machines() as found:
            yield found
    except PermissionError as error:
        pytest.skip(f"network namespaces are not permitted here: {error}")


@pytest.fixture(scope="module")
def cell(machines: Machines, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cell") / "two_machines"
    bundled = paths.CELLS / "sim_ur5e"
    content = yaml.safe_load((bundled / "cell.yaml").read_text("utf-8"))
    for arm in content["arms"].values():
        for key in ("robot", "instrument"):
            arm[key] = str((bundled / arm[key]).resolve())
    content.update(name="two_machines", network="isolated", machines=dict(machines.addresses))
    (folder / "calibration").mkdir(parents=True)
    for file in (bundled / "calibration").iterdir():
        (folder / "calibration" / file.name).write_bytes(file.read_bytes())
    (folder / "cell.yaml").write_text(yaml.safe_dump(content, sort_keys=False), "utf-8")
    return folder


def up(machines: Machines, log: Path, machine: str, *words: object) -> subprocess.Popen[bytes]:
    """`./surg up WORDS` on a machine."""
    with log.open("wb") as stream:
        return subprocess.Popen(
            machines.on(machine, *argv("up", *words, "--port", PORT)),
            env=environment(),
            cwd=paths.ROOT,
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )


def end(process: subprocess.Popen[bytes]) -> int:
    process.send_signal(signal.SIGINT)
    return process.wait(30)


class Program:
    """A helper on one of the machines, with lines in and out."""

    def __init__(self, machines: Machines, machine: str, *words: str) -> None:
        link = roles.Link(
            roles.Role(machine), machines.addresses[machine], machines.addresses["robot"], PORT
        )
        env = link.environment(for_nodes(), network.GUARD)
        env["PYTHONPATH"] = f"{paths.ROOT / 'tests'}:{env['PYTHONPATH']}"
        self.process = subprocess.Popen(
            machines.on(machine, sys.executable, "-s", *words),
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line() == "up"

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def ask(self, word: str) -> object:
        assert self.process.stdin is not None
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()
        return json.loads(self._line())

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(10)


@dataclass
class Far:
    """The running system."""

    machines: Machines
    hand: Program
    eye: Program
    sent_log: Path
    cycles_log: Path


@pytest.fixture(scope="module")
def far(
    machines: Machines, cell: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Far]:
    folder = tmp_path_factory.mktemp("far")
    robot = up(machines, folder / "robot.log", "robot", cell, "--role", "robot")
    eye = hand = None
    try:
        log = folder / "robot.log"
        started = processes.wait_until(
            lambda: robot.poll() is not None or "is up:" in log.read_text("utf-8"), 90.0, 0.1
        )
        assert started and robot.poll() is None, log.read_text("utf-8")
        helpers = paths.ROOT / "tests" / "helpers"
        sent, cycles = folder / "sent.txt", folder / "cycles.txt"
        eye = Program(machines, "robot", str(helpers / "near_eye.py"), "PSM1", str(cycles))
        hand = Program(machines, "operator", str(helpers / "far_hand.py"), "PSM1", str(sent))
        assert processes.wait_until(lambda: hand.ask("ready") is True, 30.0, 0.1)
        yield Far(machines, hand, eye, sent, cycles)
    finally:
        for program in (hand, eye):
            if program is not None:
                program.close()
        code = end(robot) if robot.poll() is None else robot.returncode
        print((folder / "robot.log").read_text("utf-8")[-800:])
    assert code == 130
