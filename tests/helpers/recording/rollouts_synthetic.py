"""Made-up roll-outs of a policy: what each comes to is known by construction."""

from __future__ import annotations

from typing import Any

from surg_recording.reports import learning


def entry(
    seed: int, success: bool = True, rcm: float = 0.01, sparc: float = -3.0
) -> dict[str, Any]:
    """As `trials.describe` makes it."""
    return {
        "seed": seed,
        "setting": "phantom",
        "law": "ours",
        "success": success,
        "failure_reason": None if success else "the robot lost its grasp",
        "phase": "done" if success else "retract",
        "duration_s": 12.0,
        "played": True,
        "rcm_kinematic_mm": {"mean": rcm / 2, "median": rcm / 2, "p95": rcm, "max": rcm},
        "rcm_true_mm": {"mean": 0.2, "median": 0.2, "p95": 0.3, "max": 0.4},
        "smoothness": {"preset": "reference", "sparc": sparc, "ldlj": -9.0},
        "state_hash": "ab" * 32,
    }


SERVED = {
    "rejected": 1,
    "clipped": 2,
    "late": 0,
    "obs_age_ms": {"p50": 50.0, "p99": 100.0},
    "round_trip_ms": {"p50": 0.6, "p99": 2.0},
}


def rollout(seed: int, unsafe: int | None = 0, served: Any = SERVED, **of: Any) -> dict[str, Any]:
    """As `learning.roll_out` makes it; ``unsafe``: commands, None: no recording."""
    found = learning.roll_out(entry(seed, **of), served, None)
    if unsafe is not None:
        found["unsafe"] = {"cycles": 6000, "commands": unsafe, "rules": {"joint velocity": unsafe}}
    return found
