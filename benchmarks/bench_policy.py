"""Round trip of an observation and its chunk between robot and policy, beside other ways.

Stereo 640x480 RGB and the state go out, a chunk of 50x8 comes back; each way in two processes of
its own, all in one run, in blocks that take turns. `--json FILE` writes

    format          "surg_bench_policy/1"
    machine         {processor, cores, load_before, load_after, date, rounds, blocks,
                    openpi_client}
    round_trip_ms   {ours_tcp|ours_ipc|ours_curve|msgpack_zmq|peer_openpi_ws: {p50, p99, mean}};
                    peer_openpi_ws is absent where its package is not to be had
    cpu_ms          {the same names: processor time of both processes per round}
    ratio           {the same names but ours_tcp: p50 over that of ours_tcp}
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import socket
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "policy"))

import policy_page
from machine import processor
from publish import publish

from surg_cli.host import environment, logged, paths
from surg_cli.host.terminal import CliError, Progress, warn
from surg_policy_client import keys

SOURCE = Path(__file__).parent / "policy"
VENV = paths.ROOT / ".venv-bench-policy"
LOCK = paths.ROOT / "benchmarks" / "policy.lock"
LOG = paths.STATE / "logs" / "bench_policy.log"
OPENPI = "peer_openpi_ws"
WARM_UP = 20


@dataclass(frozen=True)
class Way:
    """One way over the wire.

    Attributes:
        program: In benchmarks/policy.
        python: That runs both roles.
        address: Where they meet.
        keys: Folder; empty: none.
    """

    program: str
    python: Path
    address: str
    keys: str = ""


def openpi(offline: bool) -> Path | None:
    """Interpreter of an environment with openpi-client, from its lock file; None: not to be had."""
    python, stamp = VENV / "bin" / "python", VENV / "lock.sha256"
    wanted = paths.file_digest(LOCK)
    if stamp.exists() and stamp.read_text("utf-8") == wanted:
        return python
    if offline:
        return None
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--no-deps"]
    steps = (
        [str(paths.SYSTEM_PYTHON), "-m", "venv", "--clear", str(VENV)],
        [*pip, "--require-hashes", "--only-binary", ":all:", "-r", str(LOCK)],
    )
    try:
        with Progress("openpi-client") as progress:
            for argv in steps:
                logged.run(argv, LOG, progress)
    except CliError as problem:
        warn(f"bench: going on without openpi-client; {problem}")
        return None
    paths.write_text(stamp, wanted)
    return python


def ways(folder: Path, python: Path | None) -> dict[str, Way]:
    """All ways that can be gone here."""
    ours, here = Path(sys.executable), "tcp://127.0.0.1:{}"
    keys.make(folder / "keys")
    found = {
        "ours_tcp": Way("ours", ours, here),
        "ours_ipc": Way("ours", ours, f"ipc://{folder / 'wire'}"),
        "ours_curve": Way("ours", ours, here, str(folder / "keys")),
        "msgpack_zmq": Way("msgpack_zmq", ours, here),
        OPENPI: Way(OPENPI, python or ours, here),
    }
    if python is None:
        del found[OPENPI]
    return found


class Pair:
    """Robot and policy of one way, as processes."""

    def __init__(self, name: str, way: Way) -> None:
        self.name = name
        self.times: list[float] = []
        self.cpu = 0
        address = way.address.format(_free_port())
        argv = [str(way.python), str(SOURCE / f"{way.program}.py")]
        rest = [address, way.keys] if way.keys else [address]
        env = {**os.environ, "OMP_NUM_THREADS": "1"}
        for name in environment.KEEPS_MEMORY:  # who uses a wire has the C library's own settings
            env.pop(name, None)
        if way.python != Path(sys.executable):
            env.pop("PYTHONPATH", None)  # Debian's packages are not for another environment
        self._policy = subprocess.Popen([*argv, "policy", *rest], env=env)
        self._robot = subprocess.Popen(
            [*argv, "robot", *rest],
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, rounds: int) -> list[float]:
        """Times of some rounds [ms]."""
        assert self._robot.stdin is not None
        assert self._robot.stdout is not None
        try:
            self._robot.stdin.write(f"{rounds}\n")
            self._robot.stdin.flush()
        except BrokenPipeError:
            pass
        line = self._robot.stdout.readline()
        if not line:
            raise CliError(f"{self.name}: the robot's process ended, see above")
        found: list[float] = json.loads(line)
        return found

    def cpu_ns(self) -> int:
        """Processor time of both so far, all threads, user and system [ns]."""
        return sum(
            int(path.read_text("ascii").split()[0])
            for process in (self._robot, self._policy)
            for path in Path(f"/proc/{process.pid}/task").glob("*/schedstat")
        )

    def close(self) -> None:
        """End both."""
        for process in (self._policy, self._robot):
            process.kill()
            process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Everything, in the order of the JSON."""
    python = openpi(options.offline)
    load = os.getloadavg()
    pairs: list[Pair] = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            for name, way in ways(Path(folder), python).items():
                pairs.append(Pair(name, way))
                pairs[-1].run(WARM_UP)
            with Progress("rounds") as progress:
                for block in range(options.blocks):
                    for pair in pairs:
                        before = pair.cpu_ns()
                        pair.times += pair.run(options.rounds)
                        pair.cpu += pair.cpu_ns() - before
                    progress.update((block + 1) / options.blocks)
        finally:
            for pair in pairs:
                pair.close()
    found = {
        pair.name: {
            "p50": float(np.percentile(pair.times, 50)),
            "p99": float(np.percentile(pair.times, 99)),
            "mean": float(np.mean(pair.times)),
        }
        for pair in pairs
    }
    machine = {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load_before": [round(x, 2) for x in load],
        "load_after": [round(x, 2) for x in os.getloadavg()],
        "date": datetime.date.today().isoformat(),
        "rounds": options.rounds * options.blocks,
        "blocks": options.blocks,
    }
    if python is not None:
        machine["openpi_client"] = _locked("openpi-client")
    ours = found["ours_tcp"]["p50"]
    ratio = {name: each["p50"] / ours for name, each in found.items() if name != "ours_tcp"}
    return {
        "format": "surg_bench_policy/1",
        "machine": machine,
        "round_trip_ms": found,
        "cpu_ms": {pair.name: 1e-6 * pair.cpu / len(pair.times) for pair in pairs},
        "ratio": ratio,
    }


def _locked(name: str) -> str:
    lines = LOCK.read_text("utf-8").splitlines()
    return next(line.split("==")[1].split()[0] for line in lines if line.startswith(f"{name}=="))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="./surg dev bench policy",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--json", type=Path, metavar="FILE", help="write the figures")
    add("--rounds", type=int, default=50, metavar="N", help="of a block (default 50)")
    add("--blocks", type=int, default=20, metavar="N", help="of each way (default 20)")
    add("--offline", action="store_true", help="fetch nothing; use openpi-client if it is there")
    add("--page", action="store_true", help="rewrite docs/results/benchmark_policy.md")
    options = parser.parse_args()
    try:
        if not (1 <= options.rounds <= 100_000 and 1 <= options.blocks <= 10_000):
            raise CliError("--rounds is 1 to 100000 and --blocks 1 to 10000", 2)
        result = measure(options)
    except CliError as problem:
        warn(f"bench: {problem}")
        sys.exit(problem.code)
    publish(result, policy_page, options)


if __name__ == "__main__":
    main()
