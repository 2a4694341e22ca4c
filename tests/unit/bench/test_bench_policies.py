"""Policies as `./surg dev bench policies` meets them: shut in, bad ones, cut off and gone on."""

from __future__ import annotations

import argparse
import errno
import functools
import hashlib
import json
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surg_cli.host import paths
from surg_cli.host.terminal import CliError

sys.path.insert(0, str(paths.ROOT / "benchmarks"))

import bench_policies
from policy import card_cell, card_conditions, shut_in
from policy.card_cell import CellJob
from policy.card_conditions import BY_NAME, Eye

from surg_recording.cards import score_card
from surg_recording.job_pool import Executor
from surg_sim.tasks import episode_seeds

TASK, SEEDS = "endoscope_guidance", (20000, 20001)
SCRIPT = """
import os, sys, time
import numpy as np
from surg_policy_client.policies.command_line import run

class Policy:
    wants = ("observation.state",)

    def act(self, observation):
        {body}

{extra}
sys.exit(run(lambda options: Policy(), "a policy"))
"""


_SEEN = card_cell.SeenSession
_compiled = functools.cache(_SEEN)


def _in_the_open(program: shut_in.Program, folder: Path) -> subprocess.Popen[bytes]:
    """Starts a program where the machine gives nobody namespaces, as in some containers."""
    with (folder / "output").open("wb") as output:
        return subprocess.Popen(
            [str(paths.VENV_PYTHON), "-s", str(program.script), "--server",
             f"ipc://{folder / 'socket'}", *program.words],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={"PATH": "/usr/bin:/bin", **shut_in._environment()},
            preexec_fn=shut_in._limit,
        )  # fmt: skip


