"""What result files keep of a status message; their keys stay as they are."""

from __future__ import annotations

import math
from typing import Any

from surg_core.status_check import value_name

AS_SENT = (
    *("waiting", "client", "policy", "episode", "queue", "accepted", "clipped", "rejected"),
    *("late", "stale", "empty", "waited", "messages", "flooded", "strangers", "sessions"),
    *("refused", "address"),
)
"""Fields that are kept under their own names."""


def policy_record(status: Any) -> dict[str, Any]:
    """A surg_msgs/PolicyStatus as ``outcome.json`` and the learning reports keep it."""
    return {
        "state": value_name(status, "state"),
        "reason": status.detail,
        "session": status.session or None,
        "period_ms": 1e3 * status.period,
        "rejected_by_rule": dict(zip(status.rejected_rules, status.rejected_by_rule, strict=True)),
        "malformed": dict(zip(status.malformed_codes, status.malformed, strict=True)),
        "obs_age_ms": _spread(status.obs_age_p50, status.obs_age_p99),
        "round_trip_ms": _spread(status.round_trip_p50, status.round_trip_p99),
        **{name: getattr(status, name) for name in AS_SENT},
    }


def _spread(p50: float, p99: float) -> dict[str, float | None]:
    """Median and 99th percentile [ms]; None: nothing was measured."""
    if not math.isfinite(p50):
        return {"p50": None, "p99": None}
    return {"p50": round(1e3 * p50, 3), "p99": round(1e3 * p99, 3)}
