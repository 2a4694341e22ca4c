"""docs/guide/first_session.md, done line by line with the simulator."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surg_core
from helpers.graph import surg
from surg_cli.graph import master, processes, running
from surg_cli.host import paths
from surg_core.reading.calibration_recording import read_recording

pytestmark = pytest.mark.ros

PAGE = paths.ROOT / "docs" / "guide" / "first_session.md"
START_S = 60.0
LAG_TRIES = 6
BUSY = {"FAULT": ("robot link", "enable"), "PAUSED": ("missed its deadlines", "resume")}
"""What stops the arm on a busy machine (F10, F27), in its words, and what takes it up again."""
TRIES = 4


def lines_of(page: Path) -> list[tuple[str, str]]:
    """(heading, line) of every line in a box of the page that is marked as shell."""
    heading, inside, found = "", False, []
    for line in page.read_text("utf-8").splitlines():
        if line.startswith("```"):
            inside = line == "```sh"
        elif inside and line:
            found.append((heading, line))
        elif line.startswith("## "):
            heading = re.sub(r"^## \d+\. ", "", line)
    return found


@dataclass
class Session:
    """Runs the page's lines in a folder that looks like the checkout from inside.

    Attributes:
        folder: Working directory; `src` in it is the tree's.
        port: Of the ROS master that the page's `./surg up` starts.
        said: What each line was answered.
    """

    folder: Path
    port: int
    said: list[tuple[str, Any]] = field(default_factory=list)
    up: subprocess.Popen[bytes] | None = None
    client: subprocess.Popen[str] | None = None
    starts: int = 0

    def do(self, line: str) -> Any:
        """One line of the page."""
        words = shlex.split(line)
        if words[:2] == ["./surg", "up"]:
            answer: Any = self._up(words[1:])
        elif words[0] == "./surg" and words[-1] == "lag":
            answer = self._lag(words[1:])
        elif words[:2] == ["./surg", "down"]:
            answer = self._down(words[1:])
        elif words[0] == "./surg":
            answer = self._run(surg.argv(*words[1:]))
        elif words[0] == "python3":
            answer = self._run([sys.executable, *words[1:]])
        elif words[0] == "cp":
            answer = self._run(words)
        elif words[:3] == ["rostopic", "pub", "-1"]:
            answer = self._publish(line)
        else:
            raise AssertionError(f"the page has a line that this test does not know: {line}")
        self.said.append((line, answer))
        return answer

    def _run(self, argv: list[str]) -> str:
        done = self._try(argv)
        late = "were late" in done.stderr  # a busy machine's lag is not believed
        assert done.returncode == 0 or late, f"{argv}: {done.stdout}{done.stderr}"
        return done.stdout + done.stderr * late

    def _try(self, argv: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            argv,
            cwd=self.folder,
            env=surg.environment(),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def _lag(self, words: list[str]) -> str:
        """The controller measures in cycles that were not late: where few are, the arm moves on."""
        moves = [line for line, _ in self.said if "/move_" in line and "/jaw/" not in line]
        for _ in range(LAG_TRIES - 1):
            done = self._try(
                surg.argv_with("surg_cli.commands.arms.robot", "TIMEOUT_S", 5.0, *words)
            )
            if done.returncode == 0:
                return done.stdout
            for line in moves:
                self._publish(line)
        return self._run(surg.argv(*words))

    def _up(self, words: list[str]) -> str:
        self.starts += 1
        log = self.folder / f"up{self.starts}.log"
        with log.open("wb") as stream:
            self.up = subprocess.Popen(
                surg.argv(*words, "--port", self.port),
                cwd=self.folder,
                env=surg.environment(),
                stdout=stream,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        pid = self.up.pid

        def there() -> bool:
            assert self.up is not None
            assert self.up.poll() is None, log.read_text()
            return any(s.pid == pid and s.nodes for s in running.systems())

        assert processes.wait_until(there, START_S, 0.1), log.read_text()
        env = surg.environment()
        env["ROS_MASTER_URI"] = f"http://localhost:{self.port}"
        env["PYTHONPATH"] = f"{paths.ROOT / 'tests'}:{env['PYTHONPATH']}"
        self.client = subprocess.Popen(
            [sys.executable, "-m", "helpers.graph.session_client", "PSM1"],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return log.read_text()

    def _down(self, words: list[str]) -> str:
        self._end_client()
        text = self._run(surg.argv(*words, "--port", self.port))
        assert self.up is not None
        assert self.up.wait(30) == 130
        self.up = None
        return text

    def _publish(self, line: str) -> dict[str, Any]:
        """One line's answer; said again if a busy machine has stopped the arm meanwhile."""
        for _ in range(TRIES):
            answer = self._say(line)
            cause, cure = BUSY.get(answer["state"], ("nothing", ""))
            if not any(cause in warning for warning in answer["warnings"]):
                break
            print(f"{line[:60]}… {answer['warnings']}")
            self._say(
                f'rostopic pub -1 /PSM1/state_command crtk_msgs/StringStamped "{{string: {cure}}}"'
            )
        return answer

    def _say(self, line: str) -> dict[str, Any]:
        assert self.client is not None, "the page publishes before ./surg up"
        assert self.client.stdin is not None
        assert self.client.stdout is not None
        self.client.stdin.write(line + "\n")
        self.client.stdin.flush()
        answer: dict[str, Any] = json.loads(self.client.stdout.readline())
        assert "failed" not in answer, f"{line}: {answer}"
        return answer

    def _end_client(self) -> None:
        if self.client is not None:
            assert self.client.stdin is not None
            self.client.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.client.wait(10)
            if self.client.poll() is None:
                self.client.kill()
            self.client = None

    def end(self) -> None:
        """Leave nothing running, whatever has failed."""
        self._end_client()
        if self.up is not None and self.up.poll() is None:
            os.kill(self.up.pid, signal.SIGTERM)
            self.up.wait(30)


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    (tmp_path / "src").symlink_to(paths.ROOT / "src")
    shutil.copytree(paths.ROOT / "cells", tmp_path / "cells")
    made = Session(tmp_path, master.free_port())
    yield made
    made.end()


