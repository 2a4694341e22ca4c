"""The endoscope of a system in real time: the cell's source of pictures, or the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from surg_cli.host.terminal import Problem

EYES = ("left", "right")


@dataclass(frozen=True)
class Endoscope:
    """Views that are published, and the capture node's parameters (None: the simulator's)."""

    views: tuple[str, ...]
    capture: dict[str, object] | None = None


def of_cell(config: Any, simulated: bool, stereo: bool, lockstep: bool = False) -> Endoscope:
    """The endoscope of a ``surg_core`` CellConfig.

    Args:
        config: The cell.
        simulated: Whether the simulator drives an arm, so that it can render.
        stereo: Both eyes of the simulator's; those of a source are what its layout holds.
        lockstep: Whether time is simulated.

    Raises:
        Problem: A real endoscope in simulated time.
    """
    stated = config.endoscope
    if stated is None:
        return Endoscope(EYES[: 1 + stereo] if simulated else ())
    if lockstep:
        raise Problem(
            f"--lock-step: {config.file}: endoscope.source: {stated.source} delivers pictures in "
            "real time; omit --lock-step, or add --no-video",
            2,
        )
    width, height = stated.size
    params: dict[str, object] = {
        "source": stated.source,
        "layout": stated.layout,
        "width": width,
        "height": height,
        "rate": stated.rate,
        "swap": stated.swap,
        "flip": stated.flip,
        "latency": stated.latency,
    }
    return Endoscope(EYES[: 1 + (stated.layout != "mono")], params)
