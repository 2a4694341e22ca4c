"""Verdicts on the synchronisation of an episode."""

from __future__ import annotations

from collections.abc import Sequence

PASS, FAIL, CANNOT_TELL = "pass", "fail", "cannot_tell"


def worst(verdicts: Sequence[str]) -> str:
    """``fail`` if any failed, otherwise ``cannot_tell`` if any is open, otherwise ``pass``."""
    return next((verdict for verdict in (FAIL, CANNOT_TELL) if verdict in verdicts), PASS)
