"""The section of a report about synchronisation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from surg_recording.reports import html_page
from surg_recording.reports.html_page import bullets, facts, number

_TITLES = {
    "pass": ("ok", "The streams are synchronised"),
    "fail": ("bad", "The streams are not synchronised"),
    "cannot_tell": ("", "Synchronisation unknown"),
}


def section(report: Mapping[str, Any]) -> Markup:
    """The section about a sync report."""
    verdict, title = _TITLES.get(report["verdict"], ("", "Synchronisation"))
    rows = [("Clocks", _clocks(report))]
    if skew := report.get("skew_s"):
        levels = ", ".join(f"{key} {number(skew[key] * 1e3)}" for key in ("p50", "p95", "max"))
        rows.append(("Skew between streams", f"{levels} ms (reference: {report.get('reference')})"))
    for camera, lag in (report.get("video_lag") or {}).items():
        rows.append((f"Video against kinematics, {camera}", lag.get("reason")))
    reasons = bullets(report.get("reasons") or [])
    return html_page.section(title, reasons, facts(rows), verdict=verdict)


def _clocks(report: Mapping[str, Any]) -> str:
    if report.get("offset_s") is None:
        reasons = (report.get("clock") or {}).get("reasons")
        return "; ".join(reasons or []) or "no offset was measured"
    offset = f"at most {abs(report['offset_s']) * 1e6:.1f} µs off the master"
    delay = report.get("path_delay_s")
    path = "" if delay is None else f", path delay {delay * 1e6:.1f} µs"
    return f"{offset} {report['grandmaster']}{path}"
