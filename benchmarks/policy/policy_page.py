"""The figures as a table: on the terminal, and on docs/results/benchmark_policy.md."""

from __future__ import annotations

from typing import Any

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "results" / "benchmark_policy.md"
TEXT = """# The policies' wire beside others

`./surg dev bench policy --page`: stereo 640x480 RGB and a state from the robot's process to the
policy's, a chunk of 50x8 back, over loopback. *ours*: `surg_policy_client.serve` with every check
of [the protocol](../reference/protocol.md); plain msgpack has none. The server for openpi's client
is ours. With the memory settings of the platform's nodes openpi's client took 1.6 to 1.8 times as
long as ours.
"""
WHAT = {
    "ours_tcp": "ours, TCP",
    "ours_ipc": "ours, a Unix socket",
    "ours_curve": "ours, TCP, encrypted (CURVE)",
    "msgpack_zmq": "plain msgpack in one frame, ZeroMQ over TCP",
    "peer_openpi_ws": "openpi-client {openpi}, websocket",
}


def tables(result: dict[str, Any]) -> list[tuple[str, list[list[str]]]]:
    """Heading and rows."""
    found = result["round_trip_ms"]
    ours = found["ours_tcp"]["p50"]
    rows = [["way", "p50, ms", "p99, ms", "p50 to ours over TCP", "processor time, ms"]]
    for name, figures in found.items():
        what = WHAT[name].format(openpi=result["machine"].get("openpi_client", ""))
        ratio = f"{figures['p50'] / ours:.2f}"
        cpu = f"{result['cpu_ms'][name]:.2f}"
        rows.append([what, f"{figures['p50']:.2f}", f"{figures['p99']:.2f}", ratio, cpu])
    return [("Round trip", rows)]


def head(result: dict[str, Any]) -> str:
    """What the generated part begins with."""
    machine = result["machine"]
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['date']}; {machine['rounds']} "
        f"rounds of each in {machine['blocks']} blocks; load before {machine['load_before'][0]:g}."
    )
