"""`./surg learn`: checked options, order of the stages, and what a run leaves.

The stages themselves are fakes here: each has tests of its own.
"""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from helpers.graph.surg import parsed
from helpers.recording.rollouts_synthetic import entry, rollout
from surg_cli import without_ros
from surg_cli.commands import learn
from surg_cli.host import provision
from surg_cli.host.terminal import CliError
from surg_cli.learning import rollouts
from surg_learn import learn_stages, recipes
from surg_learn.learn_terminal import LearnError
from surg_recording.reports import learning_report

ROS = {"rospy", "rosgraph", "genpy", "surg_ros", "surg_msgs", "crtk_msgs", "std_msgs"}
TRAINED = {
    "weights": "c0ffee" * 8,
    "words": "chunks of 16",
    "observation": ["observation.state", "privileged.task_state"],
    "privileged": ["privileged.task_state"],
}


options = functools.partial(parsed, "learn")


class FakePlayer:
    """Stands in for the graph."""

    title, robot = "Bowel grasping and retraction", "ur5e"
    played: list[int] = []  # of all players
    folders: list[Path] = []  # of all roll-outs

    made: list[tuple[Any, ...]] = []  # of all
    success = True
    broken: set[int] = set()  # seeds of roll-outs that do not come to their end

    def __init__(self, *arguments: Any) -> None:
        FakePlayer.made.append(arguments)

    def play(self, seed: int, folder: Path, show: Any) -> dict[str, Any]:
        show(1.0, "grasp")
        FakePlayer.played.append(seed)
        FakePlayer.folders.append(folder)
        ended = seed not in FakePlayer.broken
        found = rollout(seed) | {"success": FakePlayer.success and ended, "played": ended}
        return {"rollout": found, "episode": entry(seed)}


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the stages as they are done."""
    found: list[str] = []

    def fake(name: str, result: Any) -> Any:
        def work(*arguments: Any) -> Any:
            found.append(name)
            if isinstance(result, Exception):
                raise result
            return result

        return work

    monkeypatch.setattr(
        learn_stages, "demonstrate", fake("demonstrate", {"success": 8, "failed": {}})
    )
    monkeypatch.setattr(learn_stages, "export", fake("export", {"recordings": 8}))
    monkeypatch.setattr(learn_stages, "train", fake("train", TRAINED))
    monkeypatch.setattr(learn_stages, "measure", fake("measure", [entry(1)]))
    monkeypatch.setattr(rollouts, "Player", FakePlayer)
    monkeypatch.setattr(learning_report, "save_all", lambda *_: [])  # a second of each run
    monkeypatch.setattr(FakePlayer, "success", True)
    FakePlayer.broken.clear()
    FakePlayer.played.clear()
    FakePlayer.folders.clear()
    FakePlayer.made.clear()
    return found


def test_all_stages_once_and_what_is_left(
    tmp_path: Path, done: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    words = ("bgr", "--episodes", "8", "--rollouts", "3", "--out", str(out))
    assert learn.main(options(*words), "learn") == 0
    assert done == ["demonstrate", "measure", "export", "train"]
    assert FakePlayer.played == [20_000, 20_001, 20_002]
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == str(out / "summary.json")
    assert "3 of 3" in said and "privileged.task_state" in said
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["ok"] and summary["unsafe_commands"] == 0
    assert list(summary["stages_s"]) == [
        *("demonstrations", "smoothness", "dataset", "training", "rollouts")
    ]
    assert [e["seed"] for e in summary["rollouts"]] == FakePlayer.played
    # Again: nothing is done. More roll-outs: only these.
    assert learn.main(options(*words), "learn") == 0 and len(FakePlayer.played) == 3
    assert learn.main(options(*words[:3], "--rollouts", "4", *words[5:]), "learn") == 0
    assert len(done) == 4 and len(FakePlayer.played) == 7
    # Another training: the demonstrations are those that are there.
    assert learn.main(options(*words, "--seed", "1"), "learn") == 0
    assert done[4:] == ["train"]


def test_roll_outs_of_another_program_with_the_same_weights_lie_elsewhere(
    tmp_path: Path, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training again gives the same weights; what the older program played is not to be found."""
    words = ("bgr", "--episodes", "8", "--rollouts", "1", "--out", str(tmp_path / "run"))
    for client in ("before", "after", "before"):
        monkeypatch.setattr(recipes.Recipe, "digest", client)
        assert learn.main(options(*words), "learn") == 0
    before, after, again = FakePlayer.folders
    assert before == again != after


