"""The commands of `./surg`, their groups and their option parsers.

A command's name is one word, or two where it belongs to a family: `episode view`. `robot check` and
`robot home` are commands beside `robot CELL ACTION`.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from surg_cli import moved
from surg_cli.host.terminal import CliError

GROUPS = ("run", "data", "learn", "robot", "develop")
FAMILIES = {
    "episode": ("data", "what is done with recorded episodes"),
    "policy": ("learn", "begin a policy, and what it needs before it connects"),
    "task": ("learn", "begin a task"),
    "dev": ("develop", "set up, build, test and examine the workspace"),
}
"""First word -> group and help of the commands that begin with it."""
HELP = ("help", "-h", "--help")


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
    urgent: bool = False  # acts at once by its module's `at_once`, and never builds


_TEST = Command("develop", "dev.run_tests", "build and run the tests", everything=True)
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
    "episode view": Command("data", "episode.view", "show video, tip path and curves on one page"),
    "episode film": Command(
        "data", "episode.make_film", "make a short film: endoscope beside the room"
    ),
    "episode label": Command(
        "data", "episode.label", "judge, mark and trim recordings, by keyboard", draws=False
    ),
    "episode depth": Command(
        "data",
        "episode.compute_depth",
        "compute the depth of a recorded stereo endoscope",
        draws=False,
        packages=("opencv",),
    ),
    "episode recover": Command("data", "episode.recover", "complete interrupted recordings"),
    "episode export": Command(
        "data",
        "episode.export",
        "write a dataset: LeRobot, robomimic, ACT, Zarr, bags",
        everything=True,
    ),
    "episode import": Command(
        "data",
        "episode.import_recordings",
        "import bags and LeRobot data sets",
        packages=("opencv",),
    ),
    "episode check": Command(
        "data", "episode.check_set", "what is wrong with a LeRobot data set", draws=False
    ),
    "episode evaluate": Command("data", "episode.evaluate", "compare in figures and tables"),
    "learn": Command("learn", "learn", "demonstrate, export, train, deploy and judge a policy"),
    "policy new": Command(
        "learn", "policy.new_file", "write a policy to begin with", needs_workspace=False
    ),
    "task new": Command(
        "learn", "policy.new_file", "write a task to begin with", needs_workspace=False
    ),
    "policy keys": Command(
        "learn", "policy.make_keys", "make key pairs for a model server and its policies"
    ),
    "calibrate": Command(
        "robot", "calibrate", "solve tool and trocar from recorded poses", packages=("opencv",)
    ),
    "check-frames": Command(
        "robot", "check_frames", "compare commanded and observed tip motion", packages=("opencv",)
    ),
    "reach": Command("robot", "arms.reach", "tell and draw where the tips of a cell can go"),
    "robot": Command("robot", "arms.robot", "start, stop, guide robots; their lag", draws=False),
    "robot check": Command(
        "robot",
        "arms.robot_file",
        "examine a robot's YAML: limits, kinematics against the URDF, reach from its home",
        draws=False,
    ),
    "robot home": Command(
        "robot",
        "arms.robot_file",
        "search for the home posture with the largest reserve",
        draws=False,
    ),
    "emulate": Command("robot", "arms.emulate", "emulate a real arm's controller", draws=False),
    "ptp": Command("robot", "ptp", "synchronise the clocks of two machines", needs_workspace=False),
    "test": _TEST,
    "dev setup": Command(
        "develop", "dev.setup", "install packages and .venv", needs_workspace=False
    ),
    "dev build": Command(
        "develop", "dev.setup", "set up and build the workspace", needs_workspace=False
    ),
    "dev test": _TEST,
    "dev bench": Command("develop", "dev.bench", "run a benchmark", everything=True),
    "dev shell": Command("develop", "dev.shell", "open a shell with the workspace sourced"),
    "dev doctor": Command(
        "develop",
        "dev.doctor",
        "list what is installed, missing and running",
        needs_workspace=False,
        draws=False,
    ),
    "dev topics": Command(
        "develop", "dev.topics", "compare a graph with docs/reference/topics.yaml"
    ),
}


def page(words: Sequence[str]) -> str:
    """The page that words ask for: `help`, or a family such as `episode`; empty: a command."""
    if not words or words[0] in HELP:
        return _all_commands()
    if words[0] in FAMILIES and (len(words) == 1 or words[1] in HELP):
        return _family(words[0])
    return ""


def _all_commands() -> str:
    lines = ["usage: ./surg COMMAND [options]      ./surg COMMAND --help lists the options"]
    for group in GROUPS:
        lines += ["", f"{group}:"]
        lines += [
            f"  {name:12s}  {command.help}"
            for name, command in COMMANDS.items()
            if command.group == group and " " not in name
        ]
        lines += [
            f"  {name:12s}  {help_}: {', '.join(members(name))}"
            for name, (of, help_) in FAMILIES.items()
            if of == group
        ]
    lines += ["", "`demo` and `test` set everything up on first use."]
    return "\n".join(lines)


def _family(first: str) -> str:
    lines = [
        f"usage: ./surg {first} COMMAND [options]      ./surg {first} COMMAND --help lists them",
        "",
        f"{FAMILIES[first][1]}:",
    ]
    lines += [f"  {word:12s}  {COMMANDS[f'{first} {word}'].help}" for word in members(first)]
    return "\n".join(lines)


def members(first: str) -> list[str]:
    """Second words of the commands that begin with a word."""
    return [name.partition(" ")[2] for name in COMMANDS if name.startswith(f"{first} ")]


def find(words: Sequence[str]) -> tuple[str, Sequence[str]]:
    """The name of the command that words call, and the words behind it.

    Raises:
        CliError: There is no such command; names the new one, or those that there are.
    """
    for count in (2, 1):
        if (name := " ".join(words[:count])) in COMMANDS:
            return name, words[count:]
    first = words[0]
    if first in moved.COMMANDS:
        raise CliError(f"{first} is now ./surg {moved.COMMANDS[first]}", 2)
    if first in FAMILIES:
        raise CliError(
            f"no command '{first} {words[1]}'; there are: {', '.join(members(first))}", 2
        )
    known = dict.fromkeys(each.partition(" ")[0] for each in COMMANDS)
    raise CliError(f"no command {first!r}; there are: {', '.join(known)}", 2)


def parser(name: str) -> tuple[argparse.ArgumentParser, Callable[[Any, str], int]]:
    """The option parser of a command, and the function that runs it."""
    command = COMMANDS[name]
    made = argparse.ArgumentParser(prog=f"./surg {name}", description=command.help)
    module = importlib.import_module(f"surg_cli.commands.{command.module}")
    module.add_arguments(made, name.split()[-1])
    return made, module.main


def at_once(name: str, words: Sequence[str]) -> None:
    """What an urgent command does before it enters the workspace; raises as `parse`."""
    options, _ = parse(name, words)
    importlib.import_module(f"surg_cli.commands.{COMMANDS[name].module}").at_once(options)


def parse(name: str, words: Sequence[str]) -> tuple[argparse.Namespace, Callable[[Any, str], int]]:
    """Parse the words behind a command; returns the options and the function that runs it.

    Raises:
        CliError: An option has moved, or belongs to other commands; says what to use.
        SystemExit: An option or argument is wrong otherwise; argparse has printed why.
    """
    own, main = parser(name)
    mine = options_of(name)
    for word in words:  # before argparse, which could take the value behind it for an argument
        if cure := moved.ARGUMENTS.get((name, word), ""):
            raise CliError(f"{name} {word} is now {cure}", 2)
        option = word.partition("=")[0]
        if option not in mine and (cure := moved.OPTIONS.get((name, option), "")):
            raise CliError(f"{name} has no option {option}; use {cure}", 2)
    options, unknown = own.parse_known_args(words)
    for option in (word.partition("=")[0] for word in unknown):
        if cure := commands_with(option):
            raise CliError(f"{name} has no option {option}; use {cure}", 2)
    if unknown:
        own.error(f"unrecognized arguments: {' '.join(unknown)}")
    return options, main


def commands_with(option: str) -> str:
    """The commands that have an option, such as `./surg run or ./surg learn`; empty: none has."""
    return " or ".join(f"./surg {name}" for name in COMMANDS if option in options_of(name))


def options_of(name: str) -> list[str]:
    """The options of a command that begin with ``--``, without `--help`."""
    # argparse has no public list of its options.
    known = parser(name)[0]._option_string_actions
    return [word for word in known if word.startswith("--") and word != "--help"]
