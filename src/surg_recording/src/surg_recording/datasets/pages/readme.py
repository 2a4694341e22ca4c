"""The README of a dataset, as Open-H-Embodiment requires it, filled from the manifests.

The page itself is ``templates/readme.md``. Facts unknown to the manifests (licence, contact,
operators) come from ``--about FILE.yaml``. A missing fact reads "not stated".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jinja2

from surg_recording.datasets import schema
from surg_recording.datasets.dataset import Dataset, Part

TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)

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

DATA_TYPES = ("Clinical", "Ex-Vivo", "Table-Top Phantom", "Digital Simulation", "Other")
METHODS = ("Human Teleoperation", "Programmatic/State-Machine", "AI Policy / Autonomous", "Other")
"""Boxes to tick, as in Open-H's template."""

_OF_A_SETTING = {"phantom": DATA_TYPES[2], "ex_vivo": DATA_TYPES[1], "in_vivo": DATA_TYPES[0]}
_PROGRAMS = ("scripted", "recorded motion")


def page(dataset: Dataset, format_name: str) -> str:
    """The page as Markdown."""
    about, layout = dict(dataset.options.about), dataset.layout
    facts = [part.about for part in dataset.parts]
    calibrations = [each.get("calibration") or {} for each in facts]
    recordings = list({part.key: part for part in dataset.parts}.values())
    dates = sorted(str(each["created"])[:10] for each in facts if each.get("created"))
    return TEMPLATES.get_template("readme.md").render(
        about=about,
        arms=list(zip(layout.arms, layout.robots, layout.instruments, layout.joints, strict=True)),
        calibrated=any(each.get("files") or each.get("camera_info") for each in calibrations),
        camera_pose=schema.CAMERA_POSE,
        clocks=_words(facts, "clock"),
        columns=schema.columns_of(dataset.features),
        data_types=_boxes(DATA_TYPES, map(data_type, facts)),
        dataset=dataset,
        dates=f"{dates[0]} to {dates[-1]}" if dates else "not stated",
        each=lambda key: _words([fact for fact in facts if fact.get(key)], key),
        format_name=format_name,
        kinds=Counter(part.kind for part in dataset.parts),
        layout=layout,
        methods=_boxes(METHODS, map(method, facts)),
        name=about.get("name", dataset.name),
        options=dataset.options,
        parts=dataset.parts,
        pictures=[_shown_pictures(camera, recordings) for camera in layout.cameras],
        privileged=[feature.name for feature in dataset.features if feature.privileged],
        recordings=recordings,
        seeds=_seeds(facts),
        stated=lambda key: str(about.get(key) or "not stated").strip(),
        summary=about.get("summary", _summary(dataset)),
        verdicts=_verdicts(facts),
        videos=schema.videos_of(dataset.features),
    )


def data_type(about: Mapping[str, Any]) -> str:
    """Type of a recording's data, one of ``DATA_TYPES``: from its simulator and setting."""
    if about.get("simulated"):
        return DATA_TYPES[3]
    return _OF_A_SETTING.get(str(about.get("setting")), DATA_TYPES[-1])


def method(about: Mapping[str, Any]) -> str:
    """How a recording was collected, one of ``METHODS``: from its operator; unknown: other."""
    operator = str(about.get("operator") or "")
    if operator.startswith("policy "):
        return METHODS[2]
    if operator.startswith(_PROGRAMS):
        return METHODS[1]
    return METHODS[0] if operator else METHODS[-1]


def missing_sections(text: str) -> list[str]:
    """Errors for sections that a page lacks."""
    return [f"README.md has no section '{name}'" for name in SECTIONS if f"## {name}" not in text]


def _boxes(allowed: Iterable[str], found: Iterable[str]) -> str:
    """Boxes to tick, with those that were found ticked."""
    ticked = set(found)
    return " ".join(f"[{'x' if name in ticked else ' '}] {name}" for name in allowed)


def _words(facts: Iterable[Mapping[str, Any]], key: str) -> str:
    """All different values of a fact about the recordings."""
    return ", ".join(dict.fromkeys(str(fact.get(key) or "not stated") for fact in facts)) or (
        "not stated"
    )


def _seeds(facts: Iterable[Mapping[str, Any]]) -> str:
    seeds = [fact["seed"] for fact in facts if isinstance(fact.get("seed"), int)]
    if len(set(seeds)) <= 1:
        return str(seeds[0]) if seeds else "not stated"
    return f"{min(seeds)} to {max(seeds)}"


def _summary(dataset: Dataset) -> str:
    robots = " and ".join(dict.fromkeys(dataset.layout.robots))
    count = len(dataset.parts)
    noun = "recording" if count == 1 else "recordings"
    return f"{count} {noun} of {robots}: {'; '.join(dataset.tasks)}."


def _verdicts(facts: Iterable[Mapping[str, Any]]) -> str:
    """How many sync reports of the recordings say what."""
    reports = [fact.get("sync") for fact in facts]
    counts = Counter(
        str(report.get("verdict")) if isinstance(report, Mapping) else "no report"
        for report in reports
    )
    return ", ".join(f"{verdict}: {count}" for verdict, count in counts.items())


def _shown_pictures(camera: str, recordings: Iterable[Part]) -> tuple[str, int, int, float]:
    """A camera, its pictures shown twice and left out, and the age of the oldest [ms]."""
    notes = [part.notes for part in recordings]
    repeated = sum(int(each.get(f"repeated_{camera}", 0)) for each in notes)
    skipped = sum(int(each.get(f"skipped_{camera}", 0)) for each in notes)
    oldest = max(float(each.get(f"oldest_{camera}_s", 0.0)) for each in notes)
    return camera, repeated, skipped, oldest * 1000
