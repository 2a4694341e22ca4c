"""The first power-on of docs/guide/link_ur.md, line by line, against the emulated arm.

A person's hands are faults of the emulator. ``SURG_TEST_FULL=1``: it takes minutes.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from helpers.hardware import emulated_ur
from helpers.hardware.emulated_cell import HOME, SERIAL, emulated_cell
from surg_cli.graph.processes import wait_until
from surg_cli.host import paths
from surg_cli.robots.rehearsal import STEPS

PAGE = paths.ROOT / "docs" / "guide" / "link_ur.md"
HEADING = "## The first power-on\n"
FULL = os.environ.get("SURG_TEST_FULL", "") not in ("", "0")
HANDS = {
    "emergency stop": ("estop", "release"),
    "protective stop": ("protective_stop", ""),
    "speed slider": ("slider 50", "slider 100"),
    "unplugged cable": ("stall 3", ""),
}
"""Stop of the rehearsal -> what a person does, and undoes."""
AGAIN = ("controller killed", "node killed")
"""Stops after which `./surg up` is started again."""


def lines() -> list[str]:
    """The command lines of the page's section, in order, without comments."""
    section = PAGE.read_text("utf-8").split(HEADING)[1].split("\n## ")[0]
    blocks = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    found = [line.partition("#")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in found if line]


def test_the_page_has_the_lines_of_a_first_power_on_in_this_order() -> None:
    words = ["on", "doctor", "kinematics", "up", "guide", "stop", "start", "lag", "rehearse"]
    text = " ".join(lines())
    places = [
        text.index(f" {word} ") if f" {word} " in text else text.index(word) for word in words
    ]
    assert places == sorted(places)


class Lab:
    """A cell, its emulated arm, and two terminals."""

    def __init__(self, folder: Path, address: str) -> None:
        self.address, self.folder = address, folder
        self.cell = emulated_cell(folder, address)
        document = yaml.safe_load((self.cell / "cell.yaml").read_text("utf-8"))
        document["arms"]["PSM1"]["hardware"]["commissioning"] = True
        (self.cell / "cell.yaml").write_text(yaml.safe_dump(document), "utf-8")
        self.up: subprocess.Popen[bytes] | None = None
        self.logs = 0

    def run(self, line: str, timeout: float = 120.0) -> str:
        """A line in a terminal; a person says yes to everything."""
        done = subprocess.run(
            ["./surg", "dev", "shell", "-c", line] if line.startswith("rosrun") else line.split(),
            cwd=paths.ROOT,
            input="yes\n" * 10,
            text=True,
            capture_output=True,
            timeout=timeout,
        )
        print(f"$ {line}\n{done.stdout}{done.stderr}")
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
        return done.stdout

    def begin(self, line: str) -> None:
        """A line that stays."""
        self.logs += 1
        with (self.folder / f"up{self.logs}.log").open("w") as log:
            self.up = subprocess.Popen(
                line.split(), cwd=paths.ROOT, stdout=log, stderr=subprocess.STDOUT
            )
        assert wait_until(lambda: self.answers(), 120.0), "up does not answer"

    def answers(self) -> bool:
        words = ["./surg", "robot", str(self.cell), "status"]
        done = subprocess.run(words, cwd=paths.ROOT, capture_output=True, text=True)
        return done.returncode == 0 and "READY" in done.stdout

    def end(self) -> None:
        if self.up is not None:
            self.up.send_signal(signal.SIGINT)
            self.up.wait(60.0)
        self.up = None


@pytest.fixture
def lab(tmp_path: Path, polyscope: str) -> Iterator[Lab]:
    at = [f"{angle:.6f}" for angle in HOME]
    options = ("--q", *at, "--serial", SERIAL, "--off", *emulated_ur.with_polyscope(polyscope))
    with emulated_ur.program(tmp_path / "emulator.log", *options) as address:
        made = Lab(tmp_path, address)
        try:
            yield made
        finally:
            made.end()


@pytest.mark.skipif(not FULL, reason="minutes; SURG_TEST_FULL=1 runs it")
@emulated_ur.OF_BOTH
def test_every_line_of_the_page_works(lab: Lab) -> None:
    for line in lines():
        command = line.replace("CELL", str(lab.cell))
        if " up " in command:
            lab.begin(command)
        elif command.endswith("rehearse"):
            rehearse(lab, command)
        elif command.startswith("rosrun"):
            player = subprocess.Popen(["./surg", "dev", "shell", "-c", command], cwd=paths.ROOT)
            time.sleep(4.0)
        elif command.endswith("lag"):
            lab.run(command)
            player.wait(60.0)
        else:
            lab.run(command)


STARTS = 3
"""A busy machine may stop the arm before it moves as it shall: a person starts it again."""


def rehearse(lab: Lab, command: str) -> None:
    """Each stop, with a person's hands."""
    for step in STEPS:
        for _ in range(STARTS):
            lab.run(f"./surg robot {lab.cell} start")
            code, said = one_stop(lab, command, HANDS.get(step.name, ("", ""))[0])
            print(said)
            if "does not move" not in said:
                break
        assert code == 0, said
        mend(lab, step.name)
    report = (lab.cell / "rehearsal_PSM1.md").read_text("utf-8")
    print(report)
    assert report.count("| passed |") == len(STEPS)


def one_stop(lab: Lab, command: str, act: str) -> tuple[int, str]:
    """One call of `rehearse`, in which a person acts when asked to; exit code and words."""
    running = subprocess.Popen(
        command.split(),
        cwd=paths.ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert running.stdin is not None and running.stdout is not None
    running.stdin.write("yes\n")
    running.stdin.flush()
    said = ""
    for text in running.stdout:
        said += text
        if act and ": now " in text:
            assert emulated_ur.fault(lab.address, act) == "ok"
    return running.wait(60.0), said


def mend(lab: Lab, stop: str) -> None:
    """What a person does after a stop."""
    if undo := HANDS.get(stop, ("", ""))[1]:
        assert emulated_ur.fault(lab.address, undo) == "ok"
    if stop == "emergency stop":
        lab.run(f"./surg robot {lab.cell} on")
    if stop == "protective stop":
        time.sleep(5.0)
        lab.run(f"./surg robot {lab.cell} recover")
    if stop in AGAIN:
        lab.end()
        lab.begin(f"./surg up {lab.cell}")
    time.sleep(3.0)
