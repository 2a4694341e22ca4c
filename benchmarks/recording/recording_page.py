"""The figures as tables: on the terminal, and on docs/results/benchmark_recording.md."""

from __future__ import annotations

from typing import Any

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "results" / "benchmark_recording.md"
TEXT = """# The recorder beside rosbag

`./surg dev bench recording --page`: the bead transfer between two arms with the stereo endoscope
(2 × 640×480, 20 fps, 500 Hz cycles), simulated. In free-run both record the same topics at the same
time; rosbag keeps raw pictures and runs longer. In lock-step every tick must be a row.
"""

Rows = list[list[str]]


def side_by_side(found: dict[str, Any]) -> Rows:
    """CPU and size of both, one under the other."""
    rows = [["", "CPU, % of one core", "MB per minute"]]
    ours, theirs, seconds = found["recorder"], found["rosbag"], found["seconds"]
    rows.append(["recorder", f"{ours['cpu_percent']:.0f}", f"{ours['mb_per_min']:.0f}"])
    for name, key in (("its node", "node_cpu_s"), ("its two encoders", "encoders_cpu_s")):
        rows.append([f"… {name}", f"{100 * ours[key] / seconds:.0f}", ""])
    rows.append(["rosbag record", f"{theirs['cpu_percent']:.0f}", f"{theirs['mb_per_min']:.0f}"])
    if ours["mb_per_min"] > 0 and theirs["cpu_percent"] > 0:
        cpu = ours["cpu_percent"] / theirs["cpu_percent"]
        size = theirs["mb_per_min"] / ours["mb_per_min"]
        rows.append(["recorder to rosbag", f"{cpu:.1f} × the CPU", f"1/{size:.1f} of the size"])
    return rows


def messages(found: dict[str, Any]) -> Rows:
    """What both hold of each topic, and what was dropped."""
    rows = [["topic", "in the episode", "in the bag"]]
    for topic, count in found["messages"].items():
        rows.append([topic, str(count["rows"]), str(count["rosbag"])])
    drops = ", ".join(f"{name} {count}" for name, count in found["drops"].items()) or "none"
    missing = f"{found['cycle_drops']}, {found['missing_ticks']}; {drops}"
    rows.append(["cycles dropped, ticks missing; dropped in all", missing, "–"])
    return rows


def in_step(found: dict[str, Any]) -> Rows:
    """Expected and recorded, of all tables and of all eyes."""
    rows = [["", "expected", "recorded", "missing"]]
    written, frames = found["rows"], found["frames"]
    expected = found["ticks"] * len(written)
    missing = sum(found["missing_ticks"].values())
    rows.append(
        [f"rows of {len(written)} tables", *map(str, (expected, sum(written.values()), missing))]
    )
    expected, kept = found["expected_frames"] * len(frames), sum(frames.values())
    rows.append([f"frames of {len(frames)} eyes", *map(str, (expected, kept, expected - kept))])
    rows.append(["outcome", "complete", "complete" if found["complete"] else found["reason"], ""])
    return rows


def tables(result: dict[str, Any]) -> list[tuple[str, Rows]]:
    """(heading, rows with a header) in the order in which they are shown."""
    found = [
        ("Free-run: cost", side_by_side(result["freerun"])),
        ("Free-run: what was kept", messages(result["freerun"])),
    ]
    if result["lockstep"] is not None:
        found.append(("Lock-step: complete to the tick", in_step(result["lockstep"])))
    return found


def head(result: dict[str, Any]) -> str:
    """What the generated part begins with."""
    machine = result["machine"]
    return (
        f"{machine['date']}, {machine['cores']} cores of {machine['processor']}, load "
        f"{machine['load_before']:.1f} before; {result['freerun']['seconds']:.0f} s of free-run."
    )
