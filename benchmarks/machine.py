"""The machine that a benchmark runs on."""

import datetime
import os
from pathlib import Path


def processor() -> str:
    """Name of the processor."""
    lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else "unknown"


def this_machine(load_before: float) -> dict[str, object]:
    """What a result says of its machine, at the end of a run.

    Args:
        load_before: ``os.getloadavg()[0]`` at its beginning.
    """
    return {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load_before": load_before,
        "load_after": os.getloadavg()[0],
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