@pytest.mark.parametrize(("played", "least"), [(1, 1), (3, 3), (20, 17), (50, 43), (1000, 850)])
def test_at_least_the_share_that_was_said_succeeds(played: int, least: int) -> None:
    assert recipes.recipe_of("bgr", recipes.STATE).least(played) == least
    assert recipes.recipe_of("bgr", "moe_act").least(played) == 0


def test_a_roll_out_that_did_not_come_to_its_end_is_played_again(
    tmp_path: Path, done: list[str]
) -> None:
    out = tmp_path / "run"
    words = ("bgr", "--episodes", "8", "--rollouts", "3", "--out", str(out))
    FakePlayer.broken.add(20_001)
    assert learn.main(options(*words), "learn") == 1
    assert not json.loads((out / "summary.json").read_text("utf-8"))["ok"]
    FakePlayer.broken.clear()
    assert learn.main(options(*words), "learn") == 0
    assert FakePlayer.played == [20_000, 20_001, 20_002] * 2
    assert learn.main(options(*words), "learn") == 0 and len(FakePlayer.played) == 6


def test_what_is_kept_of_a_roll_out_came_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The player asks what is there: a node that died is no result."""
    monkeypatch.setenv(rollouts.WEIGHTS, "")  # set by the player
    plan = SimpleNamespace(run_info={"title": "t", "robot": "ur5e"}, seed=20_000)
    monkeypatch.setattr(rollouts.policy_program, "read", lambda *_: None)
    monkeypatch.setattr(rollouts.episode_plans, "make_plan", lambda *_: plan)
    monkeypatch.setattr(rollouts.episode_plans, "for_episode", lambda *_: plan)
    monkeypatch.setattr(rollouts.episode_process, "run_episode", lambda *_: None)
    ends = iter((False, True))
    tried: list[bool] = []

    def describe(plan: Any, ended: Any) -> dict[str, Any]:
        tried.append(next(ends))
        return {"rollout": rollout(plan.seed) | {"played": tried[-1]}, "episode": entry(plan.seed)}

    monkeypatch.setattr(rollouts, "describe", describe)
    player = rollouts.Player("bgr", Path(), None, "phantom", Path("p.py"), Path("w.npz"), False)
    for _ in range(3):
        last = player.play(20_000, tmp_path / "20000", lambda *_: None)
    assert tried == [False, True] and last["rollout"]["played"]


def test_a_stage_that_breaks_is_named_with_the_line_to_go_on(
    tmp_path: Path, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(*arguments: Any) -> Any:
        raise LearnError("out of memory")

    good = learn_stages.train
    monkeypatch.setattr(learn_stages, "train", no_memory)
    out = tmp_path / "run"
    words = ("bgr", "--episodes", "8", "--rollouts", "3", "--out", str(out))
    with pytest.raises(CliError) as said:
        learn.main(options(*words), "learn")
    text = str(said.value)
    assert "stage 'training'" in text and "out of memory" in text
    line = "--setting phantom --robot sim_two_arms --seed 0 --episodes 8 --rollouts 3"
    assert f"./surg learn bgr {line} --out {out}" in text
    monkeypatch.setattr(learn_stages, "train", good)
    assert learn.main(options(*words), "learn") == 0
    assert done == ["demonstrate", "measure", "export", "train"]


@pytest.mark.parametrize(
    ("method", "trainer", "client"),
    [
        ("moe_act", "cloning.train_cloned", "cloned_policy"),
        ("keypoints", "bgr.train_images", "image_policy"),
    ],
)
def test_cameras_make_a_policy_that_looks(
    method: str,
    trainer: str,
    client: str,
    tmp_path: Path,
    done: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Other programs, pictures at both ends, no truth; its figure is said, whatever it is."""
    seen = TRAINED | {"observation": ["observation.state", "pictures"], "privileged": []}
    trainers: list[str] = []
    installed: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        provision, "install_packages", lambda log, optional: installed.append(optional)
    )
    monkeypatch.setattr(
        learn_stages, "train", lambda request, *_: trainers.append(request.recipe.train) or seen
    )
    monkeypatch.setattr(FakePlayer, "success", False)
    out = tmp_path / "run"
    words = ("--cameras", method, "--episodes", "8", "--rollouts", "2", "--out", str(out))
    assert learn.main(options("bgr", *words), "learn") == 0
    (player,) = FakePlayer.made
    assert [player[4].name, *player[6:]] == [f"{client}.py", False, ("left",), False]
    assert trainers == [f"surg_learn.{trainer}"] and installed == [("torch",)]
    assert recipes.Request("bgr", "phantom", "ur5e", 0, 8, 2, method).demonstrations["cameras"]
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    assert summary["ok"] and summary["privileged"] == []
    # The folder of a run that looks is no folder of one that does not.
    with pytest.raises(CliError, match="--cameras True"):
        learn.main(options("bgr", *words[2:]), "learn")