@pytest.mark.full
def test_the_page_is_done_line_by_line(session: Session) -> None:
    lines = lines_of(PAGE)
    assert len(lines) >= 20
    began = time.monotonic()
    steps: dict[str, list[tuple[str, Any]]] = {}
    collector: subprocess.Popen[str] | None = None
    for heading, line in lines:
        if heading == "Work" and collector is None:
            collector = collect(session)
        answer = session.do(line)
        steps.setdefault(heading, []).append((line, answer))
        if isinstance(answer, dict):
            print(
                f"{heading}: {line[15:70]}… {answer['state']} depth "
                f"{[round(v, 4) for v in answer['joints']]} kinematic "
                f"{1e3 * answer['worst_error']:.3f} true {1e3 * answer['worst_truth']:.3f} mm"
            )
    print(f"{len(lines)} lines in {time.monotonic() - began:.1f} s")

    # Calibrated: near the truth, with evidence, and the computed files kept beside.
    folder = session.folder / "cells" / "my_cell"
    before = surg_core.load_cell(paths.ROOT / "cells" / "sim_ur5e").arms["PSM1"]
    after = surg_core.load_cell(folder).arms["PSM1"]
    assert 0 < np.linalg.norm(after.tool.p_FTip - before.tool.p_FTip) < 3e-4
    assert 0 < np.linalg.norm(after.trocar.p_BRcm - before.trocar.p_BRcm) < 3e-4
    assert after.tool.n == 24
    kept = sorted(p.name for p in (folder / "calibration").glob("*.previous"))
    assert kept == ["tool_PSM1.yaml.previous", "trocar_PSM1.yaml.previous"]
    assert "written:" in steps["Calibrate the tool"][1][1]

    # No line was refused.
    for _, answer in session.said:
        if isinstance(answer, dict):
            assert answer["state"] != "FAULT", answer["warnings"]
            assert answer["worst_error"] < 0.5e-3
            assert answer["worst_truth"] < 1e-3
    assert steps["Teach the trocar"][0][1]["state"] == "DISABLED"
    assert steps["Teach the trocar"][0][1]["warnings"] == []
    home = steps["Enable and home"][-1][1]
    assert (home["state"], home["homed"]) == ("ENABLED", True)
    assert home["joints"][2] == pytest.approx(0.120, abs=1e-3)

    out, inside = (answer for _, answer in steps["Insert"])
    assert out["joints"][2] == pytest.approx(-0.010, abs=1e-3)
    assert inside["joints"][2] == pytest.approx(0.030, abs=1e-3)
    to_point, to_joints, jaw, lag = (answer for _, answer in steps["Work"])
    assert to_point["tip"] == pytest.approx([0.02, 0.0, 0.1], abs=1e-3)
    assert to_joints["joints"] == pytest.approx([0.2, -0.1, 0.11, 0.5], abs=5e-3)
    assert jaw["jaw"] == pytest.approx([0.5], abs=0.02)
    if "were late" not in lag:
        measured, stated = (float(ms) for ms in re.findall(r"([0-9.]+) ms", lag))
        assert measured == pytest.approx(stated, abs=3.0)
    out, off = (answer for _, answer in steps["Withdraw"])
    assert out["joints"][2] == pytest.approx(-0.010, abs=1e-3)
    assert out["jaw"] == pytest.approx([0.5], abs=0.02), "the jaw stays as it was"
    assert off["state"] == "DISABLED"
    again = steps["Change the instrument"][-2][1]
    assert (again["state"], again["homed"]) == ("ENABLED", True)
    assert session.starts == 1, "the tool changes without a restart"
    assert session.up is None

    # Beside the page: the collector has seen the standstills of "Work".
    assert collector is not None
    said, _ = collector.communicate(timeout=20)
    assert collector.returncode == 0, said
    recording = read_recording(session.folder / "live.csv", after.chain, after.robot.joint_names)
    shafts = recording.poses["trocar"]
    assert shafts.shape == (3, 4, 4)
    states = surg_core.shaft_states(shafts, before.tool.s_F, before.tool.p_FTip, [0, 0, 0])
    assert np.ptp(states.s, axis=0).max() > 0.1, "three tilts"


def collect(session: Session) -> subprocess.Popen[str]:
    """Starts `./surg calibrate … collect` beside the session; returns when it listens."""
    words = "calibrate cells/my_cell collect trocar --count 3 --to live.csv"
    started = subprocess.Popen(
        surg.argv_with(
            "surg_cli.graph.collect", "TIMEOUT_S", 40.0, *words.split(), "--port", session.port
        ),
        cwd=session.folder,
        env={**surg.environment(), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert started.stdout is not None
    for line in started.stdout:
        if "1 of 3" in line:
            return started
    raise AssertionError(f"the collector ended with {started.wait(5)}")
