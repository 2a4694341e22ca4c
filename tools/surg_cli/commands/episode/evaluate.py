"""`./surg episode evaluate`: figures and tables of recorded episodes, grouped by condition."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from surg_cli.host import option_types, paths
from surg_cli.host.terminal import CliError, Progress, say, table, warn

RECORD_SOME = "./surg run bgr --setting all --episodes 10"
# --help runs without the workspace; a test compares these with surg_recording.
PRESETS = ("reference", "paper")
PAPER = "paper"
REFERENCES = "jigsaws:DIR, motion:CSV_OR_DIR"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "episodes",
        nargs="*",
        type=Path,
        metavar="EPISODES",
        help="episode folders, runs, or folders with some (default: runs/)",
    )
    add(
        "--reference",
        action="append",
        default=[],
        metavar="KIND:PATH",
        help=f"compare the smoothness with {REFERENCES}; {PAPER}: mark the published values",
    )
    add("--preset", default=PRESETS[0], metavar="P", help="smoothness: " + ", ".join(PRESETS))
    add("--arm", metavar="ARM", help="whose motion (default: the first arm of each episode)")
    add("--where", metavar="EXPR", help=option_types.WHERE)
    add(
        "--allow",
        nargs="+",
        choices=("incomplete",),
        default=[],
        help="include interrupted recordings, marked",
    )
    add("--out", type=Path, metavar="DIR", help="new or empty folder (default runs/<UTC time>)")


def main(options: argparse.Namespace, command: str) -> int:
    """Find, measure, report; the last line printed is the path of summary.json."""
    from surg_recording.episode import provenance
    from surg_recording.episode.selection import Selection, SelectionError
    from surg_recording.recording_errors import EpisodeError, ReferenceSetError
    from surg_recording.reports import evaluation, evaluation_report

    if options.preset not in PRESETS:
        known = ", ".join(PRESETS)
        raise CliError(f"--preset {options.preset}: no such preset; there are {known}", 2)
    try:
        selection = None if options.where is None else Selection(options.where)
    except SelectionError as problem:
        raise CliError(f"--where: {problem}", 2) from problem
    sets = [each for each in options.reference if each != PAPER]
    if len(sets) > 1:
        raise CliError(f"--reference {sets[1]}: one set beside {PAPER} is allowed", 2)
    out = paths.run_folder(options.out)
    folders = _find(options.episodes, bool(sets))
    compared = None
    with Progress("evaluate") as progress:
        if sets:
            try:
                compared = evaluation.compare(sets[0], options.preset, progress.update)
            except ReferenceSetError as problem:
                raise CliError(f"--reference: {problem}", 2) from problem
            for reason in compared["left_out"]:
                warn(f"surg: reference: {reason}")
        try:
            entries, left_out = evaluation.measure_all(
                folders, options.arm, "incomplete" in options.allow, progress.update, selection
            )
        except SelectionError as problem:
            raise CliError(f"--where: {problem}", 2) from problem
        for each in left_out:
            warn(f"surg: left out: {each.reason}")
        if selection is not None and not entries:
            others = f"{len(folders) - len(left_out)} do not fit, {len(left_out)} are left out"
            raise CliError(f"--where {options.where!r}: no episode remains: {others}", 2)
        for text in evaluation.remarks(entries):
            warn(f"surg: note: {text}")
        info = {"versions": provenance.versions(), "where": options.where}
        info["paper_values"] = PAPER in options.reference
        summary = evaluation.summarise(entries, left_out, options.preset, compared, info)
        progress.update(1.0, "figures")
        try:
            evaluation_report.write(summary, out)
        except (OSError, EpisodeError) as problem:
            raise CliError(f"--out {out}: {problem}") from problem
    _print_summary(summary)
    say(str(out / "report.html"))
    say(str(out / "summary.json"))
    if folders and not entries:
        warn(f"surg: none of {len(folders)} episodes could be evaluated")
        return 1
    return 0


def _find(wanted: list[Path], alone: bool) -> list[Path]:
    """The episodes to evaluate; if there are none, the error names a command that records some.

    ``alone``: a reference set may be evaluated without any episode.
    """
    from surg_recording.episode import episode_reader
    from surg_recording.recording_errors import EpisodeError

    try:
        return episode_reader.find(wanted or [paths.RUNS])
    except EpisodeError as problem:
        if wanted:
            raise CliError(str(problem), 2) from problem
        if alone:
            return []
        raise CliError(f"runs/ holds no episode; record some with {RECORD_SOME}", 2) from problem


def _print_summary(summary: dict[str, Any]) -> None:
    """Print the main figures, one line per condition."""
    from surg_recording.reports.trial_report import interval

    rows = [["condition", "n", "success", "RCM mean [mm]", "RCM max [mm]", "SPARC", "LDLJ"]]
    shown = ("rcm_kinematic_mean_mm", "rcm_kinematic_max_mm", "sparc", "ldlj")
    for label, entry in summary["conditions"].items():
        rate = entry["success_rate"]
        success = "not judged" if rate is None else interval(rate)
        numbers = [_median(entry[name], entry["n"]) for name in shown]
        rows.append([label, str(entry["n"]), success, *numbers])
    compared = summary["reference"]
    if compared:
        levels = {"": compared, **{f", {k}": v for k, v in compared["by_skill"].items()}}
        for label, level in levels.items():
            ends = [_median(level[name], level["trials"]) for name in ("sparc", "ldlj")]
            rows.append([compared["name"] + label, str(level["trials"]), "", "", "", *ends])
    if len(rows) > 1:
        say(table(rows))
        say(f"  medians over the episodes; smoothness by preset {summary['preset']['name']}")


def _median(spread: dict[str, Any], n: int) -> str:
    """The median; the number of values if it is not that of the episodes."""
    if not spread["n"]:
        return "not measured"
    return f"{spread['median']:.4g}" + (f" (n = {spread['n']})" if spread["n"] != n else "")
