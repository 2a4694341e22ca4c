"""The page of a dataset, filled from the manifests: what Open-H-Embodiment asks contributors for.

What only people know (licence, contact, who the operators are) comes from ``--about FILE.yaml``;
what nobody said is called "not stated", never made up.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.datasets import schema
from surg_recording.datasets.exporter import Dataset
from surg_recording.datasets.inspection import FAILURE, RECOVERY

KNOWN = {
    "name": "name of the dataset",
    "summary": "what it is, in a sentence",
    "license": "licence of the data",
    "version": "version of the data",
    "lead": "who made it",
    "institution": "where",
    "contact": "e-mail address",
    "citation": "how to cite it",
    "operators": "how many people, and how skilled",
    "varied": "what was varied on purpose",
    "cameras": "models of the cameras",
    "other": "anything else",
}
"""Keys of the file of ``--about``."""

SECTIONS = (
    "Dataset description",
    "Robot",
    "Sensors and cameras",
    "Collection procedure",
    "Synchronization",
    "Action and state",
    "Splits",
    "Attribution",
)
"""Headings that the page must have; Open-H's checker looks for five of these words."""


def page(dataset: Dataset, format_name: str) -> str:
    """The page as Markdown."""
    about = dict(dataset.options.about)
    parts = dataset.parts
    hours = dataset.frames / dataset.options.fps / 3600
    simulated = sum(bool(part.about.get("simulated")) for part in parts)
    kinds = {kind: sum(p.kind == kind for p in parts) for kind in (RECOVERY, FAILURE)}
    dates = sorted(str(p.about["created"])[:10] for p in parts if p.about.get("created"))
    lines = [
        f"# {about.get('name', dataset.name)}",
        "",
        str(about.get("summary", _summary(dataset))),
        "",
        "## Dataset description",
        "",
        "| | |",
        "|---|---|",
        f"| Recordings | {len(parts)} |",
        f"| Frames | {dataset.frames} at {dataset.options.fps} per second |",
        f"| Hours | {hours:.3f} |",
        "| Domain | surgical robotics |",
        f"| Data type | {_data_type(simulated, len(parts))} |",
        f"| Format | {format_name} |",
        f"| Licence | {_said(about, 'license')} |",
        f"| Version | {_said(about, 'version')} |",
        "",
        "Tasks, as instructions in words:",
        "",
        *[f"- {task}" for task in dataset.tasks],
        "",
        "## Robot",
        "",
        "| arm | robot | instrument | joints | commanded |",
        "|---|---|---|---|---|",
    ]
    layout = dataset.layout
    for arm, robot, tool, joints in zip(
        layout.arms, layout.robots, layout.instruments, layout.joints, strict=True
    ):
        commanded = "yes" if arm in layout.commanded else "no"
        lines.append(f"| {arm} | {robot} | {tool} | {joints} | {commanded} |")
    lines += [
        "",
        "Every instrument turns about a remote centre of motion (a trocar) that its controller"
        " holds.",
        "",
        "## Sensors and cameras",
        "",
        f"Models: {_said(about, 'cameras')}.",
        "",
        "| feature | width x height | recorded as |",
        "|---|---|---|",
    ]
    for feature in schema.videos_of(dataset.features):
        height, width = feature.shape[:2]
        lines.append(f"| `{feature.name}` | {width} x {height} | {feature.camera} |")
    lines += [
        "",
        "## Collection procedure",
        "",
        f"- Operators: {_said(about, 'operators')}; named in the recordings:"
        f" {_each(dataset, 'operator')}",
        f"- Tasks: {_each(dataset, 'task')}; settings: {_each(dataset, 'setting')}",
        f"- Seeds: {_seeds(dataset)}",
        f"- Collected: {f'{dates[0]} to {dates[-1]}' if dates else 'not stated'}",
        f"- Varied on purpose: {_said(about, 'varied')}",
        f"- Recovery demonstrations: {kinds[RECOVERY] or 'none'};"
        f" failures: {kinds[FAILURE] or 'none'}",
        f"- Software: {_each(dataset, 'software')}",
        "",
        "## Synchronization",
        "",
        _synchronization(dataset),
        "",
        "Frame k stands at k / fps exactly. Pictures are the newest that are not later, at most"
        f" {dataset.options.max_image_age_s * 1000:g} ms old; measured values are interpolated"
        f" between samples at most {dataset.options.max_gap_s * 1000:g} ms apart. True stamps"
        " (integer nanoseconds) and ages stand beside every frame in the columns `timing.*`.",
        "",
        *_notes(dataset),
        "",
        "## Action and state",
        "",
        "Positions in metres, angles in radians, quaternions x, y, z, w. The rcm frame has its"
        " origin at the trocar and z along the home shaft axis into the patient. Actions are"
        " absolute.",
        "",
        "| feature | type | numbers | unit | frame | how it came onto the grid |",
        "|---|---|---|---|---|---|",
    ]
    for feature in schema.columns_of(dataset.features):
        units = ", ".join(dict.fromkeys(feature.units)) or "–"
        names = ", ".join(feature.names)
        lines.append(
            f"| `{feature.name}` | {feature.dtype} | {names} | {units} | {feature.frame or '–'} |"
            f" {feature.method or '–'} |"
        )
    privileged = [f"`{f.name}`" for f in dataset.features if f.privileged]
    if privileged:
        lines += [
            "",
            f"**Privileged** (ground truth that no robot can measure): {', '.join(privileged)}.",
        ]
    lines += ["", "## Splits", "", "| split | recordings |", "|---|---|"]
    lines += [f"| {name} | {a} to {b - 1} |" for name, (a, b) in dataset.splits.items()]
    lines += [
        "",
        "## Attribution",
        "",
        f"- Lead: {_said(about, 'lead')}",
        f"- Institution: {_said(about, 'institution')}",
        f"- Contact: {_said(about, 'contact')}",
        f"- Citation: {_said(about, 'citation')}",
    ]
    if about.get("other"):
        lines += ["", str(about["other"])]
    return "\n".join(lines) + "\n"


