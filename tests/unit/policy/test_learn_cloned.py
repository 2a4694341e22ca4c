"""BC, ACT and MoE-ACT from pictures, on made-up ones: what is learned, saved, said, and refused."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from conftest import FULL
from helpers.policy import bgr_cloned as made
from helpers.policy.bgr_cloned import (
    LEFT,
    RIGHT,
    cloned_networks,
    cloned_policy,
    recorded_steps,
    train_cloned,
)
from helpers.policy.bgr_pictures import keypoint_network, picture_augmentation
from helpers.policy.bgr_synthetic import STATE
from surg_learn.cloning import arm_columns, serve_policy

SMALL = {
    "width": 8, "places": 8, "model": 32, "heads": 2, "feed": 64, "layers": 1, "latent": 4,
    "hidden": 32,
}  # fmt: skip
CALM = picture_augmentation.Looks(0.05, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
OPTIONS = train_cloned.Options(
    chunk=6,
    steps=150 if FULL else 50,
    batch=16,
    rate=3e-3,
    warm=10,
    noise=0.1,
    device="cpu",
    sizes=SMALL,
    looks=CALM,
)
FEW = made.recorded(8, 3)
Policy = cloned_policy.ClonedPolicy


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Beside other work two threads wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def trained(found: Any = None, **changes: Any) -> Policy:
    options = dataclasses.replace(OPTIONS, **changes)
    return train_cloned.train(found or FEW, options)


METHODS = [
    pytest.param(method, marks=[] if method == "moe_act" else pytest.mark.full)
    for method in cloned_networks.METHODS
]
"""The one that has all parts of the others, and in the full tier those."""


@pytest.fixture(scope="module", params=METHODS)
def policy(request: pytest.FixtureRequest) -> Policy:
    return trained(method=request.param)


def weights(sizes: dict[str, Any], **head: Any) -> Policy:
    """A policy with random weights."""
    torch.manual_seed(0)
    whole = cloned_networks.Sizes(**{"chunk": 6, "inputs": 13, **SMALL, **sizes})
    scales = {
        "input_mean": np.zeros(13),
        "input_std": np.ones(13),
        "output_mean": np.zeros(5 * whole.chunk),
        "output_std": np.full(5 * whole.chunk, 1e-3),
        "jaw_range": np.array([0.0, 0.7]),
    }
    about = {"pictures": [LEFT, RIGHT][: whole.eyes], "play": 1, **head}
    names = {"observation.state": STATE, "action": arm_columns.actions_of("PSM1")}
    return Policy(cloned_networks.network_of(whole), scales, names, whole, about)


def observed(found: Any, step: int) -> dict[str, np.ndarray]:
    views = {key: each[step] for key, each in found.views.items()}
    return {"observation.state": found.state[step], **views}


# --- what is learned ----------------------------------------------------------------------------


def test_it_learns_more_than_the_mean_action(policy: Policy) -> None:
    """On episodes that it has not seen."""
    found = FEW
    steps = train_cloned.Steps.of(found, "val", policy.chunk)
    flat = steps.targets.reshape(len(steps.rows), -1)
    mean = np.abs((flat - policy.scales["output_mean"]) / policy.scales["output_std"]).mean()
    said = policy.about["val"]
    print(policy.method, said, f"mean action {mean:.3f}")
    assert max(said["chunk"], said["first"]) < 0.7 * mean


def test_the_gate_learns_the_phases_and_nothing_else_has_one(policy: Policy) -> None:
    said = policy.about["val"].get("gate")
    if policy.method == "moe_act":
        share = max(np.bincount(FEW.phase)) / len(FEW.phase)
        assert said > 0.9 > share + 0.1
        assert policy.about["phases"] == [made.APPROACH, made.CLOSE]
        assert policy.about["labels"] == [recorded_steps.PHASE]
    else:
        assert said is None and policy.about["labels"] == []


def test_a_spot_of_a_heat_map_is_found_where_it_is() -> None:
    """Between two cells, as the eye of the image policy counts: down, right, -1 to 1."""
    maps = torch.full((1, 2, 30, 30), -30.0)
    maps[0, 0, 7, 21] = maps[0, 0, 8, 21] = maps[0, 1, 29, 0] = 0.0
    found = cloned_networks.middles(maps)[0].tolist()
    cells = keypoint_network.grid(30).reshape(30, 30, 2)
    between = 0.5 * (cells[7, 21] + cells[8, 21])
    np.testing.assert_allclose(found, [between[0], 1.0, between[1], -1.0], atol=1e-5)


def test_each_expert_says_the_actions_of_its_own_phase() -> None:
    """A gate that is sure leaves one expert's word: that of the output that is set."""
    sizes = cloned_networks.Sizes("moe_act", 3, 13, phases=2, **SMALL)
    experts = cloned_networks.Experts(sizes)
    out, seen = torch.randn(4, 3, 32), torch.randn(4, 64)
    for n in (0, 1):
        with torch.no_grad():
            experts.gate[-1].weight.zero_()
            experts.gate[-1].bias[:] = torch.tensor([0.0, 0.0])
            experts.gate[-1].bias[n] = 50.0
            said, gate = experts(out, seen)
            alone = experts.experts[n](out)
        assert (gate.argmax(dim=1) == n).all()
        torch.testing.assert_close(said, alone)


