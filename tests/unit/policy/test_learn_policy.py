"""The learned policy and its trainer: same by seed, on disk without code, at work as in training.

On made-up data: what it does in the phantom stands in docs/guide/learning.md.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from helpers.policy import bgr_synthetic as made
from helpers.policy.bgr_synthetic import (
    action_head,
    lerobot_dataset,
    perceptron,
    train_state,
)
from helpers.policy.example_program import said_alone
from surg_learn.bgr import observed_features, state_policy
from surg_learn.cloning import arm_columns, chunk_policy

FEW = action_head.HandOptions(steps=60, hidden=(32, 32), batch=64, chunk=8)


@pytest.fixture(scope="module")
def policy() -> state_policy.Policy:
    return train_state.train(made.dataset(), FEW)


def test_one_seed_one_policy(policy: state_policy.Policy) -> None:
    again = train_state.train(made.dataset(), FEW)
    other = train_state.train(made.dataset(), action_head.HandOptions(**{**vars(FEW), "seed": 1}))
    assert again.hash == policy.hash != other.hash
    less = train_state.train(made.dataset(train=5), FEW)
    assert less.hash != policy.hash


def test_the_gradient_is_that_of_the_loss() -> None:
    """Against central differences in float64, for every parameter of a small network."""
    rng = np.random.default_rng(3)
    flat, layers = perceptron.flat_layers([(5, 7), (7, 6), (6, 4)])
    flat = flat.astype(np.float64)
    at, layers64 = 0, []
    for weight, bias in layers:
        layers64.append((flat[at : at + weight.size].reshape(weight.shape),
                         flat[at + weight.size : at + weight.size + bias.size]))  # fmt: skip
        at += weight.size + bias.size
    flat[:] = rng.normal(0.0, 0.5, flat.size)
    network = chunk_policy.Network(layers64)
    x, y = rng.normal(size=(11, 5)), rng.normal(size=(11, 4))
    slope, grads = perceptron.flat_layers([(5, 7), (7, 6), (6, 4)])
    perceptron.gradient_of(network, grads, x, y)

    def loss() -> float:
        error = np.abs(network(x) - y)
        return float(np.mean(np.where(error < 0.5, 0.5 * error**2, 0.5 * (error - 0.25))))

    step = 1e-6
    for i in range(flat.size):
        kept = flat[i]
        flat[i] = kept + step
        up = loss()
        flat[i] = kept - step
        down = loss()
        flat[i] = kept
        assert slope[i] == pytest.approx((up - down) / (2 * step), abs=2e-6)
    print(f"{flat.size} parameters")


def test_what_is_seen_may_be_behind_what_was_said() -> None:
    """In real time a step is done some time after the observation that it answers."""
    columns = observed_features.Columns(made.STATE, made.TASK)
    (shown,) = made.dataset(train=1).episodes["train"]
    n, S = len(shown.state), columns.state
    known = train_state.samples([shown], columns, np.eye(4), 8, behind=2)
    last = lerobot_dataset.last_commands(shown.state, shown.action, S[arm_columns.SET])
    for steps in range(3):
        part = slice(steps * n, (steps + 1) * n)
        seen = shown.state[np.maximum(np.arange(n) - steps, 0)]
        np.testing.assert_array_equal(known.inputs[part, observed_features.HERE], last[:, :3])
        np.testing.assert_array_equal(known.targets[part], known.targets[:n])
        np.testing.assert_array_equal(known.jaw[part], seen[:, S[4]])
        behind = known.inputs[part, 13:16]
        np.testing.assert_allclose(behind, seen[:, S[:3]] - last[:, :3], atol=1e-15)
    alone = train_state.samples([shown], columns, np.eye(4), 8)
    np.testing.assert_array_equal(alone.inputs, known.inputs[:n])
    assert len(known.inputs) == 3 * n


def test_an_arm_that_is_moved_aside_comes_back_and_closes_no_jaw_before() -> None:
    columns = observed_features.Columns(made.STATE, made.TASK)
    shown = made.dataset().episodes["train"]
    known = train_state.samples(shown, columns, np.eye(4), 8)
    rng = np.random.default_rng(2)
    rows = rng.permutation(len(known.inputs))
    push = 0.005 * rng.standard_normal((len(rows), 3))
    left = np.exp(-np.arange(1, 9) / 5.0)
    x, y = known.pushed(rows, push, left)
    x_0, y_0 = known.inputs[rows], known.targets[rows]
    free = known.free[rows]
    assert 0.2 < free.mean() < 0.9
    # Where the tip is told to be, in the rcm frame: the way back, to the place it was to be at.
    aside = (y[:, :, :3] + push[:, None]) - y_0[:, :, :3]
    np.testing.assert_allclose(aside[free], (push[:, None] * left[:, None])[free], atol=1e-15)
    here = x[:, observed_features.HERE] - x_0[:, observed_features.HERE]
    np.testing.assert_allclose(here[free], push[free], atol=1e-15)
    first = x[:, :3] + x[:, observed_features.HERE]
    np.testing.assert_allclose(first, x_0[:, :3] + x_0[:, observed_features.HERE], atol=1e-15)
    np.testing.assert_array_equal(x[~free], x_0[~free])
    np.testing.assert_array_equal(y[~free], y_0[~free])
    far = (np.linalg.norm(push, axis=1)[:, None] * left > action_head.THERE) & free[:, None]
    assert (y[:, :, 4] >= known.jaw[rows][:, None] - 1e-12)[far].all()
    np.testing.assert_array_equal(y[:, :, 4][~far], y_0[:, :, 4][~far])
    print(f"{free.sum()} of {len(free)} samples are free")


def test_it_learns_what_is_there_to_learn() -> None:
    before = train_state.train(made.dataset(12), action_head.HandOptions(steps=1, hidden=(64, 64)))
    after = train_state.train(made.dataset(12), action_head.HandOptions(steps=400, hidden=(64, 64)))
    print(f"loss on val {before.about['loss']['val']:.3f} -> {after.about['loss']['val']:.3f}")
    assert after.about["loss"]["val"] < 0.5 * before.about["loss"]["val"]


def test_acting_step_by_step_is_what_was_trained(policy: state_policy.Policy) -> None:
    """Memory included: chunks from observations one by one are those of the whole episode."""
    shown = made.episode(99)
    columns = observed_features.Columns(made.STATE, made.TASK)
    # What was said last is what it said itself: the whole episode, with that.
    said = []
    for _ in range(2):  # the second time after a reset
        policy.reset("", None)
        last = shown.state[0, arm_columns.SET]
        said.clear()
        for step in range(len(shown.state)):
            if np.linalg.norm(last[:3] - shown.state[step, 5:8]) > chunk_policy.REACH:
                last = shown.state[step, arm_columns.SET]
            said.append(last)
            observation = {
                arm_columns.STATE: shown.state[step],
                arm_columns.TASK: shown.task[step],
            }
            chunk = policy.act(observation)
            assert chunk.shape == (8, 5) and chunk.dtype == np.float64
            inputs = observed_features.features(
                columns,
                shown.state[: step + 1],
                shown.task[: step + 1],
                np.array(said),
                policy.scales["X_RW"],
            )
            whole = policy.predict(inputs, np.array(said))
            # One row and many are summed in another order by the BLAS: float32.
            np.testing.assert_allclose(chunk, whole[-1], atol=1e-5)
            last = chunk[0, :4]


def test_numpy_alone_gives_what_the_trainer_had(
    policy: state_policy.Policy, tmp_path: Path
) -> None:
    """Saved, loaded, and run by a plain interpreter that has numpy and nothing of ours."""
    file = tmp_path / "weights.npz"
    policy.save(file)
    shown = made.episode(5)
    last = lerobot_dataset.last_commands(shown.state, shown.action, arm_columns.SET)
    np.savez(tmp_path / "episode.npz", state=shown.state, task=shown.task, last=last)
    program = (
        "import sys, numpy as np\n"
        "from surg_learn.bgr import state_policy as b\n"
        f"p = b.Policy.load(__import__('pathlib').Path({str(file)!r}))\n"
        f"e = np.load({str(tmp_path / 'episode.npz')!r})\n"
        "c = b.Columns(p.names[b.STATE], p.names[b.TASK])\n"
        "x = b.features(c, e['state'], e['task'], e['last'], p.scales['X_RW'])\n"
        f"np.save({str(tmp_path / 'out.npy')!r}, p.predict(x, e['last']))\n"
        "assert not {'torch', 'surg_core', 'surg_sim', 'pyarrow'} & set(sys.modules)\n"
        "print(p.hash)"
    )
    assert said_alone(program) == policy.hash
    columns = observed_features.Columns(made.STATE, made.TASK)
    inputs = observed_features.features(
        columns, shown.state, shown.task, last, policy.scales["X_RW"]
    )
    np.testing.assert_allclose(
        np.load(tmp_path / "out.npy"), policy.predict(inputs, last), rtol=0, atol=1e-6
    )


def test_weights_hold_no_code(policy: state_policy.Policy, tmp_path: Path) -> None:
    file = tmp_path / "weights.npz"
    policy.save(file)
    with zipfile.ZipFile(file) as archive:
        for name in archive.namelist():
            with archive.open(name) as member:
                np.lib.format.read_magic(member)
                _, _, dtype = np.lib.format.read_array_header_1_0(member)
                assert dtype.hasobject is False, name
    again = state_policy.Policy.load(file)
    assert again.hash == policy.hash and again.about["privileged"] == [arm_columns.TASK]
    assert again.about == json.loads(json.dumps(policy.about))


def test_other_files_are_refused(policy: state_policy.Policy, tmp_path: Path) -> None:
    text, foreign, pickled = (tmp_path / name for name in ("a.txt", "b.npz", "c.npz"))
    text.write_text("no weights")
    np.savez(foreign, a=np.zeros(3))
    np.savez(pickled, head=np.array([{}], dtype=object))
    for file in (text, foreign, pickled):
        with pytest.raises(ValueError, match=file.name):
            state_policy.Policy.load(file)


def test_the_place_of_a_number_is_found_by_its_name(policy: state_policy.Policy) -> None:
    """Another order of the same numbers is the same observation; a missing one is named."""
    rng = np.random.default_rng(1)
    order = rng.permutation(len(made.TASK))
    shown = made.episode(7)
    last = lerobot_dataset.last_commands(shown.state, shown.action, arm_columns.SET)
    columns = observed_features.Columns(made.STATE, made.TASK)
    shuffled = observed_features.Columns(made.STATE, [made.TASK[i] for i in order])
    np.testing.assert_array_equal(
        observed_features.features(columns, shown.state, shown.task, last, policy.scales["X_RW"]),
        observed_features.features(
            shuffled, shown.state, shown.task[:, order], last, policy.scales["X_RW"]
        ),
    )
    with pytest.raises(ValueError, match="assistant_held"):
        observed_features.Columns(
            made.STATE, [name for name in made.TASK if name != "assistant_held"]
        )


def test_the_frame_is_found_from_the_tip_in_both() -> None:
    rng = np.random.default_rng(8)
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    R *= np.linalg.det(R)
    p_W = rng.standard_normal((50, 3))
    p_R = p_W @ R.T + [0.1, -0.2, 0.3]
    found = observed_features.world_in_rcm(p_R, p_W)
    np.testing.assert_allclose(found[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], [0.1, -0.2, 0.3], atol=1e-12)


def test_nothing_to_train_on_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nothing = made.dataset(0, 1)
    with pytest.raises(ValueError, match="train"):
        train_state.train(nothing, FEW)
    assert train_state.main([str(tmp_path), "--out", str(tmp_path / "w.npz")]) == 2
    assert "no LeRobot dataset" in capsys.readouterr().err
    assert not (tmp_path / "w.npz").exists()
