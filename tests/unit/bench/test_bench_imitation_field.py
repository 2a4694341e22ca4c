"""Several policies in `./surg dev bench imitation`: each file names its kind; rows, errors."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.policy import bgr_cloned
from helpers.policy import bgr_pictures as made
from helpers.policy.bgr_cloned import LEFT, RIGHT
from surg_cli.host import paths

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import bench_imitation
from policy import entrants, judge, sights

from surg_recording.job_pool import Executor


def cloned(file: Path, method: str, seed: int, eyes: int = 1) -> Path:
    """Weights that were trained for a step."""
    sizes = {"width": 8, "model": 16, "heads": 2, "feed": 16, "layers": 1, "hidden": 8}
    options = bgr_cloned.train_cloned.Options(
        method=method, steps=1, batch=2, seed=seed, eyes=eyes, play=8, device="cpu", sizes=sizes
    )
    found = bgr_cloned.recorded(1, 0, eyes)
    bgr_cloned.train_cloned.train(found, options).save(file)
    return file


def shipped(file: Path) -> Path:
    """Weights of the image policy; its hand learned little, its eye nothing."""
    options = made.train_images.Options(steps=2, hidden=(8, 8), batch=4, chunk=4, seed=5)
    dataset = made.dataset(2)
    columns = made.image_policy.STATE, made.train_images.TASK
    marked = made.train_images.marks(
        dataset, made.train_images.Columns(*(dataset.names[key] for key in columns))
    )
    made.train_images.train_hand(dataset, options, made.eye(), marked).save(file)
    return file


def test_a_file_of_weights_names_its_kind(tmp_path: Path) -> None:
    files = [
        shipped(tmp_path / "a.npz"),
        cloned(tmp_path / "b.npz", "bc", 1),
        cloned(tmp_path / "c.npz", "moe_act", 2, eyes=2),
    ]
    found = bench_imitation.entered(files)
    assert [one.label for one in found] == ["shipped, seed 5", "bc, seed 1", "moe_act, seed 2"]
    assert [one.pictures for one in found] == [(LEFT,), (LEFT,), (LEFT, RIGHT)]
    with pytest.raises(ValueError, match=r"b\.npz holds the weights of .*b\.npz"):
        bench_imitation.entered([*files, tmp_path / "b.npz"])


@pytest.mark.parametrize("kind", ["cloned", "shipped"])
def test_weights_of_another_action_space_end_before_anything_is_played(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = cloned(tmp_path / "good.npz", "bc", 0)
    other = shipped(tmp_path / "w.npz") if kind == "shipped" else good
    with np.load(other) as found:
        arrays = dict(found)
    head = json.loads(arrays["head"].tobytes())
    head["names"]["action"] = ["PSM1/dx", "PSM1/dy", "PSM1/dz", "PSM1/droll", "PSM1/jaw"]
    arrays["head"] = np.frombuffer(json.dumps(head).encode(), np.uint8)
    np.savez(tmp_path / "bad.npz", **arrays)
    argv = ["bench", "--weights", str(good), str(tmp_path / "bad.npz"), "--keep"]
    monkeypatch.setattr(sys, "argv", [*argv, str(tmp_path / "k")])
    with pytest.raises(SystemExit, match=r"bad\.npz.*PSM1/dx.*allowed: PSM1/x"):
        bench_imitation.main()
    assert not (tmp_path / "k").exists()


def test_two_eyes_see_their_own_pictures_through_the_same_dirt() -> None:
    smudge = next(each for each in sights.CONDITIONS if each.name == "a smudge on the lens")
    views = judge.views_of(smudge, (LEFT, RIGHT))
    assert views == {LEFT: "left", RIGHT: "right"}
    seen: list[dict[str, Any]] = []
    policy = type("P", (), {"acknowledged": None, "act": lambda self, shown: seen.append(shown)})()
    eyes = judge.eyes_of(None, smudge, 3, views)
    bright, dark = (np.full((48, 64, 3), level, np.uint8) for level in (200, 20))
    judge.Through(policy, eyes).act({LEFT: bright, RIGHT: dark, "other": 1})
    hidden = [
        (np.abs(seen[0][key].astype(int) - shown) > 30).any(axis=2)
        for key, shown in ((LEFT, bright), (RIGHT, dark))
    ]
    assert seen[0]["other"] == 1 and hidden[0].any() and not hidden[0].all()
    assert (hidden[0] == hidden[1]).mean() > 0.95, "the same place is hidden, but for its fringe"


def result(name: str, seed: int, success: bool) -> judge.Result:
    return judge.Result(name, seed, success, "slipped", 2, 1e-5)


def test_each_policy_has_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was played is in the books; the two bc solve 3 and 1 of 4, act 2 of 4."""
    files = [cloned(tmp_path / f"{m}{s}.npz", m, s) for m, s in (("bc", 0), ("bc", 1), ("act", 0))]
    played: list[judge.Job] = []
    solved = {"bc0": 3, "bc1": 1, "act0": 2}

    def run(jobs: list[judge.Job], books: Any, place: Executor, play: Any) -> None:
        for name, seed, file in jobs:
            played.append((name, seed, file))
            books[file].add(result(name, seed, seed - 20000 < solved[file.stem]))

    monkeypatch.setattr(bench_imitation, "run", run)
    out = tmp_path / "out.json"
    argv = ["bench", "--weights", *map(str, files), "--keep", str(tmp_path / "kept")]
    argv += ["--rollouts", "4", "--only", "as trained", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", argv)
    assert bench_imitation.main() == 0
    assert len(played) == 12 and [seed for _, seed, _ in played[:3]] == [20000] * 3
    said = json.loads(out.read_text())
    assert said["format"] == "surg_bench_imitation/4" and said["seeds"] == [20000, 20004]
    rates = {e["file"]: e["conditions"][0] for e in said["policies"]}
    assert {file: (rate["k"], rate["n"]) for file, rate in rates.items()} == {
        "bc0.npz": (3, 4), "bc1.npz": (1, 4), "act0.npz": (2, 4),
    }  # fmt: skip
    # Wilson's interval for 2 of 4, 95 %.
    assert rates["act0.npz"]["low"] == pytest.approx(0.1500, abs=1e-4)
    assert rates["act0.npz"]["high"] == pytest.approx(0.8500, abs=1e-4)
    assert "bc, seed 1" in capsys.readouterr().out
    assert bench_imitation.main() == 0 and len(played) == 12, "nothing is played twice"


def test_results_are_kept(tmp_path: Path) -> None:
    """What was cut off in the last line is played again; any other line is an error."""
    book = bench_imitation.Book(tmp_path, "a")
    for seed in (1, 2):
        book.add(result("black", seed, False))
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:-9], "utf-8")
    again = bench_imitation.Book(tmp_path, "a")
    assert set(again.found) == {("black", 1)}
    again.add(result("black", 2, True))
    assert len(bench_imitation.Book(tmp_path, "a").found) == 2
    assert not bench_imitation.Book(tmp_path, "b").found, "other weights"
    file.write_text('{"condition": "black"}\n' + file.read_text(), "utf-8")
    with pytest.raises(ValueError, match=r"jsonl:1: no roll-out"):
        bench_imitation.Book(tmp_path, "a")


def test_another_episode_has_another_place() -> None:
    """Which the judge does not take for this one's."""
    places = {3: 18, 503: 19, 504: 17, 505: 21}
    task = type("T", (), {"target": 0})()

    class Env:
        session = type("S", (), {"task": task})()

        def reset(self, seed: int) -> None:
            task.target = places[seed]

    assert judge.another(Env(), 3) == 505


@pytest.mark.full
def test_a_cloned_policy_plays_in_the_phantom(tmp_path: Path) -> None:
    """Two eyes, rendered, for 1 s: it has learned nothing, and nothing is unsafe."""
    file = cloned(tmp_path / "w.npz", "moe_act", 0, eyes=2)
    from surg_sim.tasks.bgr.bgr_task import Bgr

    limit, Bgr.time_limit = Bgr.time_limit, 1.0
    try:
        done = judge.judge(("light 60 %", 20000, file))
    finally:
        Bgr.time_limit = limit
    assert not done.success and "time" in done.reason
    assert done.rcm_max < 1e-4 and entrants.policy_of(file).method == "moe_act"
