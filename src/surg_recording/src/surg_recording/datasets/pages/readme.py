"""The README of a dataset, as Open-H-Embodiment requires it, filled from the manifests.

Facts unknown to the manifests (licence, contact, operators) come from ``--about FILE.yaml``. A
missing fact reads "not stated".
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surg_recording.datasets import schema
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.inspection import FAILURE, RECOVERY
from surg_recording.datasets.pages.dataset_card import DATA_TYPES, METHODS, boxes, data_type, method

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
"""Required headings; Open-H's checker looks for five of these words."""


def page(dataset: Dataset, format_name: str) -> str:
    """The page as Markdown."""
    about = dict(dataset.options.about)
    sections = (
        _description(dataset, about, format_name),
        _robot(dataset),
        _sensors(dataset, about),
        _collection(dataset, about),
        _synchronization(dataset),
        _action_and_state(dataset),
        _splits(dataset),
        _attribution(about),
    )
    lines = [
        f"# {about.get('name', dataset.name)}",
        "",
        str(about.get("summary", _summary(dataset))),
    ]
    for title, section in zip(SECTIONS, sections, strict=True):
        lines += ["", f"## {title}", "", *section]
    if about.get("other"):
        lines += ["", str(about["other"])]
    return "\n".join(lines) + "\n"


def _description(dataset: Dataset, about: Mapping[str, Any], format_name: str) -> list[str]:
    parts, recordings = dataset.parts, _recordings(dataset)
    hours = dataset.frames / dataset.options.fps / 3600
    return [
        "| | |",
        "|---|---|",
        f"| Recordings | {len(recordings)} |",
        f"| Episodes | {len(parts)} |",
        f"| Frames | {dataset.frames} at {dataset.options.fps} per second |",
        f"| Hours | {hours:.3f} |",
        "| Domain | surgical robotics |",
        f"| Data type | {boxes(DATA_TYPES, (data_type(p.about) for p in parts))} |",
        f"| Format | {format_name} |",
        f"| Licence | {_stated(about, 'license')} |",
        f"| Version | {_stated(about, 'version')} |",
        "",
        "Tasks, as instructions:",
        "",
        *[f"- {task}" for task in dataset.tasks],
        *(["", "Stages, as instructions (`instruction.stage`):", ""] if dataset.stages else []),
        *[f"- {stage}" for stage in dataset.stages],
    ]


def _robot(dataset: Dataset) -> list[str]:
    layout = dataset.layout
    rows = [
        f"| {arm} | {robot} | {tool} | {joints} | {'yes' if arm in layout.commanded else 'no'} |"
        for arm, robot, tool, joints in zip(
            layout.arms, layout.robots, layout.instruments, layout.joints, strict=True
        )
    ]
    return [
        "| arm | robot | instrument | joints | commanded |",
        "|---|---|---|---|---|",
        *rows,
        "",
        "Every instrument turns about a remote centre of motion (a trocar) that its controller"
        " holds.",
    ]


def _sensors(dataset: Dataset, about: Mapping[str, Any]) -> list[str]:
    rows = [
        f"| `{video.name}` | {video.shape[1]} x {video.shape[0]} | {video.camera} |"
        for video in schema.videos_of(dataset.features)
    ]
    return [
        f"Models: {_stated(about, 'cameras')}.",
        "",
        "| feature | width x height | recorded as |",
        "|---|---|---|",
        *rows,
        *_calibration(dataset),
    ]


def _calibration(dataset: Dataset) -> list[str]:
    """Where lenses, hand-eye and bases are stated."""
    found = [part.about.get("calibration") or {} for part in dataset.parts]
    if not any(each.get("files") or each.get("camera_info") for each in found):
        return []
    text = (
        "Lenses, stereo, hand-eye, bases and tools as measured are in `meta/calibration/`: the"
        " files as they were, and `index.json` with their SHA-256, the camera models and the"
        " episodes."
    )
    if dataset.layout.scope:
        text += (
            f" `{schema.CAMERA_POSE}` is the left camera in the world, from the joints of"
            f" {dataset.layout.scope} and these files."
        )
    return ["", text]


def _collection(dataset: Dataset, about: Mapping[str, Any]) -> list[str]:
    parts = dataset.parts
    kinds = {kind: sum(p.kind == kind for p in parts) for kind in (RECOVERY, FAILURE)}
    dates = sorted(str(p.about["created"])[:10] for p in parts if p.about.get("created"))
    return [
        f"- Collection method: {boxes(METHODS, (method(p.about) for p in parts))}",
        f"- Operators: {_stated(about, 'operators')}; named in the recordings:"
        f" {_each(dataset, 'operator')}",
        f"- Tasks: {_each(dataset, 'task')}; settings: {_each(dataset, 'setting')}",
        f"- Seeds: {_seeds(dataset)}",
        f"- Collected: {f'{dates[0]} to {dates[-1]}' if dates else 'not stated'}",
        f"- Varied on purpose: {_stated(about, 'varied')}",
        f"- Recovery demonstrations: {kinds[RECOVERY] or 'none'};"
        f" failures: {kinds[FAILURE] or 'none'}",
        f"- Software: {_each(dataset, 'software')}",
    ]


