"""The console under full load: age of the picture in Chromium, frame rate, real-time factor.

Starts `./surg teleop` (control, phantom, recording, teleoperation, console) and headless Chromium
with its page on the same machine, enables, moves in a small circle by the keyboard, and reads off
the page how old each picture was when its pixels had been drawn. `--json FILE` writes:

    format              "surg_bench_console/1"
    machine             {processor, cores, load_before, load_after, date}
    runs                one per layout ("left", "stereo"; "headset"):
        layout, codec, seconds
        pictures, fps   drawn, and per second
        age_ms          {p50, p99, max}: exposure stamp -> pixel drawn, on one clock
        parts_ms        medians: exposure -> encoder (render, ROS), encoding, transport, decode and
                        draw
        real_time       simulated by wall time over the run; 1 is real time
        overruns        of the simulator
        driving         part of the time in which the tip followed
        headlines       what the page said over its picture, each by how often it was seen
        faults          every FAULT of the run by arm, in its own words
        f10             how many of them were F10, FAULT(link): the robot link fell silent
        depth_per_s     depth pictures that a subscriber got, with --depth
        cpu             CPU seconds per second of each node, Chromium, and all together

With `--depth` the node /eyes computes depth of both eyes beside it all, and a subscriber counts it:
`depth_per_s`. With `--headset` the page is /headset in a headset made of software, whose right hand
moves in a square; its pictures are drawn by software on the same cores.

Goals on 2 cores: age p50 60 ms left and 120 ms stereo, 15 fps, real time 0.98 and no F10, each over
five minutes: `./surg dev bench console --seconds 300 --json FILE`, 11 minutes on a machine that
does nothing else. With `--depth --layout stereo`: 5 depths a second and no F10. With `--headset`:
120 ms and 15 fps.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
from machine import this_machine

from surg_cli.graph import master, processes, running
from surg_cli.host import cells, paths
from surg_cli.host.terminal import Progress, say, table

sys.path.insert(0, str(paths.ROOT / "tests"))

from helpers.teleop.chromium import Chromium, Tab, missing, until
from helpers.teleop.headset import FAKE_XR
from helpers.teleop.headset_drive import squeezed

CIRCLE = ("KeyD", "KeyS", "KeyA", "KeyW")
STEP_S = 0.6
"""[s] in each direction."""
ACTS = {"Held": "Enter", "Waiting": "Space"}
"""What an operator presses who reads that."""
TICK_HZ = 500


@contextlib.asynccontextmanager
async def system(
    cell: str, layout: str, port: int, out: Path, depth: bool
) -> AsyncIterator[tuple[str, running.System]]:
    """A running `./surg teleop`: the page's address and the system's entry."""
    web = master.free_port()
    words = ["teleop", cell, "--port", str(port), "--bind", f"127.0.0.1:{web}", "--out", str(out)]
    words += ["--cameras", "depth" if depth else "left" if layout == "left" else "stereo"]
    log = out.parent / f"teleop_{layout}.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-s", "-m", "surg_cli", *words],
            env={**os.environ, "SURG_READY": "1"},
            cwd=paths.ROOT,
            stdout=stream,
            stderr=subprocess.STDOUT,
        )
    try:

        async def up() -> running.System | None:
            assert process.poll() is None, log.read_text()
            if "Open http" not in log.read_text():
                return None
            return next((s for s in running.systems() if s.port == port and s.nodes), None)

        entry = await until(up, "the system", 120.0, 0.1)
        yield f"http://localhost:{web}/", entry
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


class Listener:
    """The simulator's tick against the wall clock, and what the arms say of a FAULT.

    A process is a ROS node once only: all runs have their master on the same port.
    """

    def __init__(self, port: int, arms: list[str], depth: bool) -> None:
        import rospy
        from sensor_msgs.msg import Image
        from std_msgs.msg import String

        from surg_msgs.msg import SimStatus

        os.environ["ROS_MASTER_URI"] = f"http://localhost:{port}"
        if not rospy.core.is_initialized():
            rospy.init_node("bench_console", anonymous=True, disable_signals=True)
        self.begin()
        self._subscribers = [
            rospy.Subscriber("/sim/status", SimStatus, self._on_status),
            *(rospy.Subscriber(f"/{arm}/error", String, self._on_error, arm) for arm in arms),
        ]
        if depth:
            keys = {"queue_size": 1, "buff_size": 1 << 25}
            found = rospy.Subscriber("/endoscope/depth", Image, self._on_depth, **keys)
            self._subscribers.append(found)

    def begin(self) -> None:
        """Count from now on: what an arm said before it was enabled is latched, and no news."""
        self.seen: list[tuple[float, int, int]] = []
        self.faults: dict[str, list[str]] = {}
        self.depths = 0

    def _on_depth(self, message: Any) -> None:
        self.depths += 1

    def _on_error(self, message: Any, arm: str) -> None:
        self.faults.setdefault(arm, []).append(message.data)

    def _on_status(self, message: Any) -> None:
        self.seen.append((time.monotonic(), message.tick, message.overruns))

    def stop(self) -> None:
        """Look no longer."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def factor(self) -> float:
        """Simulated by wall time."""
        (start, first, _), (end, last, _) = self.seen[0], self.seen[-1]
        return (last - first) / TICK_HZ / (end - start)

    @property
    def overruns(self) -> int:
        """Times that the simulator dropped its backlog."""
        return self.seen[-1][2] - self.seen[0][2]


