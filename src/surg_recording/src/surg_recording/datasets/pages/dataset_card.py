"""The card of a data set for the Hugging Face Hub: ``README.md`` with front matter, a picture."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from surg_recording.datasets import pictures, schema
from surg_recording.datasets.dataset import Dataset, Part
from surg_recording.datasets.pages.readme import TEMPLATES, data_type
from surg_recording.video import video_file

PICTURE = "preview.jpg"

_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def write(dataset: Dataset, out: Path, version: str, page: str) -> None:
    """Write ``README.md`` and its picture into a LeRobot data set of a version (``v3.0``).

    ``page`` is the text of ``meta/README.md``, which the card repeats below its own facts.
    """
    title, _, body = page.partition("\n")
    text = TEMPLATES.get_template("card.md").render(
        front_matter="\n".join(front_matter(dataset, dict(dataset.options.about))),
        title=title,
        body=body.rstrip(),
        picture=PICTURE if _write_picture(dataset, out / PICTURE) else None,
        name=f"USER/{_slug(dataset.name)}",
        version=version,
    )
    (out / "README.md").write_text(text, "utf-8")


def front_matter(dataset: Dataset, about: Mapping[str, Any]) -> list[str]:
    """The YAML between the dashes: what the Hub searches by."""
    types = dict.fromkeys(data_type(part.about) for part in dataset.parts)
    sizes = [name for limit, name in _SIZES if dataset.frames < limit]
    tags = ["LeRobot", "surgical-robotics", "laparoscopy", *map(_slug, types)]
    tags += [_slug(robot) for robot in dict.fromkeys(dataset.layout.robots)]
    return [
        *_licence(about.get("license")),
        f"pretty_name: {_quoted(str(about.get('name', dataset.name)))}",
        "task_categories:",
        "- robotics",
        "tags:",
        *[f"- {_quoted(tag)}" for tag in tags],
        "size_categories:",
        f"- {sizes[0] if sizes else '1M<n<10M'}",
        "configs:",
        "- config_name: default",
        '  data_files: "data/*/*.parquet"',
    ]


def _licence(stated: Any) -> list[str]:
    """Licence identifier of the Hub for Creative Commons and Apache licences, else ``other``."""
    if not stated:
        return ["license: unknown"]
    slug = _slug(str(stated))
    if re.fullmatch(r"cc-by(-nc)?(-sa|-nd)?-\d\.\d|cc0-1\.0|apache-2\.0|mit", slug):
        return [f"license: {slug}"]
    return ["license: other", f"license_name: {_quoted(str(stated))}"]


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-")


def _quoted(text: str) -> str:
    """A YAML string on one line."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ") + '"'


def _write_picture(dataset: Dataset, path: Path) -> bool:
    """The middle frame of the first episode, all cameras side by side; False without cameras."""
    part: Part = dataset.parts[0]
    images = []
    for feature in schema.videos_of(dataset.features):
        video = part.folder / f"{feature.name}.mp4"
        frame = next(video_file.frames(video, [part.frames // 2]))
        images.append(pictures.rgb(frame))
    if not images:
        return False
    height = min(image.shape[0] for image in images)
    same = [image for image in images if image.shape[0] == height]
    Image.fromarray(np.hstack(same)).save(path, quality=90)
    return True
