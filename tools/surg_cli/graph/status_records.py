"""What result files keep of a status message; their keys stay as they are."""

from __future__ import annotations

import math
from typing import Any

from surg_core.status_check import value_name


def policy_record(status: Any) -> dict[str, Any]:
    """A surg_msgs/PolicyStatus as ``outcome.json`` and the learning reports keep it."""
    return {
        "state": value_name(status, "state"),
        "reason": status.detail,
        "waiting": status.waiting,
        "session": status.session or None,
        "client": status.client,
        "policy": status.policy,
        "episode": status.episode,
        "queue": status.queue,
        "period_ms": 1e3 * status.period,
        "accepted": status.accepted,
        "clipped": status.clipped,
        "rejected": status.rejected,
        "rejected_by_rule": dict(zip(status.rejected_rules, status.rejected_by_rule, strict=True)),
        "late": status.late,
        "stale": status.stale,
        "empty": status.empty,
        "waited": status.waited,
        "messages": status.messages,
        "malformed": dict(zip(status.malformed_codes, status.malformed, strict=True)),
        "flooded": status.flooded,
        "strangers": status.strangers,
        "sessions": status.sessions,
        "obs_age_ms": _spread(status.obs_age_p50, status.obs_age_p99),
        "round_trip_ms": _spread(status.round_trip_p50, status.round_trip_p99),
        "refused": status.refused,
        "address": status.address,
    }


def _spread(p50: float, p99: float) -> dict[str, float | None]:
    """Median and 99th percentile [ms]; None: nothing was measured."""
    if not math.isfinite(p50):
        return {"p50": None, "p99": None}
    return {"p50": round(1e3 * p50, 3), "p99": round(1e3 * p99, 3)}
