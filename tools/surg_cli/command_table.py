"""The commands of `./surg`, their groups and their option parsers."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from surg_cli.commands.arms import robot_file
from surg_cli.host.terminal import Problem

GROUPS = ("run", "data", "learn", "robot", "develop")


@dataclass(frozen=True)
class Command:
    """One command."""

    group: str  # where `./surg help` lists it
    module: str  # of `surg_cli.commands`
    help: str
    needs_workspace: bool = True  # whether everything is set up and built before it runs
    draws: bool = True  # whether it may start what draws pictures
    everything: bool = False  # whether it needs the packages that others do without
    packages: tuple[str, ...] = ()  # sets of the package list that it needs
    workspace_option: str = ""  # an option that needs everything set up and built
    urgent: bool = False  # acts at once by its module's `at_once`, and never builds

    def wants_workspace(self, words: Sequence[str]) -> bool:
        """Whether it needs the workspace when called with these words."""
        asked = any(word.partition("=")[0] == self.workspace_option for word in words)
        return self.needs_workspace or (bool(self.workspace_option) and asked)


COMMANDS = {
    "demo": Command("run", "demo", "play a recorded motion through a trocar and report the errors"),
    "run": Command("run", "run", "play episodes of a task, by scripted senders or by a policy"),
    "teleop": Command("run", "teleop", "operate the phantom from the browser console"),
    "up": Command("run", "up", "bring a cell up and keep it until Ctrl-C"),
    "down": Command("run", "down", "end what `up` started", needs_workspace=False),
    "stop": Command(
        "run", "stop", "pause every arm of the running systems", draws=False, urgent=True
    ),
    "status": Command("run", "status", "list nodes, topic rates and last errors", draws=False),
    "record": Command("data", "record", "start, stop and tag a recording", draws=False),
    "recover": Command("data", "episode.recover", "complete recordings that were interrupted"),
    "view": Command("data", "episode.view", "show an episode: video, tip path and curves on one page"),
    "film": Command(
        "data", "episode.make_film", "make a short film of an episode: endoscope beside the room"
    ),
    "depth": Command(
        "data",
        "episode.compute_depth",
        "compute the depth of a recorded stereo endoscope",
        draws=False,
        packages=("opencv",),
    ),
    "label": Command(
        "data", "episode.label", "judge, mark and trim recordings, by keyboard", draws=False
    ),
    "evaluate": Command("data", "episode.evaluate", "compare recorded episodes in figures and tables"),
    "export": Command(
        "data", "episode.export", "write a dataset: LeRobot, robomimic, ACT, Zarr, bags", everything=True
    ),
    "import": Command("data", "episode.import_recordings", "import bags and LeRobot data sets"),
    "learn": Command("learn", "learn", "demonstrate, export, train, deploy and judge a policy"),
    "keys": Command("learn", "policy.make_keys", "make key pairs for a model server and its policies"),
    "calibrate": Command(
        "robot", "calibrate", "solve tool and trocar from recorded poses", packages=("opencv",)
    ),
    "check-frames": Command(
        "robot", "check_frames", "compare commanded and observed tip motion", packages=("opencv",)
    ),
    "reach": Command("robot", "arms.reach", "tell and draw where the tips of a cell can go"),
    "robot": Command("robot", "arms.robot", "start, stop, guide robots; their lag", draws=False),
    "emulate": Command("robot", "arms.emulate", "emulate a real arm's controller", draws=False),
    "ptp": Command("robot", "ptp", "synchronise the clocks of two machines", needs_workspace=False),
    "setup": Command("develop", "dev.setup", "install packages and .venv", needs_workspace=False),
    "build": Command("develop", "dev.setup", "set up and build the workspace", needs_workspace=False),
    "test": Command("develop", "dev.run_tests", "build and run the tests", everything=True),
    "bench": Command("develop", "dev.bench", "run a benchmark", everything=True),
    "shell": Command("develop", "dev.shell", "open a shell with the workspace sourced"),
    "topics": Command("develop", "dev.topics", "compare a graph with docs/reference/topics.yaml"),
    "doctor": Command(
        "develop",
        "dev.doctor",
        "list what is installed, missing and running; --robot CELL: examine an arm",
        needs_workspace=False,
        draws=False,
        workspace_option="--robot",
    ),
}
MOVED = {("demo", "--task"): "./surg run TASK", ("demo", "--full"): "./surg learn TASK"}
"""Options that earlier versions had, and the command that does the same now."""


def usage() -> str:
    """The text of `./surg help`."""
    lines = ["usage: ./surg COMMAND [options]      ./surg COMMAND --help lists the options"]
    for group in GROUPS:
        lines += ["", f"{group}:"]
        lines += [f"  {n:12s}  {c.help}" for n, c in COMMANDS.items() if c.group == group]
    lines += ["", "`demo` and `test` set everything up on first use."]
    return "\n".join(lines)


def parser(name: str) -> tuple[argparse.ArgumentParser, Callable[[Any, str], int]]:
    """The option parser of a command, and the function that runs it."""
    command = COMMANDS[name]
    made = argparse.ArgumentParser(prog=f"./surg {name}", description=command.help)
    module = importlib.import_module(f"surg_cli.commands.{command.module}")
    module.add_arguments(made, name)
    return made, module.main


def at_once(name: str, words: Sequence[str]) -> None:
    """What an urgent command does before it enters the workspace; raises as `parse`."""
    options, _ = parse(name, words)
    importlib.import_module(f"surg_cli.commands.{COMMANDS[name].module}").at_once(options)


def parse(name: str, words: Sequence[str]) -> tuple[argparse.Namespace, Callable[[Any, str], int]]:
    """Parse the words behind a command; returns the options and the function that runs it.

    Raises:
        Problem: An option belongs to other commands; names them.
        SystemExit: An option or argument is wrong otherwise; argparse has printed why.
    """
    own, main = parser(name)
    if name == "robot" and words and words[0] in robot_file.WORDS:
        own, main = _robot_file(words[0])
        words = words[1:]
    options, unknown = own.parse_known_args(words)
    for word in unknown:
        option = word.partition("=")[0]
        if (other := MOVED.get((name, option), "")) or (other := commands_with(option)):
            raise Problem(f"{name} has no option {option}; use {other}", 2)
    if unknown:
        own.error(f"unrecognized arguments: {' '.join(unknown)}")
    return options, main


def _robot_file(word: str) -> tuple[argparse.ArgumentParser, Callable[[Any, str], int]]:
    """The parser of `./surg robot check FILE` or `home FILE`, and the function that runs it."""
    made = argparse.ArgumentParser(prog=f"./surg robot {word}", description=robot_file.WORDS[word])
    robot_file.add_arguments(made, word)
    return made, lambda options, _: robot_file.main(options, word)


def commands_with(option: str) -> str:
    """The commands that have an option, such as `./surg run or ./surg learn`; empty: none has."""
    # argparse has no public list of its options.
    names = [name for name in COMMANDS if option in parser(name)[0]._option_string_actions]
    return " or ".join(f"./surg {name}" for name in names)
