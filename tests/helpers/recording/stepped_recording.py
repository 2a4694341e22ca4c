"""A recording in real time during which somebody sets the clock."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

from helpers.recording import datasets_synthetic, picture_identity
from helpers.recording import recording_synthetic as base
from helpers.recording.datasets_synthetic import IMAGE_TICKS
from helpers.recording.picture_identity import Identity
from helpers.recording.recording_synthetic import TICK_NS, Synthetic
from surg_recording.episode.episode_recorder import Recording

START_NS = 1_732_000_000_000_000_000
LATENCY_NS = 300_000
"""Of a cycle, from its stamp to its reception."""
IMAGE_LATENCY_TICKS = 30
"""Of a picture: one that is stamped before a step is received after it."""
CAMERA = "endoscope_left"


@dataclasses.dataclass
class Stepped:
    """What to record: the clock is set at some ticks by so much [ns]."""

    seconds: float
    steps: tuple[tuple[int, int], ...]
    identity: int = 1
    sender_is_set: bool = True
    """Whether the senders' clock is the one that is set."""
    machines: int = 1

    def wall_ns(self, tick: int, is_set: bool = True) -> int:
        """Wall clock at a tick."""
        moved = sum(step for at, step in self.steps if tick >= at)
        return START_NS + tick * TICK_NS + (moved if is_set else 0)

    def true_s(self, wall_ns: int, segment: int) -> float:
        """Time since the start that the clock meant in a segment (from 0)."""
        moved = sum(step for _, step in self.steps[:segment])
        return (wall_ns - moved - START_NS) * 1e-9

    def record(self, folder: Path) -> Path:
        """Record it; picture n is taken at tick 25 n."""
        what = Synthetic(seconds=self.seconds)
        run = {"robot": "ur5e", "task": "synthetic", "instruction": "follow the path"}
        run["machines"] = self.machines
        recorder = Recording(
            folder,
            mode="freerun",
            arms=["PSM1"],
            cameras=[CAMERA],
            manifest={
                "run": run,
                "task": "synthetic",
                "started_ns": self.wall_ns(0),
                "cell": {"name": "made up", "arms": {"PSM1": datasets_synthetic._arm("ur5e")}},
            },
            min_free_bytes=0,
        )
        last = round(self.seconds / 0.002)
        for tick in range(1, last + 1):
            stamp = self.wall_ns(tick, self.sender_is_set)
            received = self.wall_ns(tick) + LATENCY_NS
            message = base.cycle(what, tick, 1)
            message.header = base.header(stamp)
            early = base.pose(what, tick)
            recorder.command("PSM1", "servo_cp", early, "/operator", received)
            steps = [step for at, step in self.steps if at == tick]
            if steps and tick % 2:  # the thread of the cycles had read the clock before the step
                received -= steps[0]
                stamp -= steps[0] if self.sender_is_set else 0
                message.header = base.header(stamp)
            if steps:
                recorder.clock_stepped(steps[0], self.wall_ns(tick))
            recorder.cycle("PSM1", message, received)
            taken = tick - IMAGE_LATENCY_TICKS
            if taken > 0 and taken % IMAGE_TICKS == 0:
                shown = picture_identity.draw(Identity(self.identity, 0, taken // IMAGE_TICKS))
                stamp = self.wall_ns(taken, self.sender_is_set)
                image = datasets_synthetic._message(shown, stamp)
                recorder.image(CAMERA, image, self.wall_ns(tick))
                while recorder.status()["backlog"]["frames"] > 20:
                    time.sleep(0.002)
        return recorder.close({"stopped_ns": self.wall_ns(last)})