def test_a_file_of_looks_may_move_but_not_change(
    tmp_path: Path, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that was copied elsewhere with its file goes on there."""
    monkeypatch.setattr(provision, "install_packages", lambda log, optional: None)
    first, moved = tmp_path / "looks.yaml", tmp_path / "moved" / "looks.yaml"
    first.write_text("format: surg_looks/1\nlight_strength: [0.5, 1.0]\n", "utf-8")
    words = ("--cameras", "--episodes", "8", "--rollouts", "2", "--out", str(tmp_path / "run"))
    assert learn.main(options("bgr", *words, "--domain-randomization", str(first)), "learn") == 0
    moved.parent.mkdir()
    first.rename(moved)
    assert learn.main(options("bgr", *words, "--domain-randomization", str(moved)), "learn") == 0
    moved.write_text("format: surg_looks/1\nlight_strength: [0.6, 1.0]\n", "utf-8")
    with pytest.raises(CliError, match="holds a run with --domain-randomization"):
        learn.main(options("bgr", *words, "--domain-randomization", str(moved)), "learn")
    with pytest.raises(CliError, match="holds a run with --domain-randomization"):
        learn.main(options("bgr", *words), "learn")


def test_what_goes_on_with_cameras_says_so(
    tmp_path: Path, done: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_memory(*arguments: Any) -> Any:
        raise LearnError("out of memory")

    monkeypatch.setattr(learn_stages, "export", no_memory)
    with pytest.raises(CliError, match=r"--episodes 60 --rollouts 20 --cameras moe_act --out"):
        learn.main(options("bgr", "--cameras", "--out", str(tmp_path / "run")), "learn")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("pick_and_place",), "no policy for it reads the simulator's truth; --cameras"),
        (("pick_and_place", "--cameras", "keypoints"), "there are moe_act, act, bc$"),
        (("bgr", "--cameras", "state"), "--cameras state: for bgr there are .*, keypoints$"),
        (("bgrr",), "bgrr"),
        (("bgr", "--episodes", "0"), "--episodes 0: 1 to 700"),
        (("bgr", "--episodes", "701"), "1 to 700"),
        (("bgr", "--rollouts", "1001"), "--rollouts 1001: 1 to 1000"),
        (("bgr", "--seed", "-1"), "--seed -1"),
        (("bgr", "--setting", "space"), "space"),
        (("bgr", "--setting", "phantom,in_vivo"), "one setting"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_begins(
    words: tuple[str, ...], said: str, tmp_path: Path, done: list[str]
) -> None:
    with pytest.raises(CliError, match=said) as problem:
        learn.main(options(*words, "--out", str(tmp_path / "run")), "learn")
    assert problem.value.code == 2
    assert done == [] and not (tmp_path / "run").exists()


def test_a_folder_of_another_run_is_left_alone(tmp_path: Path, done: list[str]) -> None:
    out = str(tmp_path / "run")
    learn.main(options("bgr", "--episodes", "8", "--rollouts", "1", "--out", out), "learn")
    with pytest.raises(CliError, match="--episodes 8"):
        learn.main(options("bgr", "--episodes", "9", "--rollouts", "1", "--out", out), "learn")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    with pytest.raises(CliError, match="not an empty folder"):
        learn.main(options("bgr", "--out", str(tmp_path / "other")), "learn")


def test_what_a_program_says_in_json_is_its_progress_and_its_result(tmp_path: Path) -> None:
    told: list[float] = []
    script = tmp_path / "train.py"
    script.write_text(
        "import json\n"
        "for part in (0.0, 0.5):\n"
        "    print(json.dumps({'part': part, 'note': 'x'}))\n"
        "print('a warning')\n"
        "print(json.dumps({'weights': 'ab'}))\n"
    )
    argv = ["/usr/bin/python3", str(script)]
    last = learn_stages.follow(argv, tmp_path / "log", lambda news: told.append(news["part"]))
    assert last == {"weights": "ab"} and told == [0.0, 0.5]
    assert (tmp_path / "log").read_text("utf-8") == "a warning\n"
    script.write_text("import sys\nsys.exit('no dataset')\n")
    with pytest.raises(LearnError, match="no dataset"):
        learn_stages.follow(argv, tmp_path / "log", lambda news: None)


# --- where it trains ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [("--cameras",), ()], ids=["pictures", "truth"])
def test_a_gpu_that_is_not_there_is_said_before_anything_is_played(
    kind: tuple[str, ...],
    tmp_path: Path,
    done: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By a PyTorch that finds none, or by a trainer that uses none."""
    monkeypatch.setattr(provision, "install_packages", lambda *a, **k: None)
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "torch.py").write_text(WITHOUT_GPU)
    path = f"{tmp_path / 'modules'}{os.pathsep}{os.environ['PYTHONPATH']}"
    monkeypatch.setenv("PYTHONPATH", path)
    out = tmp_path / "run"
    words = ("bgr", *kind, "--episodes", "8", "--rollouts", "2", "--out", str(out))
    with pytest.raises(CliError, match=r"--device cuda: .*(--cameras|--device cpu)") as said:
        learn.main(options(*words, "--device", "cuda"), "learn")
    assert said.value.code == 2 and "\n" not in str(said.value)
    assert done == [] and not out.exists()
    for device in ("cpu", "auto"):
        assert learn.main(options(*words, "--device", device), "learn") == 0
    # What is trained stays: a machine without the GPU that trained it goes on.
    assert (done.count("demonstrate"), done.count("train")) == (1, 1)


