"""What ``sync.json`` found, as a section of a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from surg_recording.reports.html_page import number, text

_WORDS = {
    "pass": ("ok", "The streams are synchronised"),
    "fail": ("bad", "The streams are not synchronised"),
    "cannot_tell": ("", "Synchronisation unknown"),
}


def section(found: Mapping[str, Any]) -> str:
    """The section for a report.

    Args:
        found: the result of ``sync_report.make`` or ``load``.
    """
    style, title = _WORDS.get(found["verdict"], ("", "Synchronisation"))
    reasons = "".join(f"<li>{text(reason)}</li>" for reason in found.get("reasons") or [])
    rows = [_clock(found)]
    skew = found.get("skew_s")
    if skew:
        words = ", ".join(f"{key} {number(skew[key] * 1e3)}" for key in ("p50", "p95", "max"))
        rows.append(("Skew between streams", f"{words} ms (reference: {found.get('reference')})"))
    for camera, lag in (found.get("video_lag") or {}).items():
        rows.append((f"Video against kinematics, {camera}", lag.get("reason")))
    cells = "".join(f"<tr><th>{text(name)}</th><td>{text(said)}</td></tr>" for name, said in rows)
    return (
        f"<section class='verdict {style}'><h2>{text(title)}</h2>"
        f"{f'<ul>{reasons}</ul>' if reasons else ''}<table>{cells}</table></section>"
    )


def _clock(found: Mapping[str, Any]) -> tuple[str, str]:
    """What was known of the machines' clocks."""
    clock = found.get("clock") or {}
    if found.get("offset_s") is None:
        return "Clocks", "; ".join(clock.get("reasons") or []) or "no offset was measured"
    delay = found.get("path_delay_s")
    words = f"at most {abs(found['offset_s']) * 1e6:.1f} µs off the master {found['grandmaster']}"
    return "Clocks", words + (f", path delay {delay * 1e6:.1f} µs" if delay is not None else "")
