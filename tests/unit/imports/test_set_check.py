"""`./surg episode check`: each planted fault is found, and nothing on sets without one."""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from helpers.foreign.foreign_sources import Rows, write_set, write_video
from helpers.results.dataset_results import note
from helpers.tree import oracle_venv
from surg_cli.commands.episode import check_set
from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_recording.quality import set_check
from surg_recording.quality.set_rows import WHOLE

VIDEO = "videos/observation.images.cam/episode_{:06d}.mp4"
STATE = "observation.state"
SIZE = (128, 96)
Pictures = list[np.ndarray[Any, Any]]


@dataclasses.dataclass
class Made:
    """A set before it is written: rows and pictures of each episode, each of which can be wrong."""

    rows: list[Rows]
    pictures: list[Pictures]
    info: dict[str, Any] = dataclasses.field(default_factory=dict)

    def write(self, root: Path) -> Path:
        """The set as LeRobot 2.1 has it."""
        write_set(root, self.rows, camera="video", **self.info)
        for number, pictures in enumerate(self.pictures):
            write_video(root / VIDEO.format(number), pictures, self.rows[number].fps)
        return root


def wandering(rng: np.random.Generator, times: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """(T, 5) from place to place along fifth-order polynomials, with rests between."""
    at, place = 0.0, rng.uniform(-1, 1, 5)
    made = np.tile(place, (len(times), 1))
    while at < times[-1]:
        takes, goal = rng.uniform(0.4, 1.2), rng.uniform(-1, 1, 5)
        s = np.clip((times - at) / takes, 0, 1)[:, None]
        made += (goal - place) * s**3 * (10 - 15 * s + 6 * s**2)
        at, place = at + takes + rng.uniform(0.0, 0.6), goal
    return made + 0.002 * np.sin(3 * times[:, None] + np.arange(5))


def seen(
    rng: np.random.Generator, state: np.ndarray[Any, Any], background: np.ndarray[Any, Any]
) -> Pictures:
    """A bright tool on a rough background, where all joints together put it."""
    tip = (state / np.ptp(state, axis=0)) @ rng.uniform(0.5, 1.0, (state.shape[1], 2))
    share = (tip - tip.min(axis=0)) / np.ptp(tip, axis=0)
    made = []
    for x, y in share * (SIZE[0] - 40, SIZE[1] - 40):
        image = background + rng.normal(0, 1, (*background.shape[:2], 1))
        image[int(y) : int(y) + 36, int(x) : int(x) + 36] = 220
        made.append(np.clip(image, 0, 255).astype(np.uint8))
    return made


def draw(seed: int, episodes: int = 3, count: int = 140) -> Made:
    """A set without faults."""
    rng = np.random.default_rng(seed)
    fps = float(rng.choice([10, 20, 25, 30, 29.97, 50]))
    background = rng.uniform(40, 140, (SIZE[1] // 8, SIZE[0] // 8, 3)).repeat(8, 0).repeat(8, 1)
    size = 10.0 ** rng.uniform(-2, 0.5, 5)
    made = Made([], [])
    for _ in range(episodes):
        times = np.arange(count + 2) / fps
        whole = size * wandering(rng, times)
        if seed % 3 == 0:  # a gripper that is open or closed
            whole[:, 4] = np.where(np.sin(times) > 0, 1.0, 0.0)
        if seed % 4 == 0:  # an angle that wraps
            whole[:, 3] = np.remainder(2 * times + np.pi, 2 * np.pi) - np.pi
        rows = Rows(count, fps)
        rows.columns[STATE] = (whole[:-2] + size * rng.normal(0, 1e-5, (count, 5))).tolist()
        rows.columns["action"] = whole[2:].tolist()
        made.rows.append(rows)
        made.pictures.append(seen(rng, whole[:-2], background))
    made.info = {"total_frames": episodes * count, "splits": {"train": "0:2", "val": "2:3"}}
    return made


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_found_in_a_set_without_faults(seed: int, tmp_path: Path, full: bool) -> None:
    if not full and seed:
        pytest.skip("./surg test --full")
    assert set_check.check(draw(seed).write(tmp_path / "set")) == []


def column(name: str, change: Callable[[np.ndarray[Any, Any]], None]) -> Callable[[Made], None]:
    def plant(made: Made) -> None:
        values = np.array(made.rows[1].columns[name])
        change(values)
        made.rows[1].columns[name] = values.tolist()

    return plant


def picture(change: Callable[[Pictures], Pictures]) -> Callable[[Made], None]:
    return lambda made: made.pictures.__setitem__(1, change(made.pictures[1]))


def put(rows: slice | int, value: Any) -> Callable[[np.ndarray[Any, Any]], None]:
    return lambda values: values.__setitem__(rows, value)


def twice(first: int, second: int) -> Callable[[Made], None]:
    def plant(made: Made) -> None:
        made.rows[second], made.pictures[second] = made.rows[first], made.pictures[first]

    return plant


def no_text(made: Made) -> None:
    made.rows[1].columns["task_index"] = [7] * made.rows[1].count


def fewer_rows(made: Made) -> None:
    made.rows[1].columns["frame_index"] = [k + (k > 50) for k in range(made.rows[1].count)]


def shift(values: np.ndarray[Any, Any]) -> None:
    values[70:] += 0.4


def scaled(values: np.ndarray[Any, Any]) -> None:
    values *= 1.25


def jump(values: np.ndarray[Any, Any]) -> None:
    values[60, 0] += 1.5 * np.ptp(values[:, 0])


def step(values: np.ndarray[Any, Any]) -> None:
    values[60:, 1] += 1.2 * np.ptp(values[:, 1])


def freeze(values: np.ndarray[Any, Any]) -> None:
    values[20:110] = values[20]


def beyond(values: np.ndarray[Any, Any]) -> None:
    values[30, 2] = 20 * np.abs(values[:, 2]).max()


FAULTS: dict[str, tuple[str, Callable[[Made], None]]] = {
    "a hole": ("a hole", column("timestamp", shift)),
    "time back": ("time goes back or stands", column("timestamp", put(80, 0.0))),
    "time twice": ("time goes back or stands", column("timestamp", put(slice(80, 83), 1.0))),
    "another rate": ("another rate", column("timestamp", scaled)),
    "missing rows": ("rows are missing", fewer_rows),
    "NaN in the state": ("not a number", column(STATE, put(33, np.nan))),
    "inf in the action": ("not a number", column("action", put(33, np.inf))),
    "a jump and back": ("a jump", column(STATE, jump)),
    "a step": ("a jump", column(STATE, step)),
    "a frozen state": ("the state is frozen", column(STATE, freeze)),
    "an action beyond reach": ("an action beyond reach", column("action", beyond)),
    "no instruction": ("no instruction", no_text),
    "black pictures": (
        "black pictures",
        picture(lambda all_: [*all_[:60], *[0 * p for p in all_[60:80]], *all_[80:]]),
    ),
    "a black camera": ("black pictures", picture(lambda all_: [0 * p for p in all_])),
    "frozen pictures": (
        "pictures are frozen",
        picture(lambda all_: [*all_[:40], *[all_[40]] * 70, *all_[110:]]),
    ),
    "a short video": ("pictures are missing", picture(lambda all_: all_[:100])),
    "late pictures": (
        "pictures and state do not fit",
        picture(lambda all_: [*all_[:1] * 8, *all_[:-8]]),
    ),
    "early pictures": (
        "pictures and state do not fit",
        picture(lambda all_: [*all_[8:], *all_[-1:] * 8]),
    ),
    "a duplicate": ("a duplicate", twice(0, 1)),
    "leakage": ("leakage between splits", twice(0, 2)),
    "counts": ("counts differ", lambda made: made.info.__setitem__("total_frames", 7)),
}


ALWAYS = (
    "a hole",
    "a jump and back",
    "black pictures",
    "frozen pictures",
    "late pictures",
    "leakage",
)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found_where_it_is(fault: str, tmp_path: Path, full: bool) -> None:
    if not full and fault not in ALWAYS:
        pytest.skip("./surg test --full")
    kind, plant = FAULTS[fault]
    made = draw(1, count=300)
    plant(made)
    found = set_check.check(made.write(tmp_path / "set"))
    whose = {"leakage": 2, "counts": WHOLE}.get(fault, 1)
    assert (whose, kind) in {(each.episode, each.kind) for each in found}, found
    assert {each.episode for each in found} <= {whose}


OTHERS = (("lerobot-doctor==0.2.0", "pyyaml"), ("--no-deps", "lerobot-lint==0.1.1"))
CHECKERS = paths.ROOT / "tests/helpers/recording/set_checkers.py"


@pytest.mark.oracle
def test_side_by_side_with_the_checkers_of_others(tmp_path: Path, full: bool) -> None:
    """A fault is found by words that the same set without it does not get."""
    python = oracle_venv.python("set-checkers", OTHERS, ("lerobot_doctor", "lerobot_lint"))
    faults, clean = list(FAULTS if full else ALWAYS), [f"clean {n}" for n in range(20)]
    made = {name: draw(n) for n, name in enumerate(clean)} | {"before": draw(1, count=300)}
    for fault in faults:
        made[fault] = draw(1, count=300)
        FAULTS[fault][1](made[fault])
    for name, each in made.items():
        each.write(tmp_path / "sets" / name)
    argv = [str(python), str(CHECKERS), str(tmp_path / "sets")]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    versions, *said = map(json.loads, done.stdout.splitlines())
    told = {each.pop("set"): each for each in said}
    assert told.keys() == made.keys()
    ours = "`./surg episode check`"
    for name in made:
        kinds = [each.kind for each in set_check.check(tmp_path / "sets" / name)]
        told[name][ours] = {"error": kinds, "warning": []}
    for program in (ours, *versions):
        heard = {name: each[program] for name, each in told.items()}
        words = {name: {*each["error"], *each["warning"]} for name, each in heard.items()}
        missed = [fault for fault in faults if not words[fault] - words["before"]]
        errors, warned = (sum(bool(heard[n][k]) for n in clean) for k in ("error", "warning"))
        found = f"{len(faults) - len(missed)} of {len(faults)} faults found"
        found += f"; of {len(clean)} clean sets {errors} get errors, {warned} warnings"
        print(program, missed)
        note(f"check: {' '.join([program, versions.get(program, '')]).strip()}", len(made), found)
        assert program != ours or (not missed and not errors)


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    check_set.add_arguments(parser, "check")
    return check_set.main(parser.parse_args(words), "check")


def test_the_command_writes_a_page_and_leaves_the_set_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(paths, "RUNS", tmp_path / "runs")
    made = draw(2)
    root = made.write(tmp_path / "good")
    before = {f: hashlib.sha256(f.read_bytes()).digest() for f in root.rglob("*") if f.is_file()}
    assert run(str(root)) == 0
    assert {f: hashlib.sha256(f.read_bytes()).digest() for f in root.rglob("*") if f.is_file()} == (
        before
    )
    column(STATE, put(33, np.nan))(made)
    assert run(str(made.write(tmp_path / "bad"))) == 1
    said = capsys.readouterr()
    assert "episode 1: not a number: observation.state x: 1 rows, first row 33" in said.err
    page = Path(said.out.splitlines()[-1].rpartition("; ")[2])
    assert "not a number" in page.read_text() and "<svg" not in page.read_text()
    stated = json.loads((page.parent / "check.json").read_text())
    assert [each["episode"] for each in stated["findings"]] == [1]
    with pytest.raises(CliError, match="no LeRobot data set") as caught:
        run(str(tmp_path / "nothing"))
    assert caught.value.code == 2


def test_a_file_that_is_broken_is_a_finding_not_the_end(tmp_path: Path) -> None:
    root = draw(1).write(tmp_path / "set")
    (root / VIDEO.format(0)).write_bytes(b"no video")
    (root / "data/chunk-000/episode_000002.parquet").write_bytes(b"no table")
    found = set_check.check(root)
    assert [(each.episode, each.kind) for each in found] == [
        (0, "cannot be read"),
        (2, "cannot be read"),
    ]


def test_pictures_in_the_table_and_in_files_beside_it_are_seen(tmp_path: Path) -> None:
    root = write_set(tmp_path / "set", [Rows(40, 20)], camera="image")
    assert "pictures are missing" not in {each.kind for each in set_check.check(root)}
    (file,) = (root / "data").rglob("*.parquet")
    rows = pq.read_table(file).to_pylist()
    for k, row in enumerate(rows):
        (root / f"{k}.png").write_bytes(row["observation.images.cam"]["bytes"])
        row["observation.images.cam"] = {"bytes": None, "path": f"{k}.png"}
    pq.write_table(pa.Table.from_pylist(rows), file)
    assert "pictures are missing" not in {each.kind for each in set_check.check(root)}
    (root / "7.png").unlink()
    found = {each.kind: each.what for each in set_check.check(root)}
    assert found["pictures are missing"] == "1 of 40 rows have none"
