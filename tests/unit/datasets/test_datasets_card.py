"""The card for the Hub, and the boxes of Open-H's template."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import pytest
import yaml

from helpers.recording import datasets_synthetic, picture_identity
from surg_recording import datasets
from surg_recording.datasets import ExportOptions
from surg_recording.datasets.pages import dataset_card, readme


@pytest.mark.parametrize(
    ("format_name", "version"), [("lerobot_v21", "v2.1"), ("lerobot_v30", "v3.0")]
)
def test_a_data_set_has_a_card_with_front_matter_picture_and_units(
    format_name: str, version: str, tmp_path: Path
) -> None:
    folder = datasets_synthetic.record(tmp_path / "episode", 6, 0.5)
    about = {"license": "CC BY 4.0", "name": 'Paths: a "first" set'}
    options = ExportOptions(executor="serial", splits={"train": 1.0}, about=about)
    out = tmp_path / "my set"
    assert datasets.load(format_name).write([folder], out, options).ok
    text = (out / "README.md").read_text()
    _, front, body = text.split("---\n", 2)
    stated = yaml.safe_load(front)
    assert stated["license"] == "cc-by-4.0"
    assert stated["pretty_name"] == 'Paths: a "first" set'
    assert stated["task_categories"] == ["robotics"]
    assert {"LeRobot", "digital-simulation", "ur5e"} <= set(stated["tags"])
    assert stated["size_categories"] == ["n<1K"]
    (config,) = stated["configs"]
    assert list(out.glob(config["data_files"]))
    assert "| `observation.state` | float32 | PSM1/tip_x, PSM1/tip_y" in body
    assert "| m, rad |" in body, "units"
    assert "hf upload USER/my-set . --repo-type dataset" in body
    assert f"hf repo tag create USER/my-set {version} --repo-type dataset" in body
    assert f"![A frame of the first episode]({dataset_card.PICTURE})" in body
    picture = cv2.imread(str(out / dataset_card.PICTURE))
    assert picture.shape[1] == 2 * picture_identity.WIDTH
    seen = picture_identity.read(picture[:, : picture_identity.WIDTH])
    assert (seen.recording, seen.camera) == (6, 0)
    page = (out / "meta/README.md").read_text()
    assert "[x] Digital Simulation" in page and "[ ] Clinical" in page
    assert "[x] Human Teleoperation" in page and "[ ] AI Policy / Autonomous" in page


@pytest.mark.parametrize(
    ("about", "kind", "method"),
    [
        ({"simulated": True, "setting": "ex_vivo"}, "Digital Simulation", "Other"),
        ({"setting": "phantom", "operator": "A"}, "Table-Top Phantom", "Human Teleoperation"),
        ({"setting": "ex_vivo", "operator": "policy act"}, "Ex-Vivo", "AI Policy / Autonomous"),
        ({"setting": "in_vivo"}, "Clinical", "Other"),
        ({"operator": "scripted expert"}, "Other", "Programmatic/State-Machine"),
        ({"operator": "recorded motion"}, "Other", "Programmatic/State-Machine"),
    ],
)
def test_open_hs_boxes_follow_from_the_manifest(
    about: dict[str, Any], kind: str, method: str
) -> None:
    assert readme.data_type(about) == kind
    assert readme.method(about) == method


@pytest.mark.parametrize(
    ("stated", "line"),
    [
        (None, "license: unknown"),
        ("CC BY-NC-SA 4.0", "license: cc-by-nc-sa-4.0"),
        ("Apache 2.0", "license: apache-2.0"),
        ("ours alone", "license: other"),
    ],
)
def test_licences_are_those_of_the_hub(stated: Any, line: str) -> None:
    assert dataset_card._licence(stated)[0] == line
