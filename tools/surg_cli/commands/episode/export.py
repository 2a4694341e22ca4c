"""`./surg episode export EPISODES…`: writes recordings as a dataset for training programs."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from surg_cli.host import option_types, paths
from surg_cli.host.terminal import CliError, Progress, say, table, warn

FORMATS = (
    *("lerobot", "lerobot_v30", "robomimic", "act", "diffusion_policy"),
    *("mcap", "rosbag", "rosbag2", "rosbag2_sqlite3"),
)
HASH, MERGE = "hash", "merge"


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.epilog = (
        "Exit status: 0 all recordings are in the dataset, 1 some were refused or the dataset is"
        " invalid, 2 wrong input. Formats: docs/reference/datasets.md"
    )
    add = parser.add_argument
    add(
        "episodes",
        nargs="*",
        type=Path,
        metavar="EPISODES",
        help="recordings, or folders with some",
    )
    known = ", ".join(FORMATS)
    add("--format", default="lerobot", help=f"{known}, an installed one, or a .py file")
    out = "the dataset; a new folder (default: read and check everything, write nothing)"
    add("--out", type=Path, metavar="DIR", help=out)
    add("--check", action="store_true", help="read and check the whole dataset in --out")
    add("--where", metavar="EXPR", help=option_types.WHERE)
    _add_content(parser.add_argument_group("content").add_argument)
    _add_dataset(parser.add_argument_group("dataset").add_argument)
    _add_processes(parser.add_argument_group("processes").add_argument)


def _add_content(add: Callable[..., Any]) -> None:
    add("--fps", type=int, default=20, metavar="N", help="frames per second (default 20)")
    add("--cameras", nargs="+", metavar="NAME", help="default: all of the first recording")
    add("--size", type=_size, metavar="WxH", help="scale pictures (default: as recorded)")
    add("--instruction", metavar="TEXT", help="in words (default: the recording's own)")
    spaces = ("absolute", "relative", "velocity", "joint")
    add("--action-space", default="absolute", choices=spaces, help="of the actions (absolute)")
    keep = "features to keep, with * (beside action, instruction, tool): recordings may then differ"
    add("--columns", nargs="+", metavar="FEATURE", help=f"{keep} in task, robot and instrument")
    add("--drop", nargs="+", default=[], metavar="FEATURE", help="features to leave out")
    copy_help = "copy: take recorded videos as they are where possible (default encode)"
    add("--video", choices=("encode", "copy"), default="encode", help=copy_help)
    add(
        "--allow",
        nargs="+",
        choices=("incomplete", "unsynchronised", "old-pictures"),
        default=[],
        help="include recordings that were interrupted, whose sync report fails, whose camera "
        "stalled",
    )


def _add_dataset(add: Callable[..., Any]) -> None:
    shares = (
        "default: train=0.8,val=0.1,test=0.1, exactly; hash, or hash:train=…: a recording keeps "
        "its split in every export"
    )
    add("--splits", type=_splits, default={}, metavar="NAME=SHARE,…", help=shares)
    add("--about", type=Path, metavar="FILE", help="YAML file with facts for the dataset card")
    add("--replace", action="store_true", help="replace an earlier export")


def _add_processes(add: Callable[..., Any]) -> None:
    add(
        "--workers",
        type=_workers,
        default={},
        metavar="N",
        help="processes (default: one per processor), 1: in this one, or the address of the "
        "scheduler of a Dask cluster that sees the same disk; dask: a cluster of its own, here",
    )
    add(
        "--shard",
        type=_shard,
        metavar="i/n",
        help="convert only shard i of n; merge: put the converted shards together",
    )


def main(options: argparse.Namespace, command: str) -> int:
    """Export, try or check; print the result."""
    from surg_recording import datasets

    try:
        exporter = datasets.load(options.format)
        if options.out is None and (options.check or options.shard or options.replace):
            raise CliError("export: --out DIR is missing", 2)
        if options.check:
            return _say(datasets.check(options.out, exporter), options)
        if not options.episodes:
            raise CliError("export: name recordings, or folders with some", 2)
        chosen = choices(options, datasets.ExportOptions)
        with Progress(f"export to {options.out}" if options.out else "export: check") as progress:
            if options.out is None:
                report = datasets.dry_run(exporter, options.episodes, chosen, progress.update)
            else:
                report = exporter.write(options.episodes, options.out, chosen, progress.update)
    except datasets.ExportError as problem:
        raise CliError(f"export: {problem}", 2) from None
    return _say(report, options)


def choices(options: argparse.Namespace, kind: Any) -> Any:
    """The export's options from the command line's.

    Raises:
        CliError: Names the option, its value and what is allowed.
    """
    from surg_recording.datasets.options import ANY_AGE_S

    shard = options.shard if options.shard != MERGE else None
    if options.shard == MERGE:
        parts = options.out.with_name(options.out.name + ".parts")
        if not parts.is_dir():
            raise CliError(f"export: {parts} is missing; convert the shards first", 2)
    given: dict[str, Any] = {
        **options.splits,
        **options.workers,
        "shard": shard,
        "allow_incomplete": "incomplete" in options.allow,
        "allow_unsynchronised": "unsynchronised" in options.allow,
        "cameras": None if options.cameras is None else tuple(options.cameras),
        "drop": tuple(options.drop),
        "columns": None if options.columns is None else tuple(options.columns),
        "about": {} if options.about is None else _about(options.about),
    }
    if "old-pictures" in options.allow:
        given["max_image_age_s"] = ANY_AGE_S
    for field in dataclasses.fields(kind):
        if field.name not in (*given, "splits", "workers") and hasattr(options, field.name):
            given[field.name] = getattr(options, field.name)
    try:
        return kind(**given)
    except ValueError as problem:
        raise CliError(f"export: --{problem}", 2) from None


def _say(report: Any, options: argparse.Namespace) -> int:
    """Print a report; the exit status."""
    counts = f"{report.recordings} recordings, {report.frames} frames"
    rows = [["format", report.format], ["content", counts]]
    if options.shard not in (None, MERGE):
        rows[1] = ["content", f"{report.recordings} recordings of this shard are converted"]
    facts = report.facts
    if facts.get("up_to_date"):
        rows.append(["state", "up to date"])
    for key in ("not selected", "splits", "kinds", "mixed", "files"):
        if facts.get(key):
            shown = facts[key]
            if isinstance(shown, dict):
                shown = ", ".join(f"{name} {value}" for name, value in shown.items())
            rows.append([key, str(shown)])
    say(table(rows))
    if "features" in facts and options.out is None:
        say("features:")
        say(table([[name, str(shape)] for name, shape in facts["features"].items()], "    "))
    for text in report.warnings:
        warn(f"  note: {text}")
    for reason in report.refused.values():
        warn(f"  refused: {reason}")
    for text in report.errors:
        warn(f"  wrong: {text}")
    if report.errors:
        warn("surg: the dataset is invalid" + ("" if options.check else "; it was not kept"))
    elif report.refused:
        warn(f"surg: {len(report.refused)} recordings are not in the dataset")
    if options.out is None:
        say("  nothing is written: no --out")
    elif not options.check:
        _write_report(report, options.out)
    return 0 if report.ok else 1


def _write_report(report: Any, out: Path) -> None:
    """Write the report beside the dataset, which holds only files of its format."""
    path = out.with_name(out.name + ".report.json")
    paths.write_text(path, json.dumps(report.to_json(), indent=1, default=str) + "\n")
    say(f"  report: {path}")


def _about(path: Path) -> dict[str, Any]:
    """Facts for the dataset card, from a YAML file with known keys only."""
    import yaml  # missing before the first setup

    from surg_recording.datasets.pages.readme import KNOWN

    try:
        stated = yaml.safe_load(path.read_text("utf-8"))
    except (OSError, yaml.YAMLError) as problem:
        raise CliError(f"--about {path}: {problem}", 2) from None
    if not isinstance(stated, dict) or set(stated) - set(KNOWN):
        strange = ", ".join(map(str, set(stated) - set(KNOWN))) if stated else "nothing"
        raise CliError(f"--about {path}: holds {strange}; known keys: {', '.join(KNOWN)}", 2)
    return stated


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text}: expected a size such as 640x480")
    return (int(width), int(height))


def _shard(text: str) -> tuple[int, int] | str:
    if text == MERGE:
        return text
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and int(index) < int(count)):
        raise argparse.ArgumentTypeError(
            f"{text}: merge, or i/n with 0 ≤ i < n, such as 0/4, is expected"
        )
    return (int(index), int(count))


def _workers(text: str) -> dict[str, Any]:
    """Where the export is computed, as options of `ExportOptions`."""
    if text.isdigit() and int(text) >= 1:
        return {"executor": "serial"} if int(text) == 1 else {"workers": int(text)}
    if text == "dask" or "://" in text:
        return {"executor": "dask", "scheduler": None if text == "dask" else text}
    raise argparse.ArgumentTypeError(
        f"{text}: allowed: a number of processes from 1, dask, or an address such as "
        "tcp://head:8786"
    )


def _splits(text: str) -> dict[str, Any]:
    """Shares of the splits and who decides, as options of `ExportOptions`."""
    way, _, shares = text.rpartition(":")
    if text == HASH:
        return {"split_by": HASH}
    try:
        if way not in ("", HASH):
            raise ValueError
        pairs = [item.split("=") for item in shares.split(",")]
        found = {name.strip(): float(share) for name, share in pairs}
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected shares such as train=0.9,val=0.1, hash, or hash:train=0.9,val=0.1"
        ) from None
    return {"splits": found, **({"split_by": HASH} if way else {})}