WITHOUT_GPU = """
from types import SimpleNamespace
__version__ = "0.0"
version = SimpleNamespace(cuda="12.0")
cuda = SimpleNamespace(is_available=lambda: False)
"""


def test_learn_goes_on_where_a_machine_without_ros_ended(tmp_path: Path, done: list[str]) -> None:
    words = ("bgr", "--episodes", "8", "--rollouts", "1", "--out", str(tmp_path / "run"))
    assert without_ros.main(words) == 0
    assert done == ["demonstrate", "measure", "export", "train"] and not FakePlayer.played
    assert without_ros.main(words) == 0 and len(done) == 4
    assert learn.main(options(*words), "learn") == 0
    assert len(done) == 4 and FakePlayer.played == [20_000]


def test_both_views_are_recorded_and_make_no_other_run(
    tmp_path: Path,
    done: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Demonstrations that lack a view are said, not passed off as having it."""
    recorded: list[Any] = []

    def demonstrate(
        request: Any, cell: Path, out: Path, _: Any, more_views: Any = ()
    ) -> dict[str, Any]:
        recorded.append(set(more_views))
        return {"success": request.episodes, "failed": {}}

    monkeypatch.setattr(learn_stages, "demonstrate", demonstrate)
    monkeypatch.setattr(learn_stages, "recorded", lambda *given: set(given[3]) <= recorded[-1])
    monkeypatch.setattr(provision, "install_packages", lambda *_, **__: None)
    words = ("bgr", "--cameras", "--rollouts", "1", "--out", str(tmp_path / "mono"))
    assert without_ros.main(words) == 0
    assert without_ros.main((*words, "--both-views")) == 2
    assert "lack one of the views left and right; name another folder" in capsys.readouterr().err
    recorded.clear()
    words = (*words[:-1], str(tmp_path / "run"))
    assert without_ros.main((*words, "--both-views")) == 0
    assert recorded == [{"left", "right"}]
    assert learn.main(options(*words), "learn") == 0 and len(recorded) == 1


def test_both_views_without_cameras_are_refused(
    tmp_path: Path, done: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert without_ros.main(("bgr", "--both-views", "--out", str(tmp_path / "run"))) == 2
    assert "--cameras" in capsys.readouterr().err and not done and not (tmp_path / "run").exists()


def test_the_stages_before_the_roll_outs_need_no_ros() -> None:
    hide = f"""
import sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {ROS!r}:
            raise ImportError(f"{{name}} is not there")
sys.meta_path.insert(0, NoRos())
import surg_recording.datasets.formats.lerobot_v21, surg_recording.reports.learning
import surg_sim.envs.demonstrations
from surg_cli import without_ros
without_ros.main(["--help"])
"""
    run = subprocess.run([sys.executable, "-c", hide], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert "--both-views" in run.stdout