def missing_sections(text: str) -> list[str]:
    """Sections that a page lacks, in words."""
    return [f"README.md has no section '{name}'" for name in SECTIONS if f"## {name}" not in text]


def _said(about: Mapping[str, Any], key: str) -> str:
    return str(about.get(key) or "not stated").strip()


def _each(dataset: Dataset, key: str) -> str:
    """All different values of a fact about the recordings."""
    found = dict.fromkeys(str(part.about[key]) for part in dataset.parts if part.about.get(key))
    return ", ".join(found) or "not stated"


def _seeds(dataset: Dataset) -> str:
    seeds = [p.about["seed"] for p in dataset.parts if isinstance(p.about.get("seed"), int)]
    if len(set(seeds)) <= 1:
        return str(seeds[0]) if seeds else "not stated"
    return f"{min(seeds)} to {max(seeds)}"


def _summary(dataset: Dataset) -> str:
    robots = " and ".join(dict.fromkeys(dataset.layout.robots))
    count = len(dataset.parts)
    noun = "recording" if count == 1 else "recordings"
    return f"{count} {noun} of {robots}: {'; '.join(dataset.tasks)}."


def _data_type(simulated: int, total: int) -> str:
    if simulated == total:
        return "physical simulation"
    return "real robot" if not simulated else f"{simulated} simulated, {total - simulated} real"


def _synchronization(dataset: Dataset) -> str:
    """What the recordings say about their clocks."""
    clocks = list(dict.fromkeys(str(p.about.get("clock") or "not stated") for p in dataset.parts))
    verdicts: dict[str, int] = {}
    for part in dataset.parts:
        report = part.about.get("sync")
        verdict = str(report.get("verdict")) if isinstance(report, Mapping) else "no report"
        verdicts[verdict] = verdicts.get(verdict, 0) + 1
    said = ", ".join(f"{verdict}: {count}" for verdict, count in verdicts.items())
    return (
        f"Clock of the stamps: {', '.join(clocks)}. Every message and picture was stamped at its"
        f" source and recorded with that stamp. Verdicts of the recordings' sync reports: {said}."
    )


def _notes(dataset: Dataset) -> list[str]:
    """Repeated and skipped pictures of each camera, and the oldest."""
    rows = []
    for camera in dataset.layout.cameras:
        repeated = sum(int(p.notes.get(f"repeated_{camera}", 0)) for p in dataset.parts)
        skipped = sum(int(p.notes.get(f"skipped_{camera}", 0)) for p in dataset.parts)
        oldest = max(float(p.notes.get(f"oldest_{camera}_s", 0.0)) for p in dataset.parts)
        rows.append(
            f"- {camera}: {repeated} pictures shown twice, {skipped} left out, the oldest"
            f" {oldest * 1000:.1f} ms old"
        )
    for part in dataset.parts:
        if "segment" in part.notes:
            rows.append(f"- {Path(part.source).name}: {part.notes['segment']}, is in the dataset")
    return rows