@pytest.fixture
def play(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Plays a cell of a policy whose ``act`` has this body, in a scene that is compiled once."""
    monkeypatch.setattr(card_cell, "SeenSession", _compiled)
    if shut_in.problem():
        monkeypatch.setattr(shut_in, "start", _in_the_open)

    def played(body: str, extra: str = "", **job: Any) -> dict[str, Any]:
        folder = tmp_path / "policy"
        folder.mkdir(exist_ok=True)
        lines = body.strip().splitlines()
        text = SCRIPT.format(body="\n        ".join(lines), extra=extra)
        (folder / "policy.py").write_text(text, "utf-8")
        program = shut_in.Program.of(str(folder / "policy.py"))
        return card_cell.play(CellJob(program, TASK, "as served", **{"seeds": SEEDS, **job}))

    return played


CHEAT = """
import glob, importlib.util, socket
found = []
try:
    socket.create_connection(("127.0.0.1", {port}), timeout=5)
    found.append("the master's port")
except OSError:
    pass
for name in ("surg_sim", "surg_policy_bridge", "surg_recording"):
    if importlib.util.find_spec(name):
        found.append(name)
for secret in {secrets!r}:
    if os.path.exists(secret):
        found.append(secret)
found += ["shared memory: " + name for name in os.listdir("/dev/shm")]
found += ["environment: " + name for name in os.environ if "SECRET" in name]
for pid in filter(str.isdigit, os.listdir("/proc")):
    words = open("/proc/" + pid + "/cmdline", "rb").read()
    if int(pid) != os.getpid() and words.split(b"\\0")[0] != b"bwrap":
        found.append("process " + pid)
    if b"SECRET" in open("/proc/" + pid + "/environ", "rb").read():
        found.append("environment of " + pid)
told = [observation.stamp_ns, observation.episode, observation.step, observation.instruction]
if any("20000" in str(each) for each in told):
    found.append("the seed")
try:
    open("/usr/here", "w")
    found.append("a file of the system")
except OSError:
    pass
raise RuntimeError("found: " + repr(found))
"""


def test_a_policy_that_tries_finds_nothing(
    play: Callable[..., dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if problem := shut_in.problem():  # then no policy gets a card here
        assert shut_in.INSTALL in problem
        return
    monkeypatch.setenv("SURG_SECRET_SEED", "20000")
    run_folder = tmp_path / "run"
    run_folder.mkdir()
    shared = Path("/dev/shm/surg_card_secret")
    shared.write_text("20000")
    secrets = [str(run_folder), str(paths.ROOT / "src/surg_sim"), str(paths.ROOT / "runs")]
    try:
        with socket.socket() as master:
            master.bind(("127.0.0.1", 0))
            master.listen()
            port = master.getsockname()[1]
            cell = play(CHEAT.format(port=port, secrets=secrets))
    finally:
        shared.unlink()
    assert cell["episodes"][0]["reason"].endswith("found: []; no policy is connected")
    assert [each["key"] for each in cell["served"]] == ["observation.state"]


@pytest.mark.parametrize(
    ("body", "extra", "job", "said"),
    [
        ("return np.full(5, np.nan)", "", {}, "BadAction"),
        ("os._exit(3)", "", {}, r"its program ended \(3\)"),
        ("", "sys.exit()", {}, r"its program ended \(0\): it printed nothing; \./surg policy new"),
        ("os.kill(os.getpid(), 9)", "", {}, "its program ended|was killed by signal 9"),
        ("time.sleep(600)", "", {"answer_s": 2.0}, "no answer to an observation within 2 s"),
        ("", "Policy.wants = ('observation.touch',)", {}, "refused: observation observation.touch"),
        (
            "",
            "from surg_policy_client import Spec\nPolicy.wants = Spec(period_s=0.1)",
            {},
            "refused: period_s: the policy wants 0.1, the server has 0.05",
        ),
        ("", "open('/tmp/full', 'wb').write(bytes(200 << 20))", {}, "File size limit|ended|signal"),
    ],
    ids=[
        "NaN",
        "dies",
        "serves nobody",
        "killed",
        "never answers",
        "unknown key",
        "another rate",
        "fills the disk",
    ],
)
def test_a_bad_policy_fails_its_cell_with_a_reason(
    play: Callable[..., dict[str, Any]], body: str, extra: str, job: Any, said: str
) -> None:
    episodes = play(body or "return None", extra, **job)["episodes"]
    assert [each["seed"] for each in episodes] == list(SEEDS)
    for each in episodes:
        assert not each["success"] and re.search(said, each["reason"]), each["reason"]
    cell = score_card.cell(TASK, "as served", False, {"served": [], "episodes": episodes})
    assert (cell["k"], cell["n"]) == (0, 2)


def test_a_delay_of_answers_is_late_for_rows_of_one_step(
    play: Callable[..., dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(card_cell, "BY_NAME", {"as served": BY_NAME["answers 100 ms late"]})
    late = play("return observation.held_action()", seeds=(20000,))["episodes"][0]
    assert late["late"] > 0 and late["accepted"] <= 1
    assert "no action" in late["reason"]
    body = "if observation.step > 60: raise RuntimeError('enough')\n"
    body += "return np.tile(observation.held_action(), (8, 1))"
    rows = play(body, seeds=(20000,))["episodes"][0]
    assert rows["accepted"] > 40 and "enough" in rows["reason"]


def test_blind_controls_show_nothing_of_the_scene() -> None:
    rng = np.random.default_rng(0)
    key = f"{card_conditions.IMAGES}endoscope_left"
    seen = [
        {key: rng.integers(1, 255, (4, 6, 3), np.uint8), "observation.state": rng.random(9)}
        for _ in range(2)
    ]
    zeroed = Eye(BY_NAME["zeroed observations"], 0, {})(seen[0])
    assert not any(array.any() for array in zeroed.values())
    for name in ("black pictures", "frozen pictures"):
        eye = Eye(BY_NAME[name], 0, {})
        first, second = eye(seen[0]), eye(seen[1])
        np.testing.assert_array_equal(first[key], second[key])
        np.testing.assert_array_equal(second["observation.state"], seen[1]["observation.state"])
    others = {key: [each[key] for each in seen[::-1]]}
    foreign = Eye(BY_NAME["another episode's pictures"], 0, others)
    for n in (1, 0, 0):  # the last one stays
        np.testing.assert_array_equal(foreign(seen[0])[key], seen[n][key])


def test_pictures_of_another_episode_and_settings_are_served(
    play: Callable[..., dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a policy that says what it sees: the brightness of each picture, as its reason to end."""
    body = "if observation.step > 20: raise RuntimeError(str(self.seen))"
    body += "\nself.seen = getattr(self, 'seen', []) + [float(observation[KEY].mean())]"
    body += "\nreturn observation.held_action()"
    extra = "KEY = 'observation.images.endoscope.left'\nPolicy.wants = ('observation.state', KEY)"
    said = {}
    for name in ("as served", "another episode's pictures", "setting in_vivo"):
        monkeypatch.setattr(card_cell, "BY_NAME", {"as served": BY_NAME[name]})
        monkeypatch.setattr(card_cell, "SeenSession", _SEEN)
        said[name] = play(body, extra, seeds=(20000,))["episodes"][0]
    reasons = {re.search(r"\[.*\]", each["reason"]).group() for each in said.values()}
    assert len(reasons) == 3, reasons
    hashes = {name: each["state_hash"] for name, each in said.items()}
    assert hashes["as served"] == hashes["another episode's pictures"] != hashes["setting in_vivo"]


def test_executors_by_name() -> None:
    assert bench_policies.executor_of("processes") == Executor()
    assert bench_policies.executor_of("dask") == Executor("dask")
    found = bench_policies.executor_of("dask:tcp://10.0.0.1:8786")
    assert found == Executor("dask", scheduler="tcp://10.0.0.1:8786")
    with pytest.raises(argparse.ArgumentTypeError, match=r"are processes and dask\[:ADDRESS\]"):
        bench_policies.executor_of("threads")


def unplayed(job: CellJob) -> dict[str, Any]:
    """A cell of a policy whose episodes fail for the text of its program."""
    reason = job.policy.script.read_text("utf-8")
    episodes = [card_cell.not_played(seed, reason) for seed in job.seeds]
    for each in episodes:
        each.pop("lost")
    served = [{"key": f"{card_conditions.IMAGES}endoscope_left", "privileged": False}]
    return {"served": served, "episodes": episodes, "latency_s": None}


def in_process(monkeypatch: pytest.MonkeyPatch, cell: Callable[..., Any] = unplayed) -> None:
    """Let cells be played by this function, and no program start."""

    def run(function: Any, jobs: Any, place: Any, ends: Any) -> None:
        for key, job in jobs.items():
            ends.done(key, cell(job))

    monkeypatch.setattr(bench_policies.job_pool, "run", run)
    monkeypatch.setattr(shut_in, "problem", str)


def test_policies_of_one_name_have_their_own_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_process(monkeypatch)
    files = [tmp_path / name / "mine.py" for name in ("first", "second")]
    for file in files:
        file.parent.mkdir()
        file.write_text(file.parent.name, "utf-8")
    words = [*map(str, files), "--keep", str(tmp_path / "kept"), "--only", "bgr, as served"]
    assert bench_policies.main(words) == 0
    cards = [json.loads(f.read_text("utf-8")) for f in tmp_path.glob("kept/*/card.json")]
    assert sorted(f for c in cards for f in c["cells"][0]["failures"]) == ["first", "second"]


def test_a_card_goes_on_where_it_was_cut_off_and_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played: list[tuple[str, str]] = []

    def cell(job: CellJob) -> dict[str, Any]:
        if len(played) == cut:
            raise KeyboardInterrupt
        played.append((job.task, job.condition))
        return unplayed(job)

    in_process(monkeypatch, cell)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    cut = -1
    assert bench_policies.main(["hold", "--keep", str(whole)]) == 0
    once = list(played)
    played.clear()
    cut = 7
    assert bench_policies.main(["hold", "--keep", str(parts)]) == 130
    assert "the same command goes on" in capsys.readouterr().out.splitlines()[-1]
    torn = next(parts.glob("*/cells/*.json"))
    torn.write_text(torn.read_text("utf-8")[:50], "utf-8")
    cut = -1
    assert bench_policies.main(["hold", "--keep", str(parts)]) == 0
    assert sorted(set(played)) == sorted(once) and len(played) == len(once) + 1
    cards = [json.loads(next(f.glob("*/card.json")).read_text("utf-8")) for f in (whole, parts)]
    assert cards[0]["sha256"] == cards[1]["sha256"]
    for card in cards:
        score_card.check("card.json", card)
        assert {c["condition"] for c in card["cells"]} == {c.name for c in card_conditions.QUICK}
        assert len(card["cells"]) == 5 * len(card_conditions.QUICK)


def test_a_phrase_draws_seeds_that_nobody_else_knows() -> None:
    """By SHA-256, so that two machines draw the same: the first of "a phrase" by hand."""
    first = int(hashlib.sha256(b"0 a phrase").hexdigest()[:16], 16) % (2**31 - 2**20) + 2**20
    seeds = list(bench_policies.seeds_of("a phrase", 200))
    assert seeds[0] == first and len(set(seeds)) == 200
    assert list(bench_policies.seeds_of("a phrase", 3)) == seeds[:3]
    assert not {*seeds} & {*bench_policies.seeds_of("A phrase", 200)}
    public = (episode_seeds.TRAINING, episode_seeds.TUNING, episode_seeds.TEST)
    assert not any(seed in each for seed in seeds for each in public)
    assert list(bench_policies.seeds_of(None, 3)) == [20000, 20001, 20002]
    with pytest.raises(ValueError, match="it has no words"):
        bench_policies.seeds_of(" ", 3)


def test_words_that_are_no_policy_are_refused(tmp_path: Path) -> None:
    for given, said in (
        ("no_such", "no_such: no policy; see"),
        ("missing.py", "no such .py file"),
        ("", "no such .py file"),
        ("it's.py", "it's.py: no such .py file"),
        (f"{shut_in.__file__} {paths.ROOT}", "holds the platform too"),
        (f"{tmp_path / 'mine.py'}", "holds --keep too"),
    ):
        (tmp_path / "mine.py").touch()
        with pytest.raises(CliError, match=said):
            bench_policies.entrant(given, tmp_path / "kept")


def test_words_of_a_program_may_look_like_cards_and_addresses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_process(monkeypatch)
    file = tmp_path / "it's a folder" / "mine.py"
    file.parent.mkdir()
    file.write_text("played", "utf-8")
    words = [f'"{file}" --config {tmp_path}/no.json', f'"{file}" --url http://there', str(file)]
    only = ["--keep", str(tmp_path / "kept"), "--only", "bgr, as served"]
    assert bench_policies.main([*words, *only]) == 0
    assert len(list(tmp_path.glob("kept/mine-*/card.json"))) == len(words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--only", "bgrr"), "skeleton: --only leaves no cell; .*bgr.*as served, black pictures"),
        (("--only", "bgr, smoke"), "--only leaves no cell; .*with --full.*smoke"),
        (("--rollouts", "0"), "0 test seeds: 1 to 1000"),
        (("--keep", "/proc/nowhere"), "--keep /proc/nowhere: .*No such file"),
    ],
)
def test_a_card_without_a_cell_is_not_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    said: str,
) -> None:
    in_process(monkeypatch)
    before = ["skeleton", "--keep", str(tmp_path), "--only", "bgr, as served"]
    assert bench_policies.main(before) == 0
    cards = {file: file.read_bytes() for file in tmp_path.glob("*/card.json")}
    assert len(cards) == 1
    assert bench_policies.main([*before, *words]) == 2
    assert re.search(said, capsys.readouterr().out.splitlines()[-1])
    assert all(file.read_bytes() == content for file, content in cards.items())


def test_a_full_disk_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(cards: Any, folder: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    in_process(monkeypatch)
    monkeypatch.setattr(bench_policies.score_card_page, "write", full)
    words = ["skeleton", "--keep", str(tmp_path), "--only", "bgr, as served"]
    assert bench_policies.main(words) == 2
    last = capsys.readouterr().out.splitlines()[-1]
    assert f"--keep {tmp_path}" in last and "No space left" in last


def test_what_a_policy_can_read_makes_it_another(tmp_path: Path) -> None:
    files = ["mine.py", "best.npz", "parts/eye.py"]
    digests = set()
    for name in [*files, "parts/__pycache__/eye.pyc", ".git/index"]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name, "utf-8")
        digests.add(shut_in.Program.of(str(tmp_path / "mine.py")).sha256)
    (tmp_path / "best.npz").write_text("trained for longer", "utf-8")
    digests.add(shut_in.Program.of(str(tmp_path / "mine.py")).sha256)
    assert len(digests) == len(files) + 1
