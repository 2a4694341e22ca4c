"""The contract of topics and services (topics.yaml), and the page that is made of it."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from surg_cli.graph.graph_probe import GraphEnd
from surg_cli.host import paths

SOURCE = paths.ROOT / "docs" / "reference" / "topics.yaml"
PAGE = paths.ROOT / "docs" / "reference" / "topics.md"
ARM = "<arm>"
EXTERNAL = ("/rosout", "/rosout_agg", "/use_sim_time")
"""Topics that come with ROS itself."""
REFERENCE = frozenset({"track_rcm", "track_stale", "inject"})
"""Optional parameters that the reference graph switches on: all but those of a task."""
_KEYS = {
    "topic", "service", "type", "use", "node", "dir", "only", "rate", "hz", "frame", "latched",
    "valid", "meaning",
}  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One topic of one node, or one service."""

    name: str  # with `<arm>` for the arm's name
    type: str  # ROS type
    node: str  # base name of the node
    direction: str  # `in`, `out` or `service`, seen from the node
    latched: tuple[bool, bool]  # in lock-step and in free-run
    # rate in lock-step (of simulated time) and in free-run; None: not periodic
    hz: tuple[float, float] | None
    frame: str | None  # what header.frame_id must be; None: not checked
    # from when on there are valid data: `always`, `link`, `homed`; None: not checked
    valid: str | None
    only: str | None  # parameter without which the topic does not exist; see ``REFERENCE``

    def resolved(self, arm: str) -> str:
        """Its name on the graph."""
        return self.name.replace(ARM, f"/{arm}")


@dataclass(frozen=True)
class Contract:
    """The whole file."""

    types: dict[str, str]  # md5 by type, of all but our own messages
    entries: tuple[Entry, ...]  # all topics and services
    introduction: str  # words at the head of the page
    sections: tuple[dict[str, Any], ...]  # the file's sections as they stand, for the page


def load(source: Path = SOURCE) -> Contract:
    """Read the contract.

    Raises:
        ValueError: An entry has an unknown key, or a type without md5.
    """
    data = yaml.safe_load(source.read_text("utf-8"))
    entries = []
    for section in data["sections"]:
        for row in [*section.get("topics", ()), *section.get("services", ())]:
            unknown = set(row) - _KEYS
            ours = row["type"].startswith("surg_msgs/")
            if unknown or not (ours or row["type"] in data["types"]):
                raise ValueError(f"{source}: {row}: unknown {unknown or row['type']}")
            entries.append(_entry(row))
    return Contract(
        types=dict(data["types"]),
        entries=tuple(entries),
        introduction=data["introduction"],
        sections=tuple(data["sections"]),
    )


def _entry(row: dict[str, Any]) -> Entry:
    latched, hz = row.get("latched", False), row.get("hz")
    both = (latched, latched) if isinstance(latched, bool) else (latched[0], latched[1])
    return Entry(
        name=row.get("topic") or row["service"],
        type=row["type"],
        node=row["node"],
        direction=row.get("dir", "service"),
        latched=both,
        hz=None if hz is None else (float(hz[0]), float(hz[1])),
        frame=row.get("frame"),
        valid=row.get("valid"),
        only=row.get("only"),
    )


