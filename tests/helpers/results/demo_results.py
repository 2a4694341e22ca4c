"""docs/results/main_job.md: the demonstration on every robot, mode and law."""

from __future__ import annotations

from typing import Any

from helpers.results.results_page import ResultsPage

BUNDLED = "ur5e, cartesian, bundled"
THIRD_ARM = "third arm, cartesian, bundled"
PAPER, OPEN_LOOP = f"{BUNDLED}, `--law paper`", f"{BUNDLED}, `--law open-loop`"
LONG = f"{BUNDLED} repeated for 600 s, free-run"
_PAGE = ResultsPage("main_job.md")


def note(name: str, s: dict[str, Any]) -> None:
    """Print and keep the summary of a demonstration."""
    rcm, true, tip = s["rcm_kinematic_mm"], s["rcm_true_mm"], s["tip_error_mm"]
    path, trocar = s["path_length_mm"], s["trocar"]
    cells = (
        f"{rcm['mean']:.4f} / {true['max']:.3f}",
        f"{tip['rms']:.3f} / {tip['max']:.2f}",
        f"{s['tip_lag_ms']:.1f}",
        f"{path['input']:.0f} → {path['executed']:.0f}",
        f"{trocar['force_n']['max']:.2f}",
    )
    _PAGE.note(name, None, " | ".join(cells))