def _synchronization(dataset: Dataset) -> list[str]:
    return [
        _clocks(dataset),
        "",
        "The time of frame k is k / fps exactly. Pictures are the newest not later than it, at most"
        f" {dataset.options.max_image_age_s * 1000:g} ms old; measured values are interpolated"
        f" between samples at most {dataset.options.max_gap_s * 1000:g} ms apart. True stamps"
        " (integer nanoseconds) and ages of every frame are in the columns `timing.*`.",
        "",
        *_notes(dataset),
    ]


def _action_and_state(dataset: Dataset) -> list[str]:
    lines = [
        "Positions in metres, angles in radians, quaternions x, y, z, w. The rcm frame has its"
        " origin at the trocar and z along the home shaft axis into the patient. The action"
        f" space is `{dataset.options.action_space}`.",
        "",
        "| feature | type | numbers | unit | frame | resampling |",
        "|---|---|---|---|---|---|",
    ]
    for feature in schema.columns_of(dataset.features):
        units = ", ".join(dict.fromkeys(feature.units)) or "–"
        lines.append(
            f"| `{feature.name}` | {feature.dtype} | {', '.join(feature.names)} | {units} |"
            f" {feature.frame or '–'} | {feature.method or '–'} |"
        )
    privileged = ", ".join(f"`{f.name}`" for f in dataset.features if f.privileged)
    if privileged:
        note = "**Privileged** (ground truth that no robot can measure):"
        lines += ["", f"{note} {privileged}."]
    return lines


def _splits(dataset: Dataset) -> list[str]:
    rows = [f"| {name} | {a} to {b - 1} |" for name, (a, b) in dataset.splits.items()]
    return ["| split | recordings |", "|---|---|", *rows]


def _attribution(about: Mapping[str, Any]) -> list[str]:
    keys = ("lead", "institution", "contact", "citation")
    return [f"- {key.capitalize()}: {_stated(about, key)}" for key in keys]


def missing_sections(text: str) -> list[str]:
    """Errors for sections that a page lacks."""
    return [f"README.md has no section '{name}'" for name in SECTIONS if f"## {name}" not in text]


def _recordings(dataset: Dataset) -> list[Part]:
    """One part of each recording: long ones have several."""
    return list({part.key: part for part in dataset.parts}.values())


def _stated(about: Mapping[str, Any], key: str) -> str:
    return str(about.get(key) or "not stated").strip()


def _each(dataset: Dataset, key: str) -> str:
    """All different values of a fact about the recordings."""
    values = dict.fromkeys(str(part.about[key]) for part in dataset.parts if part.about.get(key))
    return ", ".join(values) or "not stated"


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


def _clocks(dataset: Dataset) -> str:
    """The recordings' clocks and sync verdicts."""
    clocks = list(dict.fromkeys(str(p.about.get("clock") or "not stated") for p in dataset.parts))
    verdicts: dict[str, int] = {}
    for part in dataset.parts:
        report = part.about.get("sync")
        verdict = str(report.get("verdict")) if isinstance(report, Mapping) else "no report"
        verdicts[verdict] = verdicts.get(verdict, 0) + 1
    counts = ", ".join(f"{verdict}: {count}" for verdict, count in verdicts.items())
    return (
        f"Clock of the stamps: {', '.join(clocks)}. Every message and picture was stamped at its"
        f" source and recorded with that stamp. Verdicts of the recordings' sync reports: {counts}."
    )


def _notes(dataset: Dataset) -> list[str]:
    """Repeated, skipped and oldest pictures of each camera."""
    rows, recordings = [], _recordings(dataset)
    for camera in dataset.layout.cameras:
        repeated = sum(int(p.notes.get(f"repeated_{camera}", 0)) for p in recordings)
        skipped = sum(int(p.notes.get(f"skipped_{camera}", 0)) for p in recordings)
        oldest = max(float(p.notes.get(f"oldest_{camera}_s", 0.0)) for p in recordings)
        rows.append(
            f"- {camera}: {repeated} pictures shown twice, {skipped} left out, the oldest"
            f" {oldest * 1000:.1f} ms old"
        )
    for part in recordings:
        if "segment" in part.notes:
            rows.append(f"- {Path(part.source).name}: {part.notes['segment']}, is in the dataset")
    return rows
