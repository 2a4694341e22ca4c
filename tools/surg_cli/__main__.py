"""Dispatches `./surg COMMAND`.

The process starts with Debian's Python and the standard library only. Commands that need the
workspace set it up first and then replace the process by `.venv`'s Python in the sourced
environment, told by the variable `SURG_READY`.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Sequence

from surg_cli.host import environment, paths, provision, workspace
from surg_cli.host.terminal import Problem, say, warn

# command -> (module, needs the workspace, one line of help)
COMMANDS = {
    "demo": ("demo", True, "drive an instrument through its trocar and report how well it went"),
    "run": ("run", True, "episodes of a task by scripted senders, with success and deviations"),
    "learn": ("learn", True, "demonstrate, export, train, deploy and judge a policy of a task"),
    "evaluate": ("evaluate", True, "figures and tables of recorded episodes, by condition"),
    "teleop": ("teleop", True, "the phantom under your hands: an operator console in the browser"),
    "export": (
        "export",
        True,
        "recordings as a dataset: LeRobot, robomimic, ACT, diffusion_policy",
    ),
    "test": ("testing", True, "build and run the tests"),
    "setup": ("setup", False, "install Debian packages and .venv"),
    "build": ("setup", False, "build the workspace (does setup first)"),
    "up": ("up", True, "bring a cell up and keep it until Ctrl-C"),
    "down": ("down", False, "end what `up` started"),
    "keys": (
        "make_keys",
        True,
        "key pairs for a model server and its policies",
    ),
    "calibrate": ("calibrate", True, "tool and trocar of a cell from recorded poses"),
    "record": ("record", True, "start, stop, tag a recording of a running system"),
    "recover": ("recover", True, "finish recordings that were cut off"),
    "check-frames": ("check_frames", True, "do hand and picture agree? judged by the pictures"),
    "status": ("status", True, "every node, topic rate and last error of a running system"),
    "ptp": ("ptp", False, "keep the clocks of two machines together (PTP master or slave)"),
    "view": ("view", True, "an episode as one page: video, tip path and curves under one cursor"),
    "shell": ("shell", True, "a shell with the environment sourced"),
    "doctor": ("doctor", False, "what is installed, missing, running"),
    "bench": ("bench", True, "measure"),
    "topics": (
        "topics",
        True,
        "hold the running graph against docs/reference/topics.yaml; make docs/reference/topics.md",
    ),
}
READY = "SURG_READY"


def usage() -> str:
    """The text of `./surg help`."""
    lines = ["usage: ./surg COMMAND [options]      ./surg COMMAND --help says more", ""]
    lines += [f"  {name:12s} {text}" for name, (_, _, text) in COMMANDS.items()]
    lines += ["", "`demo` and `test` set everything up on first use."]
    return "\n".join(lines)


def make_ready(force: bool = False) -> bool:
    """Install packages, fill `.venv`, build: only what is not done yet.

    Args:
        force: Build even when nothing has changed.

    Returns:
        Whether anything had to be done.
    """
    logs = paths.STATE / "logs"
    done = provision.install_packages(logs / "apt.log")
    done |= provision.install_python(logs / "pip.log")
    done |= workspace.build(logs / "build.log", force)
    return done


def interrupt_on_signals() -> None:
    """Turn every ending signal into KeyboardInterrupt, so that each way out stops the children."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt(signal.Signals(number).name)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, interrupt)


def run(arguments: Sequence[str]) -> int:
    """Run one command.

    Args:
        arguments: The words behind `./surg`.

    Returns:
        The exit status.
    """
    if not arguments or arguments[0] in ("help", "-h", "--help"):
        say(usage())
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        warn(f"surg: no command {name!r}; there are: {', '.join(COMMANDS)}")
        return 2
    module_name, needs_workspace, _ = COMMANDS[name]
    if needs_workspace and READY not in os.environ:
        wants_help = any(word in ("-h", "--help") for word in rest)
        if not (wants_help and name != "shell"):
            make_ready()
            env = environment.for_nodes()
            python_path = env.get("PYTHONPATH", "")
            env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{python_path}".rstrip(":")
            env["SURG_CALLER_MASTER"] = os.environ.get("ROS_MASTER_URI", "")
            env[READY] = "1"
            python = str(paths.VENV_PYTHON)
            os.execve(python, [python, "-s", "-m", "surg_cli", *arguments], env)
    os.environ.pop(READY, None)
    parser = argparse.ArgumentParser(prog=f"./surg {name}", description=COMMANDS[name][2])
    module = importlib.import_module(f"surg_cli.commands.{module_name}")
    module.add_arguments(parser, name)
    return int(module.main(parser.parse_args(rest), name))


def main() -> int:
    """Run the command line; turn problems and interrupts into one line and an exit status."""
    interrupt_on_signals()
    try:
        return run(sys.argv[1:])
    except Problem as problem:
        warn(f"surg: {problem}")
        return problem.code
    except KeyboardInterrupt as interrupt:
        warn(f"\nsurg: stopped by {str(interrupt) or 'Ctrl-C'}")
        return 130
    except BrokenPipeError:
        return 1


if __name__ == "__main__":
    sys.exit(main())