def compare(
    contract: Contract,
    seen: Iterable[GraphEnd],
    arm: str,
    nodes: Iterable[str],
    lockstep: bool,
    parameters: Collection[str] = REFERENCE,
) -> list[str]:
    """Where contract and graph differ, one sentence each.

    ``nodes`` are the base names of the nodes that run (others are skipped), ``parameters`` their
    optional parameters.
    """
    running = set(nodes)
    there = {(s.name, s.node.rpartition("/")[2], s.direction): s for s in seen}
    offered = {
        key: s
        for key, s in there.items()
        if key[1] in running and s.name not in EXTERNAL and not _logger(s)
    }
    promised = {
        (e.resolved(arm), e.node, e.direction): e
        for e in contract.entries
        if e.only is None or e.only in parameters
    }
    internal = _internal(contract, arm)
    wrong = [
        f"{name} ({node}, {way}) is on the graph and not in {SOURCE.name}"
        for name, node, way in sorted(set(offered) - set(promised))
        if (name, node, way) not in internal
    ]
    for key, entry in promised.items():
        if entry.node not in running:
            continue
        at = offered.get(key)
        if at is None:
            wrong.append(f"{key[0]} ({key[1]}, {key[2]}) is promised and not on the graph")
            continue
        md5 = contract.types.get(entry.type, at.md5)
        if at.type != entry.type:
            wrong.append(f"{key[0]}: type {at.type}, promised {entry.type}")
        if at.md5 and at.md5 != md5:
            wrong.append(f"{key[0]}: md5 {at.md5}, promised {md5}")
        if entry.direction == "out" and at.latched != entry.latched[0 if lockstep else 1]:
            wrong.append(f"{key[0]}: latched {at.latched}, promised {entry.latched}")
    return wrong


def _logger(seen: GraphEnd) -> bool:
    """The services that every node of ROS has for its log level, and a nodelet's bonds."""
    return seen.name.endswith(("/get_loggers", "/set_logger_level"))


def _internal(contract: Contract, arm: str) -> set[tuple[str, str, str]]:
    """The other ends of promised topics: what controller and simulator take from each other."""
    ends = set()
    for entry in contract.entries:
        other = {"in": "out", "out": "in"}.get(entry.direction)
        for node in {e.node for e in contract.entries} - {entry.node}:
            if other is not None:
                ends.add((entry.resolved(arm), node, other))
    # The controller waits as the simulator does, the simulator's tracker announces itself, and
    # warnings have two voices.
    return ends | {
        ("/sim/ready", "controller", "in"),
        ("/sim/ready", "sim", "out"),
        (f"/{arm}/warning", "dvrk_compat", "out"),
    }


# --- the page ---------------------------------------------------------------------------------


def render(contract: Contract) -> str:
    """The page docs/reference/topics.md; types, directions and latching are those in free-run."""
    parts = [
        "<!-- Generated by ./surg dev topics from topics.yaml. Edit topics.yaml. -->",
        "# Topics",
        contract.introduction.strip(),
    ]
    for section in contract.sections:
        parts.append(f"## {section['title']}")
        if "text" in section:
            parts.append(section["text"].strip())
        rows = [*section.get("topics", ()), *section.get("services", ())]
        if rows:
            parts.append(_table(section["columns"], rows))
        if "after" in section:
            parts.append(section["after"].strip())
    return "\n\n".join(parts) + "\n"


def _table(columns: list[str], rows: list[dict[str, Any]]) -> str:
    """The rows of a section; neighbours that differ in name only share a line."""
    both_ways = len({row.get("dir") for row in rows}) > 1
    cells = [_cells(row, both_ways) for row in rows]
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for others, group in itertools.groupby(cells, lambda each: [each[c] for c in columns[1:]]):
        names = ", ".join(dict.fromkeys(each[columns[0]] for each in group))
        lines.append(f"| {' | '.join([names, *others])} |")
    return "\n".join(lines)


def _cells(row: dict[str, Any], both_ways: bool) -> dict[str, str]:
    """What every column says of one topic or service."""
    entry = _entry(row)
    use = row.get("use", "")
    direction = f"{entry.direction} " if both_ways else ""
    return {
        "topic": f"`{entry.name}`",
        "service": f"`{entry.name}`",
        "type": entry.type + (f" `{use}`" if "[" in use else f", {use}" if use else ""),
        "rate": (direction + row.get("rate", "")).strip() or "–",
        "frame": f"`{entry.frame}`" if entry.frame else "–",
        "meaning": row["meaning"] + ("; latched" if entry.latched[1] else ""),
    }