def test_steps_without_a_phase_teach_the_gate_nothing() -> None:
    answer = cloned_networks.Answer(torch.zeros(3, 5), torch.tensor([[2.0, 0.0]] * 3))
    told, none = torch.zeros(3, 5), recorded_steps.NO_PHASE
    alone = train_cloned.losses(answer, told, torch.tensor([0, none, none]))["gate"]
    expected = -torch.log_softmax(torch.tensor([2.0, 0.0]), 0)[0]
    torch.testing.assert_close(alone, expected)
    assert train_cloned.losses(answer, told, torch.full((3,), none))["gate"] == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_one_seed_gives_the_same_weights_and_another_others(method: str) -> None:
    found = made.recorded(2)
    hashes = [trained(found, method=method, steps=3, seed=seed).hash for seed in (0, 0, 1)]
    assert hashes[0] == hashes[1] != hashes[2]


# --- deployment ---------------------------------------------------------------------------------


def test_it_reads_what_a_robot_measures_and_answers_chunks(policy: Policy) -> None:
    """A dictionary that holds nothing else is enough; a chunk begins at the arm."""
    assert policy.wants == ("observation.state", LEFT) and policy.about["privileged"] == []
    for begin in (each.start for each in FEW.episodes("val")):
        policy.reset("", None)
        chunk = policy.act(observed(FEW, begin))
        assert chunk.shape == (6, 5) and chunk.dtype == np.float64
        assert np.linalg.norm(chunk[0, :3] - FEW.state[begin, :3]) < 4e-3
    assert chunk[:, 4].min() >= 0.0 and chunk[:, 4].max() <= made.OPEN + 1e-9


def test_two_eyes_are_read_and_matter() -> None:
    policy = weights({"method": "act", "eyes": 2})
    assert policy.wants == ("observation.state", LEFT, RIGHT)
    seen = observed(made.recorded(1, eyes=2), 3)
    both = policy.act(seen)
    policy.reset()
    assert np.abs(policy.act({**seen, RIGHT: np.zeros_like(seen[RIGHT])}) - both).max() > 1e-6
    found = made.recorded(1, eyes=2)
    assert trained(found, method="bc", steps=1).pictures == (LEFT, RIGHT)


def test_saved_and_loaded_it_says_the_same(policy: Policy, tmp_path: Path) -> None:
    file = tmp_path / "w.npz"
    policy.save(file)
    again = Policy.load(file)
    assert again.hash == policy.hash and again.method == policy.method
    seen = observed(FEW, 10)
    for each in (policy, again):
        each.reset("", None)
    np.testing.assert_array_equal(again.act(seen), policy.act(seen))
    assert serve_policy.wanted(again).observation[LEFT].shape == (120, 120, 3)


