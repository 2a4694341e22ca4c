"""Which node publishes the endoscope's pictures, by the cell and the options."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.endoscope_files import copied_cell
from helpers.graph.surg import printed
from surg_cli.host import provision
from surg_cli.host.terminal import CliError

SECTION = "endoscope: {source: 'v4l2:/dev/video0', layout: LAYOUT, size: [1920, 1080], rate: 30}\n"


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """The bundled cell with a grabber."""
    folder = copied_cell(tmp_path, "sim_ur5e")
    text = (folder / "cell.yaml").read_text("utf-8")
    (folder / "cell.yaml").write_text(text + SECTION.replace("LAYOUT", "sbs"), "utf-8")
    return folder


def test_a_cell_without_a_source_has_the_simulators(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for line in printed(capsys, "sim_ur5e") if "__name:=endoscope" in line]
    assert len(lines) == 1
    assert "rosrun surg_sim endoscope_node.py" in lines[0]


@pytest.mark.parametrize(("layout", "cameras"), [("sbs", 2), ("mono", 1)])
def test_a_source_replaces_the_simulators_endoscope(
    cell: Path, layout: str, cameras: int, capsys: pytest.CaptureFixture[str]
) -> None:
    file = cell / "cell.yaml"
    file.write_text(file.read_text("utf-8").replace("layout: sbs", f"layout: {layout}"), "utf-8")
    lines = printed(capsys, str(cell))
    (node,) = [line for line in lines if "__name:=endoscope" in line]
    assert "rosrun surg_perception capture_node.py" in node
    for word in ("_source:=v4l2:/dev/video0", f"_layout:={layout}", "_width:=1920", "_rate:=30"):
        assert word in node
    (recorder,) = [line for line in lines if "recorder_node.py" in line]
    assert recorder.count("endoscope_") == cameras
    (bridge,) = [line for line in lines if "bridge_node.py" in line]
    assert "endoscope" not in bridge, "the simulator does not wait for it"


def test_no_video_starts_none_and_lock_step_refuses_a_real_one(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = printed(capsys, str(cell), "--cameras", "none", "--lock-step")
    assert not any("__name:=endoscope" in line for line in words)
    with pytest.raises(CliError, match=r"endoscope\.source.*real time"):
        printed(capsys, str(cell), "--lock-step")


def test_gstreamer_is_installed_on_request_only(tmp_path: Path) -> None:
    path = tmp_path / "packages"
    path.write_text("cmake\n# == later\nchromium\n# == gstreamer\npython3-gst-1.0  # why\n")
    assert provision.listed_packages(path) == ["cmake", "chromium"]
    assert provision.listed_packages(path, False, ["gstreamer"]) == ["cmake", "python3-gst-1.0"]
    optional = set(provision.listed_packages(optional=provision.OPTIONAL))
    assert optional - set(provision.listed_packages()) >= {"gstreamer1.0-plugins-bad"}
