"""The figures as tables: on the terminal, and on docs/results/force_policy.md."""

from __future__ import annotations

from typing import Any

from surg_cli.host import paths

PAGE = paths.ROOT / "docs" / "results" / "force_policy.md"
TEXT = """# Force-aware policies of bowel grasping and retraction

`./surg dev bench force_policy --keep DIR --page`: does a policy that reads the force retract
better? Three training seeds each, in process. *Within 2 N*: the force on the jaws stays below 2 N.
Tension: of the simulated tissue; no robot can measure it. Forces: median, largest.
"""
HEAD = ["reads", "solved", "within 2 N", "peak force [N]", "tension [N]", "solved by seed"]
FELT = {"true": "", "zero": ", told 0 N", "other": ", told another episode's force"}


def reads(entry: dict[str, Any]) -> str:
    """What a policy reads."""
    words = (["force"] if entry["forces"] else []) + (["tension"] if entry["tension_read"] else [])
    return (" and ".join(words) or "neither") + FELT[entry["felt"]]


def row(entry: dict[str, Any], trainings: list[dict[str, Any]]) -> list[str]:
    """Of a policy's trainings together."""
    n, (median, most) = entry["n"], entry["peak_n"]
    own = sorted(
        (each["seed"], each["solved"]) for each in trainings if reads(each) == reads(entry)
    )
    taut, tautest = entry["tension_n"]
    return [
        reads(entry),
        f"{entry['solved']}/{n}",
        f"{entry['good']}/{n}",
        f"{median:.2f}, {most:.2f}",
        f"{taut:.2f}, {tautest:.2f}",
        ", ".join(str(solved) for _, solved in own),
    ]


def tables(result: dict[str, Any]) -> list[tuple[str, list[list[str]]]]:
    """Heading and rows."""
    rows = [row(entry, result["trainings"]) for entry in result["together"]]
    return [("All training seeds", [HEAD, *rows])]


def head(result: dict[str, Any]) -> str:
    """What the generated part begins with."""
    first, end = result["seeds"]
    return (
        f"{result['demonstrations']} demonstrations, test seeds {first} to {end - 1}. "
        f"The scripted expert on these seeds: peak force {result['expert_peak_n'][0]:.2f} N in the "
        f"median, {result['expert_peak_n'][1]:.2f} N at most."
    )
