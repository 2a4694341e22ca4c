"""The figures as tables: on the terminal, and on a page of docs/results with its picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "results" / "benchmark_control.md"
PICTURE = paths.ROOT / "docs" / "pictures" / "benchmark_control.png"
TEXT = """# The controller beside other ways to do the same

`./surg dev bench control --page`: one tip motion (±35, ±35, ±25 mm, 500 Hz) by our forms of the
law, QPs with the velocity form's wish and KDL, on an ideal plant. RCM and tip: largest
deviations, at samples and between. Two figures: median / p99. Where limits bind, joints may have a
tenth of their velocity and acceleration; the QP (eiquadprog) has the same box.

![Time of one cycle and largest pivot deviation of every law](../pictures/benchmark_control.png)
"""

Rows = list[list[str]]


def number(value: float | None) -> str:
    """Three significant figures; tiny and huge ones with an exponent."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e5:
        return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
    if abs(value) < 1:
        return f"{value:.3f}"
    return f"{value:.{max(0, 3 - len(str(int(abs(value)))))}f}"


def cell(value: object) -> str:
    """A figure, a count or a word."""
    return number(value) if isinstance(value, float) or value is None else str(value)


def grid(what: str, figures: dict[str, dict[str, Any]], columns: dict[str, str]) -> Rows:
    """One row per name.

    Args:
        what: Heading of the names.
        figures: By name and key; a key that is missing shows as a dash.
        columns: Heading to key.
    """
    rows = [[what, *columns]]
    for name, of in figures.items():
        rows.append([name, *(cell(of.get(key)) for key in columns.values())])
    return rows


def laws(figures: dict[str, Any]) -> Rows:
    """One row per law, the cheapest first; largest deviations."""
    columns = {
        "median µs": "median",
        "RCM at samples µm": "max_at_samples",
        "between": "max_between",
        "tip µm": "tip_max",
    }
    by_law = {
        name: {
            **cost,
            **figures["rcm_deviation_um"][name],
            "tip_max": figures["tip_error_um"][name]["max"],
        }
        for name, cost in sorted(figures["cycle_us"].items(), key=lambda law: law[1]["median"])
    }
    return grid("law", by_law, columns)


def summary(result: dict[str, Any]) -> Rows:
    """What the figures are measured against."""
    rows = [["figure", "measured", "goal"]]
    for robot, ratio in result["ratio"].items():
        if not ratio:
            continue
        goal = {"exact": "≥ 1.5", "velocity": "≥ 3"} if robot == "ur5e" else {}
        for form in ("exact", "velocity"):
            what = f"{robot}: {form}, times faster than {ratio['qp']}"
            rows.append([what, f"{ratio[form]:.2f}", goal.get(form, "stated")])
        if "limited_eiquadprog" in ratio:
            what = f"{robot}: limited, times faster than qp_eiquadprog"
            rows.append([what, f"{ratio['limited_eiquadprog']:.2f}", "stated"])
    return rows + binding(result) + cycle_summary(result)


def binding(result: dict[str, Any]) -> Rows:
    """Limited steps whose limits bind, by the time of the QP with the same box."""
    rows = []
    for robot, of in result["binding"].items():
        for form, goal in (("limited", 1.5), ("limited_preview", 4)) if of else ():
            what = f"{robot}, limits bind in {of['share']:.0%} of the cycles: {form}, times the QP"
            figures = f"{of[form]['median']:.2f} / {of[form]['p99']:.2f}"
            rows.append([what, figures, f"≤ {goal} / {goal}"])
    return rows


def cycle_summary(result: dict[str, Any]) -> Rows:
    """Of one cycle, median and p99."""
    cost, whole = result["cycle_us"], "whole controller cycle"
    found = [
        ("limited step", cost["limited"], "≤ 1 / 5"),
        ("with preview", cost["limited_preview"], "≤ 5 / 20"),
    ]
    if "whole_cycle_us" in result:
        alone = result["whole_cycle_us"]
        found.append((f"{whole}, back to back", alone["plain"], "p99 ≤ 40"))
        found.append((f"{whole} with `tremor`, back to back", alone["tremor"], "p99 ≤ 40"))
    return [
        [f"{what}, µs", f"{number(of['median'])} / {number(of['p99'])}", goal]
        for what, of, goal in found
    ]


def tables(result: dict[str, Any]) -> list[tuple[str, Rows]]:
    """(heading, rows with a header) in the order in which they are shown."""
    return [
        ("Against the goals", summary(result)),
        ("Laws on the UR5e", laws(result)),
    ]


def head(result: dict[str, Any]) -> str:
    """What the generated part begins with."""
    machine = result["machine"]
    return (
        f"{machine['date']}, {machine['cores']} cores of {machine['processor']}, load "
        f"{machine['load_before'][0]} before, {machine['compiler']}; {machine['cycles']} cycles."
    )


def markdown(result: dict[str, Any]) -> str:
    """The page; the first row of each table is its head."""
    lines = [TEXT, head(result)]
    for heading, rows in tables(result):
        lines += ["", f"## {heading}", "", f"| {' | '.join(rows[0])} |"]
        lines.append("|" + "---|" * len(rows[0]))
        lines += [f"| {' | '.join(row)} |" for row in rows[1:]]
    return "\n".join(lines) + "\n"


def bars(axes: Any, names: list[str], values: list[float]) -> None:
    """One bar per law on a logarithmic axis, ours in colour, each with its figure behind it."""
    axes.barh(names, values, color=[COLOUR if name in OWN else "#b0b7bf" for name in names])
    axes.set_xscale("log")
    axes.set_xlim(min(values) / 4, max(values) * 12)
    for i, value in enumerate(values):
        axes.annotate(
            number(value), (value, i), (4, 0), textcoords="offset points", va="center", fontsize=8
        )
    axes.spines[["top", "right"]].set_visible(False)


def draw(result: dict[str, Any], file: Path) -> None:
    """Time of a cycle, and largest pivot deviation, of every law."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 4.9), constrained_layout=True)
    names = sorted(result["cycle_us"], key=lambda n: result["cycle_us"][n]["median"], reverse=True)
    bars(left, names, [result["cycle_us"][name]["median"] for name in names])
    left.set_xlabel("time of one cycle, median [µs]")
    rcm = [result["rcm_deviation_um"][name] for name in names]
    bars(right, names, [max(r["max_at_samples"], r["max_between"]) for r in rcm])
    right.set_yticklabels([])
    right.set_xlabel("largest pivot deviation [µm]")
    figure.suptitle(
        "UR5e on an ideal plant, logarithmic scales; shorter is better; blue: this project's forms",
        fontsize=10,
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)
    pyplot.close(figure)


COLOUR = "#2a6f97"
OWN = ("exact", "velocity", "limited", "limited_preview", "paper")
