"""docs/results/screens.md: times of the 3D monitor and the headset's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from helpers.results.results_page import ResultsPage

FORMATS = (
    *("left", "right", "sbs", "top_bottom", "rows", "columns", "checker", "anaglyph"),
    "frame_packed",
)
AGE, TARGETS = "headset: age of the drawn pair", "headset: targets of bgr touched"
PAGE = ResultsPage("screens.md")
LOOKED_AT = "eight pages, 4 sizes, light and dark, by axe-core"


class Looks:
    """What axe-core says of all pages, once each of them was looked at in each size and look."""

    PAGES = ("console", "monitor", "headset", "calibrate", "help", "label", "view", "report")

    def __init__(self) -> None:
        self._seen: dict[tuple[str, str], tuple[int, float]] = {}

    def add(self, page: str, where: str, texts: int, contrast: float) -> None:
        """A page without a grave fault, in a size and look: its texts and their least contrast."""
        self._seen[page, where] = texts, contrast
        if len(self._seen) == 8 * len(self.PAGES):
            least = (
                f"{page} {min(c for (p, _), (_, c) in self._seen.items() if p == page):.1f}"
                for page in self.PAGES
            )
            texts = sum(n for n, _ in self._seen.values())
            PAGE.note(
                LOOKED_AT,
                len(self._seen),
                f"0 serious; least contrast of {texts} texts: {', '.join(least)}",
            )


def note_times(
    form: str, spent: float, times: Sequence[float], limits: Mapping[str, float]
) -> None:
    """Print and keep what a picture of a format costs.

    Args:
        form: Of `FORMATS`.
        spent: Processor time of the browser for one picture [ms].
        times: Of each picture by the clock [ms].
        limits: Goals [ms].
    """
    goal = f" (goal {limits[form]:.0f})" if form in limits else ""
    result = f"{spent:.1f} ms{goal}"
    PAGE.note(f"draw {form}", len(times), result)


def note_holds(found: Mapping[str, Sequence[float]]) -> None:
    """Print and keep how soon the arm holds when a headset goes [s]."""
    for what, times in found.items():
        ordered = sorted(1e3 * each for each in times)
        middle, most = ordered[len(ordered) // 2], ordered[-1]
        PAGE.note(f"{what} → hold", len(times), f"median {middle:.0f} ms, largest {most:.0f} ms")


def note_age(ages: Sequence[float], seconds: float) -> None:
    """Print and keep how old pictures are when a headset draws them [ms], and how often [s]."""
    ordered = sorted(ages)
    middle, most = ordered[len(ordered) // 2], ordered[len(ordered) * 99 // 100]
    rate = len(ordered) / seconds
    result = f"{middle:.0f} ms p50, {most:.0f} p99, {rate:.1f} pictures/s; goals 120 ms, 15/s"
    PAGE.note(AGE, len(ordered), result)


def note_targets(seconds: Sequence[float]) -> None:
    """Print and keep how long a controller took to targets [s]."""
    PAGE.note(TARGETS, len(seconds), f"within 2 mm, after at most {max(seconds):.0f} s")
