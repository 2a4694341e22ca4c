"""docs/results/main_job.md: the demonstration on every robot, mode and law."""

from __future__ import annotations

from typing import Any

from helpers.results.results_page import ResultsPage

_HEAD = """# The main job: measured

Written by `SURG_TEST_MOTION=FILE ./surg test --full tests/e2e/test_demo.py`. Whole motions at scale
1 in lock-step ([conventions](../reference/conventions.md)), mm. *given*: a recorded knot tying.
`--law paper` and the open loop end in FAULT(rcm_error) at 2 mm.
"""
BUNDLED = "ur5e, cartesian, bundled"
THIRD_ARM = "third arm, cartesian, bundled"
PAPER, OPEN_LOOP = f"{BUNDLED}, `--law paper`", f"{BUNDLED}, `--law velocity --feedback-gain 0`"
LONG = f"{BUNDLED} repeated for 600 s, free-run"
COLUMNS = (
    *("run", "RCM kinematic mean / true max", "tip rms / max", "lag [ms]"),
    *("path in → out", "trocar [N]"),
)
_PAGE = ResultsPage(
    "main_job.md",
    _HEAD,
    (
        *(
            f"{robot}, {mode}, {motion}"
            for robot in ("ur5e", "panda")
            for mode in ("cartesian", "spherical")
            for motion in ("bundled", "given")
        ),
        THIRD_ARM,
        *(f"{robot}, cartesian, bundled, twist link" for robot in ("ur5e", "panda")),
        *(PAPER, OPEN_LOOP, LONG),
    ),
    keep=True,
    columns=COLUMNS,
)


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
