"""What does not fit a policy that looks ends in one error, before anything is trained or moved.

By the command lines of trainer and policy; what `./surg learn` refuses is in `test_cli_learn.py`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.policy.bgr_pictures import dataset_folder, image_policy, train_images
from helpers.policy.policy_server import PolicyServer, spec
from surg_learn.cloning import arm_columns, serve_policy

PICTURE = image_policy.PICTURE
Said = Callable[[], str]


@pytest.fixture
def line(capsys: pytest.CaptureFixture[str]) -> Said:
    """The one line that was printed as an error."""

    def only() -> str:
        (said,) = capsys.readouterr().err.strip().splitlines()
        print(said)
        return str(said)

    return only


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shape": (250, 320, 3), "heights": (250,)}, r"\[250, 320, 3\]"),
        ({"shape": (240, 320, 3)}, r"model is for a height of 480"),
        ({"heights": (480, 480), "focal": (450.0, 460.0)}, r"different cameras"),
        ({"action_space": "relative"}, r"'relative'.*allowed: 'absolute'"),
        ({"features": {"observation.state": {}}}, r"observation\.images\.endoscope\.left"),
    ],
    ids=["resolution", "calibration", "two cameras", "action space", "no pictures"],
)
def test_a_data_set_that_does_not_fit_trains_nothing(
    changes: dict[str, Any], said: str, tmp_path: Path, line: Said
) -> None:
    """With the folder's name, and without weights."""
    folder, out = dataset_folder(tmp_path / "set", **changes), tmp_path / "w.npz"
    assert train_images.main([str(folder), "--out", str(out)]) == 2
    told = line()
    assert str(folder) in told and re.search(said, told) and not out.exists()


def weights(file: Path, **head: Any) -> Path:
    """A file of weights as far as its head."""
    names = {"action": ["PSM1/dx", "PSM1/dy", "PSM1/dz", "PSM1/droll", "PSM1/jaw"]}
    whole = {"format": image_policy.ImagePolicy.format, "names": names, **head}
    array = np.frombuffer(json.dumps(whole).encode(), np.uint8)
    np.savez(file, head=array)
    return file


@pytest.mark.parametrize(
    ("head", "said"),
    [({}, "PSM1/dx"), ({"format": "surg_other/1"}, "format is not")],
    ids=["action space", "another policy"],
)
def test_weights_that_do_not_fit_connect_to_nobody(
    head: dict[str, Any], said: str, tmp_path: Path, line: Said
) -> None:
    file = weights(tmp_path / "w.npz", **head)
    with PolicyServer(spec(pictures=True)) as server:
        words = ["--weights", str(file), "--server", server.address]
        assert serve_policy.serve(image_policy.ImagePolicy, "", words) == 2
        assert server.heard == []
    told = line()
    assert said in told and str(file) in told


@pytest.mark.parametrize(
    ("pictures", "said"),
    [(False, "--cameras"), (True, "(240, 320, 3), the server has (480, 640, 3)")],
    ids=["no pictures", "resolution"],
)
def test_a_server_that_does_not_fit_is_sent_no_action(
    pictures: bool, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """One error: what it is, the difference, what to do."""

    def act(observation: Any) -> None:
        raise AssertionError("it was asked")

    policy = SimpleNamespace(
        wants=(arm_columns.STATE, PICTURE),
        names={},
        arm="PSM1",
        shape_of=lambda key: (240, 320, 3) if key == PICTURE else None,
        act=act,
    )
    kind: Any = SimpleNamespace(trainer="train_state.py", load=lambda file: policy)
    with PolicyServer(spec(pictures=pictures)) as server:
        words = ["--weights", "w.npz", "--server", server.address]
        assert serve_policy.serve(kind, "", words) == 1
        assert "ACT" not in [message.kind for _, message in server.heard]
    _, difference, remedy = capsys.readouterr().err.strip().splitlines()
    assert PICTURE in difference and said in difference and "Start the server" in remedy
