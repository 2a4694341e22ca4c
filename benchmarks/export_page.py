"""The figures of `./surg dev bench export` as tables: on the terminal and on their page."""

from __future__ import annotations

import statistics
from typing import Any

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "results" / "benchmark_export.md"
TEXT = """# The export beside lerobot's own writer

`./surg dev bench export --page`: two stereo recordings (2 × 640×480, 20 fps, texture) exported
as LeRobot 3.0, and written by lerobot from the same pictures with the same codec settings, in
turns. Ours also resamples and reads back. lerobot encodes one camera after the other.
"""

Rows = list[list[str]]


def tables(result: dict[str, Any]) -> list[tuple[str, Rows]]:
    """(heading, rows with a header) in the order in which they are shown."""
    rows = [["writer", "frames", "frames/s", "CPU, ms per frame", "memory, MiB"]]
    for writer in dict.fromkeys(row["writer"] for row in result["rows"]):
        runs = [row for row in result["rows"] if row["writer"] == writer]
        pace = statistics.median(row["frames"] / row["wall_s"] for row in runs)
        cpu = statistics.median(1000 * row["cpu_s"] / row["frames"] for row in runs)
        memory = max(row["memory_mib"] for row in runs)
        figures = [f"{pace:.1f}", f"{cpu:.1f}", f"{memory:.0f}"]
        rows.append([writer, str(runs[0]["frames"]), *figures])
    return [("Frames per second and memory", rows)]


def head(result: dict[str, Any]) -> str:
    """What the generated part begins with."""
    machine = result["machine"]
    return (
        f"{machine['date']}, {machine['cores']} cores of {machine['processor']}, load "
        f"{machine['load_before']:.1f} before; medians of {result['rounds']} turns, largest memory."
    )