def scripted(
    monkeypatch: pytest.MonkeyPatch, policy: Policy, chunk_from: Any, numbered: bool
) -> Any:
    """What the policy says at a step where its network's chunks are made up, (1, K, 5)."""
    answer = SimpleNamespace(chunk=torch.zeros(1, 5 * policy.chunk))
    monkeypatch.setattr(policy, "answer", lambda *a: answer)
    monkeypatch.setattr(policy, "actions", chunk_from)
    view = np.zeros((120, 120, 3), np.uint8)
    arrays = {"observation.state": np.zeros(len(STATE)), LEFT: view}
    policy.reset()

    def act(step: int) -> Any:
        return policy.act(SimpleNamespace(arrays=arrays, step=step) if numbered else arrays)

    return act


@pytest.mark.parametrize("numbered", [False, True])
def test_it_plays_the_steps_of_a_chunk_before_it_asks_again(
    numbered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next chunk begins at the last row that was played; a refusal ends the playing at once."""
    policy = weights({"method": "bc", "chunk": 6}, play=3)
    lasts: list[np.ndarray] = []

    def chunk_from(said: Any, last: np.ndarray) -> np.ndarray:
        lasts.append(last[0])
        along = 1e-3 * np.arange(1, 7)[:, None]
        return (np.append(last[0], 0.0) + along)[None]

    act = scripted(monkeypatch, policy, chunk_from, numbered)
    said = [act(step) for step in range(7)]
    assert [chunk is not None for chunk in said] == [True, False, False, True, False, False, True]
    np.testing.assert_allclose(np.array(lasts)[:, 0], [0.0, 3e-3, 6e-3])
    policy.acknowledged({"rejected": [{"step": 7}]})
    assert act(7) is not None
    np.testing.assert_allclose(lasts[-1], 0.0, err_msg="the arm is at rest again")


@pytest.mark.parametrize("numbered", [False, True])
def test_a_long_chunk_is_said_again_before_the_server_forgets_it(
    numbered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that takes 12 steps of an answer plays all rows, each at its own time."""
    policy = weights({"method": "bc", "chunk": 40}, play=36)
    asked: list[int] = []

    def chunk_from(said: Any, last: np.ndarray) -> np.ndarray:
        asked.append(step)
        rows = 1e-4 * (asked[-1] + np.arange(40))[:, None]
        return np.tile(rows, 5)[None]

    act = scripted(monkeypatch, policy, chunk_from, numbered)
    left: list[float] = []
    for step in range(90):
        answer = act(step)
        if answer is not None:
            left = list(answer[:12, 0])
        assert 1e4 * left.pop(0) == pytest.approx(step)
    assert asked == [0, 36, 72]


# --- looks --------------------------------------------------------------------------------------


def test_training_varies_both_eyes_alike_and_each_step_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The right eye's pictures are the left one's here."""
    found = made.recorded(1, 0, eyes=2)
    found.views[RIGHT] = found.views[LEFT]
    seen: list[list[torch.Tensor]] = []
    forward = cloned_networks.network_of

    def watched(sizes: Any) -> Any:
        network = forward(sizes)
        network.register_forward_pre_hook(lambda _, given: seen.append(given[0]))
        return network

    monkeypatch.setattr(train_cloned, "network_of", watched)
    trained(found, method="bc", eyes=2, steps=2, looks=picture_augmentation.Looks(grain=0.0))
    for left, right in seen[:2]:
        torch.testing.assert_close(left, right)
    assert not torch.equal(seen[0][0], seen[1][0])


# --- data ---------------------------------------------------------------------------------------


def test_a_dataset_is_read_and_trained_with(tmp_path: Path) -> None:
    found = made.recorded(2, 0, eyes=2)
    folder = made.written(tmp_path / "set", found)
    read = recorded_steps.read(folder, (LEFT, RIGHT), "PSM1")
    np.testing.assert_allclose(read.state, found.state, atol=1e-6)
    np.testing.assert_array_equal(read.begins, found.begins)
    phase = found.phase.copy()
    phase[found.begins[1:] - 1] = recorded_steps.NO_PHASE
    np.testing.assert_array_equal(read.phase, phase)
    assert read.phases == [made.APPROACH, made.CLOSE] and read.split == ["train", "train"]
    for key in (LEFT, RIGHT):
        off = np.abs(read.views[key].astype(int) - found.views[key])
        assert off.mean() < 4.0, "what the codec leaves"
    words = [str(folder), "--method", "bc", "--out", str(tmp_path / "w.npz"), "--steps", "1"]
    assert train_cloned.main([*words, "--batch", "2", "--device", "cpu"]) == 0
    head = np.load(tmp_path / "w.npz", allow_pickle=False)["head"].tobytes()
    assert json.loads(head)["about"]["frames"] == len(found.state)


def test_one_of_several_arms_is_learned(tmp_path: Path) -> None:
    """The other one's columns stand before its own, and are neither read nor commanded."""
    found = made.recorded(2, 0)
    names = {
        key: [name.replace("PSM1", "ECM") for name in each] for key, each in found.names.items()
    }
    both = dataclasses.replace(
        found,
        state=np.hstack([np.full_like(found.state, 7.0), found.state]),
        action=np.hstack([np.full_like(found.action, 7.0), found.action]),
        names={key: [*found.names[key], *each] for key, each in names.items()},
    )
    folder = made.written(tmp_path / "set", both)
    read = recorded_steps.read(folder, (LEFT,), "ECM")
    np.testing.assert_allclose(read.action, found.action, atol=1e-6)
    policy = trained(read, steps=1)
    assert policy.arm == "ECM" and policy.names == read.names == names
    assert serve_policy.wanted(policy).action.names == tuple(arm_columns.actions_of("ECM"))
    with pytest.raises(ValueError, match=r"no action of PSM2; it has PSM1/x"):
        recorded_steps.read(folder, (LEFT,), "PSM2")


def test_steps_that_lead_to_a_miss_are_left_out() -> None:
    found = made.recorded(1, 0)
    found.action[10:12, 4] = 0.0  # closes on nothing, and opens again
    rows = train_cloned.Steps.of(found, "train", 4).rows
    assert set(range(11)).isdisjoint(rows) and 12 in rows


# --- what does not fit --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words", "said"),
    [
        ({"action_space": "relative"}, [], "'relative'.*allowed: 'absolute'"),
        ({}, ["--eyes", "2"], "endoscope.right"),
        ({"splits": {"val": "0:1"}}, [], "'train'"),
        ({"features": {"observation.state": {}}}, [], "endoscope.left"),
        ({"fps": 10}, [], "10 Hz; allowed: 20.*--fps"),
        ({"codebase_version": "v3.0"}, [], "v3.0.*allowed: v2.1.*--format lerobot"),
        ({}, ["--play", "17"], "--play 17: allowed are 1 to 16"),
        ({}, ["--chunk", "0"], "--chunk 0: allowed are 1 and more"),
    ],
    ids=[
        "action space",
        "no right eye",
        "no training",
        "no pictures",
        "rate",
        "version",
        "play",
        "chunk",
    ],
)
def test_a_dataset_that_does_not_fit_is_one_line(
    change: dict[str, Any],
    words: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = made.written(tmp_path / "set", made.recorded(1, 0), **change)
    out = tmp_path / "w.npz"
    argv = [str(folder), "--method", "bc", "--out", str(out), "--device", "cpu", *words]
    assert train_cloned.main(argv) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert re.search(said, line) and not out.exists()


def test_moe_act_without_phases_says_who_makes_them() -> None:
    found = dataclasses.replace(made.recorded(1), phases=[])
    with pytest.raises(ValueError, match=r"subtask_description.*\./surg episode label"):
        trained(found, method="moe_act")


def test_weights_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "w.npz"
    policy = weights({"method": "bc"})
    policy.names["action"] = ["PSM1/dx", "PSM1/dy", "PSM1/dz", "PSM1/droll", "PSM1/jaw"]
    policy.save(file)
    with pytest.raises(ValueError, match=r"PSM1/dx.*allowed: PSM1/x"):
        Policy.load(file)
    policy = weights({"method": "bc"})
    policy.sizes = dataclasses.replace(policy.sizes, width=16)
    policy.save(file)
    with pytest.raises(ValueError, match="another network"):
        Policy.load(file)
    np.savez(file, a=np.zeros(2))
    with pytest.raises(ValueError, match="no weights"):
        Policy.load(file)
    for cut in (100, 0):
        file.write_bytes(file.read_bytes()[:cut])
        with pytest.raises(ValueError, match=r"w\.npz: no weights"):
            Policy.load(file)
