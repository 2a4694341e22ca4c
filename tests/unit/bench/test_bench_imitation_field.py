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
from policy import entrants, sights

from surg_recording.job_pool import Executor


def cloned(file: Path, method: str, seed: int, eyes: int = 1, play: int = 8) -> Path:
    """Weights that were trained for a step."""
    sizes = {"width": 8, "model": 16, "heads": 2, "feed": 16, "layers": 1, "hidden": 8}
    options = bgr_cloned.train_cloned.Options(
        method=method, steps=1, batch=2, seed=seed, eyes=eyes, play=play, device="cpu", sizes=sizes
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
    views = bench_imitation.views_of(smudge, (LEFT, RIGHT))
    assert views == {LEFT: "left", RIGHT: "right"}
    seen: list[dict[str, Any]] = []
    policy = type("P", (), {"acknowledged": None, "act": lambda self, shown: seen.append(shown)})()
    eyes = bench_imitation.eyes_of(None, smudge, 3, views)
    bright, dark = (np.full((48, 64, 3), level, np.uint8) for level in (200, 20))
    bench_imitation.Through(policy, eyes).act({LEFT: bright, RIGHT: dark, "other": 1})
    hidden = [
        (np.abs(seen[0][key].astype(int) - shown) > 30).any(axis=2)
        for key, shown in ((LEFT, bright), (RIGHT, dark))
    ]
    assert seen[0]["other"] == 1 and hidden[0].any() and not hidden[0].all()
    assert (hidden[0] == hidden[1]).mean() > 0.95, "the same place is hidden, but for its fringe"


def result(name: str, seed: int, success: bool) -> bench_imitation.Result:
    return bench_imitation.Result(name, seed, success, "slipped", "", 2, 1e-5, [3.0, 4.0])


def test_each_policy_has_a_row_and_each_method_their_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was played is in the books; the two bc solve 3 and 1 of 4, act 2 of 4."""
    files = [cloned(tmp_path / f"{m}{s}.npz", m, s) for m, s in (("bc", 0), ("bc", 1), ("act", 0))]
    played: list[bench_imitation.Job] = []
    solved = {"bc0": 3, "bc1": 1, "act0": 2}

    def run(jobs: list[bench_imitation.Job], books: Any, place: Executor, play: Any) -> None:
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
    assert said["format"] == "surg_bench_imitation/3" and said["seeds"] == [20000, 20004]
    rates = {e["file"]: e["conditions"][0] for e in said["policies"]}
    assert {file: (rate["k"], rate["n"]) for file, rate in rates.items()} == {
        "bc0.npz": (3, 4), "bc1.npz": (1, 4), "act0.npz": (2, 4),
    }  # fmt: skip
    bc, act = said["methods"]
    assert (bc["method"], bc["files"]) == ("bc", ["bc0.npz", "bc1.npz"])
    assert bc["conditions"][0]["k"] == 4
    # Wilson's interval for 4 of 8, 95 %.
    assert bc["conditions"][0]["low"] == pytest.approx(0.2152, abs=1e-4)
    assert bc["conditions"][0]["high"] == pytest.approx(0.7848, abs=1e-4)
    assert act["conditions"][0]["n"] == 4
    shown = capsys.readouterr().out
    assert "bc, all 2" in shown and "act, all" not in shown
    assert bench_imitation.main() == 0 and len(played) == 12, "nothing is played twice"


def test_seeds_of_one_recipe_are_one_method_and_other_options_are_another(tmp_path: Path) -> None:
    found = bench_imitation.entered([
        cloned(tmp_path / "a.npz", "bc", 0),
        cloned(tmp_path / "b.npz", "bc", 1),
        cloned(tmp_path / "c.npz", "bc", 1, play=4),
    ])  # fmt: skip
    books = {one.weights: bench_imitation.Book(tmp_path / "kept", one.digest) for one in found}
    for book in books.values():
        book.add(result("as trained", 1, True))
    pools = bench_imitation.pooled(found, books, ["as trained"], range(1, 2))
    assert [each["files"] for each in pools] == [["a.npz", "b.npz"], ["c.npz"]]
    assert bench_imitation.labels(found) == ["bc, seed 0", "bc, seed 1, b.npz", "bc, seed 1, c.npz"]


def test_kept_results_are_those_of_the_same_programs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what was cut off in the last line is played again; any other line is an error."""
    book = bench_imitation.Book(tmp_path, "a")
    for seed in (1, 2):
        book.add(result("black", seed, False))
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:-9], "utf-8")
    again = bench_imitation.Book(tmp_path, "a")
    assert set(again.found) == {("black", 1)}
    again.add(result("black", 2, True))
    assert len(bench_imitation.Book(tmp_path, "a").found) == 2
    monkeypatch.setattr(bench_imitation, "programs", lambda: "changed")
    assert not bench_imitation.Book(tmp_path, "a").found
    monkeypatch.undo()
    file.write_text('{"condition": "black"}\n' + file.read_text(), "utf-8")
    with pytest.raises(ValueError, match=r"jsonl:1: no roll-out"):
        bench_imitation.Book(tmp_path, "a")


