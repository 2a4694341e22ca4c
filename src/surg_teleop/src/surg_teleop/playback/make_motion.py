"""Writes the bundled motion from a formula, so that the file is always the same.

    python3 -m surg_teleop.playback.make_motion motions/bundled.csv

The motion resembles laparoscopic work: reaches, dwells, the loops of a knot, pulls. Every move has
minimum jerk (10 u^3 - 15 u^4 + 6 u^5 along a line or an arc), as a practised hand moves. A
physiological tremor is added: four sines per axis between 8 and 11 Hz, 0.052 mm rms per axis. The
motion starts and ends at rest in one place, so it can be repeated. Axes as in the rcm frame: z into
the patient.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from surg_core.arm_view import Array

RATE = 100
"""[Hz] Ten samples per period of the fastest tremor."""
DURATION = 60.0
"""[s]"""
TREMOR_RMS = 0.052e-3
"""[m] Per axis; 0.09 mm over all three."""
TREMOR_HZ = np.array([[8.4, 9.1, 9.7, 10.6], [8.2, 9.3, 10.0, 10.4], [8.6, 8.9, 9.9, 10.8]])
"""[Hz] Four sines per axis, none a simple ratio of another."""
TREMOR_PHASE = np.array([[0.3, 2.1, 4.4, 5.2], [1.7, 3.9, 0.9, 2.8], [5.8, 1.2, 3.3, 0.1]])
"""[rad]"""
TREMOR_FADE = 0.5
"""[s] Time of fading in and out, so that both ends are at rest."""

MM = 1e-3


@dataclass(frozen=True)
class Segment:
    """A piece of the motion: position, roll and gripper over u in [0, 1]."""

    duration: float
    position: Callable[[Array], Array]
    roll: tuple[float, float]
    gripper: tuple[float, float]


@dataclass
class Script:
    """A sequence of segments; each starts where the last one ended."""

    p: Array  # (3,) where the hand is [m]
    roll: float = 0.0  # its roll [rad]
    gripper: float = 0.0  # its opening [rad]
    segments: list[Segment] = field(default_factory=list)

    def move(
        self,
        x: float,
        y: float,
        z: float,
        duration: float,
        roll: float | None = None,
        gripper: float | None = None,
    ) -> None:
        """A straight minimum-jerk move to a point [mm], with roll and gripper [rad] on the way."""
        start, end = self.p, np.array([x, y, z]) * MM
        self._add(duration, lambda u: start + np.outer(u, end - start), end, roll, gripper)

    def dwell(
        self, duration: float, roll: float | None = None, gripper: float | None = None
    ) -> None:
        """Stay; only roll and gripper [rad] may change."""
        here = self.p
        self._add(duration, lambda u: np.tile(here, (len(u), 1)), here, roll, gripper)

    def loop(
        self,
        centre: tuple[float, float, float],
        normal: tuple[float, float, float],
        turns: float,
        advance: float,
        duration: float,
        roll: float | None = None,
    ) -> None:
        """Turn about an axis through a point [mm], and advance along the axis [mm]."""
        n = np.array(normal) / np.linalg.norm(normal)
        c = np.array(centre) * MM
        start = self.p
        axial = n * float(n @ (start - c))
        e1 = start - c - axial
        e2 = np.cross(n, e1)

        def position(u: Array) -> Array:
            angle = 2.0 * np.pi * turns * u
            circle = np.outer(np.cos(angle), e1) + np.outer(np.sin(angle), e2)
            turned: Array = c + axial + circle + np.outer(u, advance * MM * n)
            return turned

        self._add(duration, position, position(np.array([1.0]))[0], roll, None)

    def _add(
        self,
        duration: float,
        position: Callable[[Array], Array],
        end: Array,
        roll: float | None,
        gripper: float | None,
    ) -> None:
        roll_end = self.roll if roll is None else roll
        gripper_end = self.gripper if gripper is None else gripper
        self.segments.append(
            Segment(duration, position, (self.roll, roll_end), (self.gripper, gripper_end))
        )
        self.p, self.roll, self.gripper = end, roll_end, gripper_end


def bundled_script() -> Script:
    """The bundled motion without its tremor: 60 s, box about 60 x 56 x 54 mm."""
    script = Script(p=np.zeros(3))
    script.dwell(1.0)
    # Reach for the tissue, open, grasp, pull it up and to the side.
    script.move(18, -12, 14, 1.6, roll=0.3, gripper=0.6)
    script.dwell(0.6)
    script.move(24, -18, 25, 1.2, roll=0.5)
    script.dwell(0.8, gripper=0.05)
    script.move(10, -6, 2, 2.2, roll=0.2)
    script.dwell(0.7)
    script.move(-28, 8, 20, 1.3, roll=-0.3)
    script.dwell(0.5, gripper=0.5)
    # Two throws of a knot round a point in the middle.
    script.move(-12, 0, 8, 1.3, roll=0.0, gripper=0.1)
    script.loop((0, 0, 8), (0, 0, 1), 1.0, 4, 2.6, roll=0.7)
    script.loop((0, 0, 12), (0, 0.3, 1), -1.0, -3, 2.4, roll=-0.4)
    script.dwell(0.4)
    # Pull the knot tight: a long brisk pull, and back.
    script.move(32, 10, 22, 1.0, roll=-0.1)
    script.dwell(0.8)
    script.move(-26, -16, 16, 1.1, roll=0.4)
    script.dwell(0.6, gripper=0.45)
    # Look for the next place, nearer to the trocar and slower.
    script.move(-14, 12, -18, 2.4, roll=0.1, gripper=0.2)
    script.dwell(0.7)
    script.move(12, 26, -27, 2.6, roll=-0.5)
    script.dwell(0.5)
    script.loop((4, 20, -24), (1, 0, 0.4), 1.0, 3, 2.6, roll=-0.2)
    script.move(20, 28, 2, 2.0, roll=0.2, gripper=0.5)
    script.dwell(0.6, gripper=0.05)
    # Sweep across, twice, deep: the largest swing of the shaft.
    script.move(-26, -24, 20, 1.5, roll=0.6)
    script.dwell(0.5)
    script.move(26, 20, 24, 1.25, roll=-0.3)
    script.dwell(0.4)
    script.move(-20, 22, 10, 1.3, roll=0.1)
    script.dwell(0.5, gripper=0.35)
    # Three small stitches.
    for step in range(3):
        x = -16 + 11 * step
        script.move(x, 14, 20, 0.9, roll=0.5, gripper=0.05)
        script.loop((x + 5, 14, 20), (0, 1, 0), 0.5, -2, 1.2, roll=-0.5)
        script.move(x + 8, 6, 4, 0.9, roll=0.0, gripper=0.3)
    script.dwell(0.5)
    script.move(28, -28, 12, 1.6, roll=0.3)
    script.dwell(0.6, gripper=0.0)
    script.move(-8, -28, -8, 2.2, roll=-0.2)
    script.loop((-8, -18, -8), (0.2, 0, 1), -1.0, 6, 2.8, roll=0.2)
    script.dwell(0.4)
    script.move(-28, -4, 24, 1.5, roll=0.0)
    script.dwell(0.5)
    # Home again, and rest until the minute is full.
    script.move(0, 0, 0, 2.0, roll=0.0, gripper=0.0)
    used = sum(segment.duration for segment in script.segments)
    script.dwell(DURATION - used)
    return script


def minimum_jerk(u: Array) -> Array:
    """10 u^3 - 15 u^4 + 6 u^5: from 0 to 1 with no velocity and no acceleration at the ends."""
    shape: Array = u**3 * (10.0 + u * (-15.0 + 6.0 * u))
    return shape


def tremor(t: Array) -> Array:
    """Hand tremor (n, 3) [m] at times (n,) [s]; zero at both ends of the motion."""
    amplitude = TREMOR_RMS * np.sqrt(2.0 / TREMOR_HZ.shape[1])
    angle = 2.0 * np.pi * TREMOR_HZ[None] * t[:, None, None] + TREMOR_PHASE[None]
    edge = np.clip(np.minimum(t, DURATION - t) / TREMOR_FADE, 0.0, 1.0)
    shaking: Array = minimum_jerk(edge)[:, None] * amplitude * np.sin(angle).sum(axis=2)
    return shaking


def bundled_motion() -> Array:
    """The bundled motion, (n, 6): t [s], x, y, z [m], roll, gripper [rad]; at RATE."""
    script = bundled_script()
    t = np.arange(round(DURATION * RATE) + 1) / RATE
    columns = np.empty((len(t), 6))
    columns[:, 0] = t
    begin = 0.0
    for segment in script.segments:
        inside = (t >= begin - 1e-9) & (t <= begin + segment.duration + 1e-9)
        u = minimum_jerk(np.clip((t[inside] - begin) / segment.duration, 0.0, 1.0))
        columns[inside, 1:4] = segment.position(u)
        columns[inside, 4] = segment.roll[0] + u * (segment.roll[1] - segment.roll[0])
        columns[inside, 5] = segment.gripper[0] + u * (segment.gripper[1] - segment.gripper[0])
        begin += segment.duration
    columns[:, 1:4] += tremor(t)
    return columns


def write_motion(path: Path) -> None:
    """Write the bundled motion as CSV, with positions to 0.1 µm: its jerk stays smooth."""
    lines = ["t_s,x_m,y_m,z_m,roll_rad,gripper_rad"]
    lines += [
        f"{t:.2f},{x:.7f},{y:.7f},{z:.7f},{roll:.5f},{gripper:.4f}"
        for t, x, y, z, roll, gripper in bundled_motion() + 0.0
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python3 -m surg_teleop.playback.make_motion OUT.csv")
    write_motion(Path(sys.argv[1]))