def cpu_seconds(entry: running.System, browser: int) -> dict[str, float]:
    """CPU time so far of each node and of Chromium with its children [s]."""
    hertz = os.sysconf("SC_CLK_TCK")

    def of(pid: int) -> float:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / hertz

    found = {
        name: sum(map(of, processes.session_members(pid))) for name, pid in entry.nodes.items()
    }
    found["chromium"] = sum(map(of, processes.session_members(browser)))
    return found


async def drive(tab: Tab) -> None:
    """Enable until the tip follows."""

    async def driving() -> bool:
        if await tab.run("document.body.dataset.phase") == "driving":
            return True
        await tab.tap("Enter")
        await asyncio.sleep(1.0)
        return False

    await until(driving, "driving", 120.0)


async def circle(
    tab: Tab, seconds: float, progress: Progress
) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Keys in turn; what the page said meanwhile, and the pictures drawn."""
    await tab.key("Space", True)  # under the clutch the hand changes from mouse to keys
    await asyncio.sleep(0.3)
    await tab.tap("KeyD")
    await asyncio.sleep(0.5)
    await tab.key("Space", False)
    await asyncio.sleep(0.3)  # nobody engages with a key held down
    began, headlines = time.monotonic(), Counter[str]()
    step, drawn = 0, []
    newest = await tab.run("surgConsole.picture.drawn.at(-1).drawnUs")
    while (gone := time.monotonic() - began) < seconds:
        progress.update(gone / seconds)
        code = CIRCLE[step % len(CIRCLE)]
        await tab.key(code, True)
        await asyncio.sleep(STEP_S)
        await tab.key(code, False)
        step += 1
        headline = await tab.run("surgConsole.status()?.headline ?? ''")
        headlines[headline] += 1
        if headline in ACTS:
            await tab.tap(ACTS[headline])
            await asyncio.sleep(0.3)
        # The page keeps its last pictures only: they are fetched as they come.
        fresh = f"surgConsole.picture.drawn.filter(each => each.drawnUs > {newest})"
        drawn += await tab.run(fresh)
        newest = drawn[-1]["drawnUs"] if drawn else newest
    return headlines, drawn


async def square(
    tab: Tab, seconds: float, progress: Progress
) -> tuple[Counter[str], list[dict[str, Any]]]:
    """The right hand of a headset, in turn; as `circle`."""
    began, headlines, step = time.monotonic(), Counter[str](), 0
    first = await tab.run("surgHeadset.picture.drawn.at(-1).drawnUs")
    while (gone := time.monotonic() - began) < seconds:
        progress.update(gone / seconds)
        headlines[await tab.run("surgHeadset.status()?.headline ?? ''")] += 1
        if await tab.run("surgHeadset.status()?.headline") != "Following":
            await squeezed(tab, "right", "Following")
        x, y = ((1, 0), (0, -1), (-1, 0), (0, 1))[step % 4]
        for _ in range(12):
            await tab.run(f"fakeXR.move('right', [{0.003 * x}, {0.003 * y}, 0])")
            await asyncio.sleep(STEP_S / 12)
        step += 1
    shown = f"surgHeadset.picture.drawn.filter(each => each.drawnUs > {first})"
    return headlines, list(await tab.run(shown))


async def ready(browser: Chromium, url: str, layout: str) -> Tab:
    """The page, following the hand, and a recording."""
    if layout == "headset":
        tab = await browser.open(f"{url}headset", FAKE_XR)
        await tab.until("!document.querySelector('#enter').disabled", "the headset", 60.0)
        await tab.click("#enter")
        await tab.until("surgHeadset.picture.drawn.length > 20", "pictures", 180.0)
        await squeezed(tab, "right", "Following")
        await tab.run("surgHeadset.link.press('record'), 0")
        return tab
    tab = await browser.open(url)
    await tab.until("surgConsole.picture.drawn.length > 20", "pictures", 180.0)
    if layout == "stereo":
        await tab.click('#eyes [data-layout="stereo"]')
        await tab.until("surgConsole.picture.drawn.at(-1).width > 1000", "both eyes", 60.0)
    await drive(tab)
    await tab.tap("KeyV")
    return tab


async def measure(
    cell: str, layout: str, seconds: float, port: int, folder: Path, depth: bool
) -> dict[str, Any]:
    """One run."""
    running_system = system(cell, layout, port, folder / layout, depth)
    async with running_system as (url, entry), Chromium() as browser:
        tab = await ready(browser, url, layout)
        listener = Listener(entry.port, list(cells.load(Path(entry.cell)).arms), depth)
        await asyncio.sleep(1.0)  # what an arm has said last comes at once
        listener.begin()
        before = cpu_seconds(entry, browser.process.pid)
        started = time.monotonic()
        with Progress(f"{layout}, {seconds:.0f} s") as progress:
            move = square if layout == "headset" else circle
            headlines, drawn = await move(tab, seconds, progress)
        wall = time.monotonic() - started
        after = cpu_seconds(entry, browser.process.pid)
        listener.stop()
        if layout == "headset":
            await tab.run("surgHeadset.link.press('record_stop'), 0")
        else:
            await tab.tap("KeyV")
        await tab.tap("Escape")
        await asyncio.sleep(2.0)
    ages = np.array([each["ageMs"] for each in drawn])

    def part_ms(start: str, end: str) -> float:
        return float(np.median([each[end] - each[start] for each in drawn])) / 1e3

    used = {name: (after[name] - before[name]) / wall for name in after}
    return {
        "layout": layout,
        "codec": drawn[-1]["codec"],
        "seconds": wall,
        "pictures": len(drawn),
        "fps": len(drawn) / wall,
        "age_ms": {
            "p50": float(np.percentile(ages, 50)),
            "p99": float(np.percentile(ages, 99)),
            "max": float(ages.max()),
        },
        "parts_ms": {
            "exposure to encoder": part_ms("exposedUs", "receivedUs"),
            "encoding": part_ms("receivedUs", "encodedUs"),
            "transport": part_ms("encodedUs", "arrivedUs"),
            "decoding and drawing": part_ms("arrivedUs", "drawnUs"),
        },
        "real_time": listener.factor(),
        "overruns": listener.overruns,
        "driving": headlines["Following"] / headlines.total(),
        "headlines": dict(headlines),
        "faults": listener.faults,
        "f10": sum("FAULT(link)" in text for said in listener.faults.values() for text in said),
        "depth_per_s": listener.depths / wall if depth else None,
        "cpu": {**used, "all": sum(used.values())},
    }


def show(runs: list[dict[str, Any]]) -> None:
    """Print the figures."""
    head = ["layout", "age p50", "p99", "fps", "real time", "following", "CPU", "F10", "FAULTs"]
    rows = [[*head, "depths/s"]]
    for run in runs:
        rows.append(
            [
                run["layout"],
                f"{run['age_ms']['p50']:.1f} ms",
                f"{run['age_ms']['p99']:.1f} ms",
                f"{run['fps']:.1f}",
                f"{run['real_time']:.3f}",
                f"{100 * run['driving']:.0f} %",
                f"{run['cpu']['all']:.2f}",
                str(run["f10"]),
                str(sum(map(len, run["faults"].values()))),
                "–" if run["depth_per_s"] is None else f"{run['depth_per_s']:.1f}",
            ]
        )
    say(table(rows))
    for run in runs:
        parts = ", ".join(f"{name} {value:.1f} ms" for name, value in run["parts_ms"].items())
        say(f"  {run['layout']}: {parts}")
        said = ", ".join(f"'{text}' {count}" for text, count in run["headlines"].items())
        say(f"  {run['layout']}: the page said {said}")
        for text in (text for said in run["faults"].values() for text in said):
            say(f"    {text}")


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="./surg dev bench console", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--cell", default="sim_two_arms", help="default sim_two_arms")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of each run (default 60; goals: 300)"
    )
    parser.add_argument("--layout", choices=("left", "stereo", "both"), default="both")
    parser.add_argument("--depth", action="store_true", help="depth of both eyes beside it")
    parser.add_argument("--headset", action="store_true", help="the page /headset instead")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    if missing():
        say(f"bench console: {missing()}")
        return 1
    layouts = ("left", "stereo") if options.layout == "both" else (options.layout,)
    if options.headset:
        layouts = ("headset",)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="surg_bench_console_") as folder:
        port = master.free_port()
        runs = [
            asyncio.run(
                measure(options.cell, layout, options.seconds, port, Path(folder), options.depth)
            )
            for layout in layouts
        ]
    show(runs)
    if options.json:
        machine = this_machine(load)
        result = {"format": "surg_bench_console/1", "machine": machine, "runs": runs}
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