def test_a_changed_controller_plays_anew_and_a_changed_trainer_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert all(any(paths.ROOT.glob(pattern)) for pattern in bench_imitation.PLAYED)
    monkeypatch.setattr(paths, "ROOT", tmp_path)

    def after(change: str) -> str:
        file = tmp_path / change
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("changed", "utf-8")
        bench_imitation.programs.cache_clear()
        return bench_imitation.programs()

    try:
        before = after("src/surg_learn/src/surg_learn/bgr/training/picture_augmentation.py")
        assert after("src/surg_learn/src/surg_learn/bgr/train_cloned.py") == before
        programs = {before}
        for change in (
            "benchmarks/policy/sights.py",
            "cells/sim_two_arms/cell.yaml",
            "src/surg_learn/src/surg_learn/bgr/cloned_networks.py",
            "src/surg_core/src/law/rcm.cpp",
            "src/surg_policy_bridge/client/src/surg_policy_client/wire.py",
            "src/surg_description/robots/ur5e.yaml",
            "src/surg_sim/src/surg_sim/physics/assets/bowel.xml",
        ):
            programs.add(after(change))
        assert len(programs) == 8
    finally:
        monkeypatch.undo()
        bench_imitation.programs.cache_clear()


def test_the_time_of_an_answer_is_that_of_answers(tmp_path: Path) -> None:
    """A policy that plays steps of before says None, or the rest of them again."""
    chunk = np.zeros((8, 5))
    answers = iter([chunk, None, chunk[4:], chunk.copy()])
    policy = type("P", (), {"acknowledged": None, "act": lambda self, shown: next(answers)})()
    through = bench_imitation.Through(policy, {})
    for _ in range(4):
        through.act({})
    assert len(through.spent) == 2


def test_another_episode_has_another_place() -> None:
    """Which the judge does not take for this one's."""
    places = {3: 18, 503: 19, 504: 17, 505: 21}
    task = type("T", (), {"target": 0})()

    class Env:
        session = type("S", (), {"task": task})()

        def reset(self, seed: int) -> None:
            task.target = places[seed]

    assert bench_imitation.another(Env(), 3) == 505


def test_a_cloned_policy_plays_in_the_phantom(tmp_path: Path) -> None:
    """Two eyes, rendered, for 1 s: it has learned nothing, and nothing is unsafe."""
    file = cloned(tmp_path / "w.npz", "moe_act", 0, eyes=2)
    from surg_sim.tasks.bgr.bgr_task import Bgr

    limit, Bgr.time_limit = Bgr.time_limit, 1.0
    try:
        done = bench_imitation.judge(("light 60 %", 20000, file))
    finally:
        Bgr.time_limit = limit
    assert not done.success and "time" in done.reason
    assert done.rcm_max < 1e-4 and entrants.policy_of(file).method == "moe_act"
