"""The command line's own logic: commands, options, node lists, verdicts, running systems."""

import argparse
import json
import os
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from helpers.graph.surg import called, printed
from surg_cli import __main__ as cli
from surg_cli import command_table, moved
from surg_cli.commands import up
from surg_cli.graph import follow, master, processes, roles, running, system, task_episode
from surg_cli.graph.processes import Supervisor
from surg_cli.graph.system_plan import Policy, SystemPlan
from surg_cli.host import cells, option_types, paths, pytest_run
from surg_cli.host.terminal import CliError, table

MOST_FIRST_WORDS = 20
MOST_OPTIONS = 140


def plan(tmp_path: Path, **changes: object) -> SystemPlan:
    values: dict[str, object] = {
        "cell": tmp_path,
        "arms": ("PSM1",),
        "lockstep": True,
        "cameras": ("left",),
        "out": tmp_path / "out",
        "operator": {"cell": "c"},
    }
    return SystemPlan(**{**values, **changes})


def test_every_command_has_a_module_and_options() -> None:
    for name, command in command_table.COMMANDS.items():
        _, main = command_table.parser(name)
        assert callable(main)
        assert command.help and command.group in command_table.GROUPS


def test_help_lists_every_command_once_under_its_group(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.run(["help"]) == 0
    listed: dict[str, str] = {}
    for line in capsys.readouterr().out.splitlines()[1:]:
        if line.endswith(":"):
            group = line.removesuffix(":")
        elif line.startswith("  "):
            name = line.split()[0]
            assert name not in listed
            listed[name] = group
    families = {first: group for first, (group, _) in command_table.FAMILIES.items()}
    single = {name: c.group for name, c in command_table.COMMANDS.items() if " " not in name}
    assert listed == {**single, **families}


@pytest.mark.parametrize("first", command_table.FAMILIES)
@pytest.mark.parametrize("asked", [(), ("--help",)])
def test_help_of_a_family_lists_its_commands(
    first: str, asked: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run([first, *asked]) == 0
    listed = re.findall(r"(?m)^  ([\w-]+)  ", capsys.readouterr().out)
    assert listed == command_table.members(first) and listed
    for second in listed:
        assert command_table.COMMANDS[f"{first} {second}"].group == command_table.FAMILIES[first][0]


@pytest.mark.parametrize("name", ["robot", "run"])
def test_help_needs_no_sourced_shell(name: str) -> None:
    """Their options are those of the workspace's packages, which a new shell does not know."""
    words, env = [str(paths.ROOT / "surg"), name, "--help"], {"PATH": "/usr/bin:/bin"}
    done = subprocess.run(words, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"usage: ./surg {name}" in done.stdout


def test_help_of_a_tree_without_a_build_says_what_to_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(cli.READY, raising=False)
    monkeypatch.setattr(paths, "DEVEL", tmp_path)

    def parse(name: str, words: list[str]) -> None:
        raise ModuleNotFoundError("No module named 'surg_hardware'")

    monkeypatch.setattr(cli, "parse", parse)
    with pytest.raises(CliError, match=r"run \./surg dev build"):
        cli.run(["robot", "--help"])


@pytest.mark.parametrize(
    ("words", "known"),
    [(["dance"], "demo"), (["episode", "dance"], "view"), (["policy", "--out", "x"], "keys")],
)
def test_an_unknown_command_names_the_known_ones(words: list[str], known: str) -> None:
    with pytest.raises(CliError, match=f"there are: .*{known}") as caught:
        cli.run(words)
    assert caught.value.code == 2


@pytest.mark.parametrize(("old", "new"), moved.COMMANDS.items())
def test_an_old_command_answers_with_the_new_one(old: str, new: str) -> None:
    assert old not in command_table.COMMANDS and new in command_table.COMMANDS
    with pytest.raises(CliError, match=rf"^{old} is now \./surg {new}$") as caught:
        cli.run([old, "x"])
    assert caught.value.code == 2


def test_there_are_few_commands_and_options() -> None:
    assert len({name.split()[0] for name in command_table.COMMANDS}) <= MOST_FIRST_WORDS
    names = {command: name for name, command in command_table.COMMANDS.items()}  # test: once
    options = [f"{name} {o}" for name in names.values() for o in command_table.options_of(name)]
    print(f"{len(options)} options")
    assert len(options) <= MOST_OPTIONS


@pytest.mark.parametrize(("name", "option"), moved.OPTIONS)
def test_an_old_option_answers_with_the_new_one(name: str, option: str) -> None:
    needed = {
        "calibrate": ["sim_ur5e", "tool"],
        "record": ["status"],
        "robot": ["sim_ur5e", "lag"],
        "ptp": ["slave"],
    }
    with pytest.raises(CliError, match=rf"^{name} has no option {option}; use .") as caught:
        command_table.parse(name, [*needed.get(name, ["x"]), option, "1"])
    assert caught.value.code == 2


def test_nodes_of_a_lock_step_run(tmp_path: Path) -> None:
    nodes = {node.name: node for node in system.nodes(plan(tmp_path))}
    assert set(nodes) == {"/sim", "/endoscope", "/PSM1/controller", "/recorder"}
    assert nodes["/sim"].params["participants"] == ["operator"]
    assert nodes["/sim"].params["observers"] == ["recorder", "endoscope"]
    assert nodes["/PSM1/controller"].params["participants"] == ["operator"]
    assert "link" not in nodes["/PSM1/controller"].params
    assert "feedback_gain" not in nodes["/PSM1/controller"].params


def test_nodes_without_video_and_operator(tmp_path: Path) -> None:
    nodes = {n.name: n for n in system.nodes(plan(tmp_path, cameras=(), operator=None))}
    assert set(nodes) == {"/sim", "/PSM1/controller", "/recorder"}
    assert nodes["/sim"].params["participants"] == []
    assert nodes["/sim"].params["observers"] == ["recorder"]


def test_options_reach_the_controller(tmp_path: Path) -> None:
    wanted = plan(tmp_path, law="paper", link="twist", feedback_gain=0, lockstep=False)
    params = {n.name: n for n in system.nodes(wanted)}["/PSM1/controller"].params
    assert params["law"] == "paper"
    assert params["link"] == "twist"
    assert params["feedback_gain"] == 0.0
    assert isinstance(params["feedback_gain"], float)
    assert params["mode"] == "freerun"


@pytest.mark.parametrize(("cores", "first"), [(1, False), (2, True)])
def test_in_real_time_the_robot_and_its_controller_come_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int, first: bool
) -> None:
    """A simulator that cannot keep up may not take the only processor."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))
    real_time = {n.name: n.drives for n in system.nodes(plan(tmp_path, lockstep=False))}
    assert real_time["/PSM1/controller"] and real_time["/sim"] is first
    assert not any(node.drives for node in system.nodes(plan(tmp_path)))


def test_a_scene_that_is_drawn_has_more_time_to_start(tmp_path: Path) -> None:
    """In lock-step the simulator waits for the endoscope, longer than whoever watches it."""

    def limit(cameras: tuple[str, ...], lockstep: bool) -> object:
        made = system.nodes(plan(tmp_path, cameras=cameras, lockstep=lockstep))
        return made[0].params.get("connect_timeout")

    assert limit(("left",), True) == system.CAMERA_START_S < follow.FIRST_TICK_TIMEOUT_S
    assert limit((), True) is None and limit(("left",), False) is None


def test_rosrun_lines_name_node_and_params(tmp_path: Path) -> None:
    line = system.nodes(plan(tmp_path))[0].rosrun_line()
    assert line.startswith("rosrun surg_sim bridge_node.py __name:=sim __ns:=/ ")
    assert "_mode:=lockstep" in line
    assert "_participants:=operator" in line
    assert "_observers:=recorder,endoscope" in line


def test_up_records_what_it_is_told_besides(capsys: pytest.CaptureFixture[str]) -> None:
    def recorder(*words: str) -> str:
        (line,) = [each for each in printed(capsys, "sim_ur5e", *words) if "recorder_node" in each]
        return line

    words = ["--record-topics", "/tf", "/PSM1/measured_*", "--record-topics", "/tf"]
    line = recorder(*words, "--record-cameras", "/scope/image_raw/compressed")
    assert "'_topics:=/tf,/PSM1/measured_*'" in line
    assert "_cameras:=endoscope_left,/scope/image_raw/compressed" in line
    assert "_topics" not in recorder()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--record-topics", "tf"], r"--record-topics 'tf'"),
        (["--record-topics", "/a,/b"], r"--record-topics '/a,/b'"),
        (["--record-cameras", "/eye/*"], r"--record-cameras '/eye/\*'"),
    ],
)
def test_what_is_no_topic_is_not_recorded(words: list[str], said: str) -> None:
    with pytest.raises(CliError, match=said) as caught:
        called("up", "sim_ur5e", *words, "--print")
    assert caught.value.code == 2


def test_only_the_robots_machine_records() -> None:
    robot, operator = (
        roles.Link(role, "10.0.0.2", "10.0.0.1", 11311)
        for role in (roles.Role.ROBOT, roles.Role.OPERATOR)
    )
    assert up.recorded_too(["/tf"], ["/eye"], robot) == (("/tf",), ("/eye",))
    assert up.recorded_too([], [], operator) == ((), ())
    with pytest.raises(CliError, match="--record-topics"):
        up.recorded_too(["/tf"], [], operator)


def test_an_unknown_cell_names_the_bundled_ones() -> None:
    with pytest.raises(CliError, match="sim_ur5e"):
        cells.find("nowhere")


def test_an_unknown_robot_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CliError, match="fr3, panda, ur10e, ur3e, ur5e, xarm7"):
        cells.for_robot("kuka", tmp_path)
    with pytest.raises(CliError, match="no such file"):
        cells.for_robot(str(tmp_path / "kuka.yaml"), tmp_path)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf"])
def test_only_positive_numbers(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError):
        option_types.positive(text)


def test_an_out_folder_with_content_is_refused(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("")
    with pytest.raises(CliError, match="not an empty folder"):
        paths.run_folder(tmp_path)
    assert paths.run_folder(tmp_path / "new") == tmp_path / "new"


def test_a_dead_master_is_said_with_the_cure() -> None:
    with pytest.raises(CliError, match=r"\./surg up CELL"):
        master.nodes(f"http://localhost:{master.free_port()}")


def test_a_missing_gl_library_is_said_with_the_cure(tmp_path: Path) -> None:
    with Supervisor(dict(os.environ), tmp_path) as supervisor:
        code = "echo \"ImportError: ('Unable to load EGL library', 'libEGL.so.1')\"; exit 1"
        child = supervisor.start("/endoscope", ["/bin/sh", "-c", code])
        assert processes.wait_until(lambda: child.exit_code is not None, 5.0)
        text = follow.death_notice(child)
    assert "/endoscope ended (1)" in text
    assert "--no-video" in text


def test_running_systems_forget_the_dead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "SYSTEMS", tmp_path)
    with running.announced("up", 12345, Path("cell"), Path("logs")):
        assert [s.port for s in running.systems()] == [12345]
        # The same process id with another start is another process.
        entry = json.loads((tmp_path / "12345.json").read_text())
        (tmp_path / "1.json").write_text(json.dumps({**entry, "port": 1, "start_time": 7}))
        assert [s.port for s in running.systems()] == [12345]
        assert not (tmp_path / "1.json").exists()
    assert running.systems() == []


def test_counts_in_pytests_closing_line() -> None:
    line = "==== 1 failed, 20 passed, 3 skipped, 2 errors in 1.23s ===="
    assert pytest_run.parse_counts(line) == {
        "failed": 1,
        "passed": 20,
        "skipped": 3,
        "errors": 2,
    }
    tail = f"SKIPPED [2] tests/e2e/test_vm_devices.py:40: missing: no kernel. Type:\n  do\n{line}"
    assert pytest_run.parse_counts(tail) == {**pytest_run.parse_counts(line), "missing": 2}


def test_tables_line_up() -> None:
    assert table([["a", "b"], ["ccc", "d"]], "") == "a    b\nccc  d"
    assert table([]) == ""


@pytest.mark.parametrize(
    ("words", "others"),
    [
        (["--task", "bgr"], {"run"}),
        (["--full"], {"learn"}),
        (["--setting", "phantom"], {"run", "learn", "teleop", "check-frames"}),
        (["--rollouts=3"], {"learn"}),
        (["--scale", "2", "--episodes", "1"], {"run", "learn"}),
    ],
)
def test_demo_names_the_commands_that_have_an_option(words: list[str], others: set[str]) -> None:
    """Also where the option has its default value."""
    with pytest.raises(CliError) as caught:
        command_table.parse("demo", words)
    assert caught.value.code == 2
    assert set(re.findall(r"\./surg ([\w-]+)", str(caught.value))) == others


def test_an_option_that_no_command_has_is_refused() -> None:
    with pytest.raises(SystemExit) as caught:
        command_table.parse("demo", ["--dance"])
    assert caught.value.code == 2


def test_a_controller_waits_for_those_who_command_its_arm(tmp_path: Path) -> None:
    wanted = plan(
        tmp_path,
        arms=("PSM1", "ECM"),
        operator=None,
        task="bgr",
        setting="in_vivo",
        cameras=("left", "right"),
        senders={"expert": ("PSM1",), "assistant": ()},
    )
    nodes = {node.name: node.params for node in system.nodes(wanted)}
    assert nodes["/sim"]["participants"] == ["expert", "assistant"]
    assert nodes["/PSM1/controller"]["participants"] == ["expert"]
    assert nodes["/ECM/controller"]["participants"] == []
    for name in ("/sim", "/endoscope"):
        assert (nodes[name]["task"], nodes[name]["setting"]) == ("bgr", "in_vivo")
    assert nodes["/recorder"]["cameras"] == ["endoscope_left", "endoscope_right"]
    assert [node.name for node in system.senders(wanted)] == ["/expert", "/assistant"]
    assert episode_plan(wanted) == wanted


def test_in_real_time_a_scripted_sender_begins_after_the_policys_arms(tmp_path: Path) -> None:
    policy = Policy("tcp://127.0.0.1:5555", "policy.py")
    wanted = plan(tmp_path, senders={"assistant": (), system.POLICY: ("PSM1",)}, policy=policy)
    for lockstep, after in ((True, None), (False, ["PSM1"])):
        (node,) = system.senders(replace(wanted, lockstep=lockstep))
        assert node.name == "/assistant" and node.params.get("after") == after


def test_in_real_time_a_late_policy_is_followed_at_the_allowed_pace(tmp_path: Path) -> None:
    policy = Policy("tcp://127.0.0.1:5555", "policy.py")
    wanted = plan(tmp_path, senders={system.POLICY: ("PSM1",)}, policy=policy)
    for lockstep, clip in ((True, None), (False, ["start", "step", "acceleration", "jaw"])):
        node = system.model_server(replace(wanted, lockstep=lockstep))
        assert node.params.get("clip") == clip


def episode_plan(wanted: SystemPlan) -> SystemPlan:
    """The plan as the process of an episode reads it."""
    task_episode.write_plan(wanted)
    return task_episode.read_plan(wanted.out)
