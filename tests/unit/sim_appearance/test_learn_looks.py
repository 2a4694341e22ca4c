"""`./surg learn --domain-randomization`: which demonstrations are played with which looks."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from surg_cli.commands import learn
from surg_cli.host.terminal import CliError
from surg_learn.recipes import Request

demonstrations = pytest.importorskip("surg_sim.envs.demonstrations")

from surg_sim.appearance.domain_randomization import DomainRandomization  # noqa: E402
from surg_sim.physics import cell_files  # noqa: E402


def asked(*words: str) -> Request:
    parser = argparse.ArgumentParser()
    learn.add_arguments(parser, "learn")
    return learn.check(parser.parse_args(["bgr", *words]))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file of ranges with one that varies."""
    made = tmp_path / "looks.yaml"
    made.write_text("format: surg_looks/1\nlight_strength: [0.4, 1.6]\n")
    return made


def test_looks_are_part_of_what_demonstrations_depend_on(file: Path) -> None:
    plain, own = asked("--cameras"), asked("--cameras", "--domain-randomization", str(file))
    assert plain.look_ranges is None and "looks" not in plain.demonstrations
    varied = replace(DomainRandomization.none(), light_strength=(0.4, 1.6))
    assert own.look_ranges == varied
    assert own.demonstrations == {**plain.demonstrations, "looks": asdict(varied)}
    assert asked("--cameras", "--domain-randomization").look_ranges == DomainRandomization()
    labelled = asked("--cameras", "keypoints", "--domain-randomization").look_ranges
    still = {"camera_shift_mm": (0.0, 0.0), "camera_turn_deg": (0.0, 0.0)}
    assert labelled == replace(DomainRandomization(), **still)
    resumed = learn.command_line(own, Path("runs/L"))
    assert f"--cameras moe_act --domain-randomization {file} --out" in resumed


def test_looks_that_cannot_be_trained_with_are_refused(file: Path) -> None:
    with pytest.raises(CliError, match="without --cameras"):
        asked("--domain-randomization")
    with pytest.raises(CliError, match=r"no\.yaml"):
        asked("--cameras", "--domain-randomization", str(file.with_name("no.yaml")))
    file.write_text("format: surg_looks/1\ncamera_turn_deg: [0, 3]\n")
    with pytest.raises(CliError, match="labels are of the stated camera"):
        asked("--cameras", "keypoints", "--domain-randomization", str(file))
    turned = asked("--cameras", "--domain-randomization", str(file)).look_ranges
    assert turned is not None and turned.camera_turn_deg == (0.0, 3.0)


def test_a_recording_with_another_look_is_played_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = demonstrations.DemonstrationPlan(tmp_path, cell_files.find("sim_ur5e"), "pick_and_place")
    wide = replace(plan, randomization=DomainRandomization())
    (recorded,) = demonstrations.play(plan, [3], 1)
    assert recorded.seed == 3 and plan.done(3) and not wide.done(3)
    manifest = tmp_path / "3" / "manifest.json"
    content = json.loads(manifest.read_text("utf-8"))
    content["run"]["look"] = DomainRandomization().draw(3).described()
    manifest.write_text(json.dumps(content), "utf-8")
    assert wide.done(3) and not plan.done(3)
    content["run"] |= {"look": None, "expert_noise": 4.0}
    manifest.write_text(json.dumps(content), "utf-8")
    assert replace(plan, expert_noise=4.0).done(3) and not replace(plan, expert_noise=5.0).done(3)
    assert not replace(plan, expert_noise=4.0, cameras=("left",)).done(3), "it has no picture"
