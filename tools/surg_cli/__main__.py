"""Dispatches `./surg COMMAND`.

The process starts with Debian's Python and the standard library only. Commands that need the
workspace set it up first. They then replace the process by `.venv`'s Python in the sourced
environment and mark that by the variable `SURG_READY`.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence

from surg_cli.command_table import COMMANDS, at_once, find, page, parse
from surg_cli.graph.processes import interrupt_on_signals
from surg_cli.host import environment, paths, preflight, provision, workspace
from surg_cli.host.terminal import CliError, say, warn

READY = "SURG_READY"


def run(arguments: Sequence[str]) -> int:
    """Run one command, given the words behind `./surg`; returns the exit status.

    Raises:
        CliError: There is no such command, or it refuses its options.
    """
    if text := page(arguments):
        say(text)
        return 0
    name, rest = find(arguments)
    if COMMANDS[name].needs_workspace and READY not in os.environ:
        if name != "dev shell" and any(word in ("-h", "--help") for word in rest):
            _print_help(name, rest)
        elif COMMANDS[name].urgent:
            at_once(name, rest)
        else:
            needs = COMMANDS[name].everything, COMMANDS[name].packages
            if stages := provision.overview(*needs):
                say(stages)
            provision.make_ready(*needs)
            workspace.build(paths.STATE / "logs" / "build.log")
        _enter_workspace(name, arguments)
    os.environ.pop(READY, None)
    options, command = parse(name, rest)
    return command(options, name.split()[-1])


def _print_help(name: str, rest: Sequence[str]) -> None:
    """Print a command's help and exit; return where its options are those of the workspace."""
    with contextlib.suppress(ModuleNotFoundError):
        parse(name, rest)


def _enter_workspace(name: str, arguments: Sequence[str]) -> None:
    """Replace the process by `.venv`'s Python in the sourced environment; a CliError if unbuilt."""
    env = environment.for_nodes(draws=COMMANDS[name].draws)
    python_path = env.get("PYTHONPATH", "")
    env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{python_path}".rstrip(":")
    env["SURG_CALLER_MASTER"] = os.environ.get("ROS_MASTER_URI", "")
    env[READY] = "1"
    python = str(paths.VENV_PYTHON)
    os.execve(python, [python, "-s", "-m", "surg_cli", *arguments], env)


def main() -> int:
    """Run the command line; turn problems and interrupts into one line and an exit status."""
    interrupt_on_signals()
    try:
        return run(sys.argv[1:])
    except CliError as problem:
        warn(f"surg: {problem}")
        return problem.code
    except KeyboardInterrupt as interrupt:
        warn(f"\nsurg: stopped by {str(interrupt) or 'Ctrl-C'}")
        return 130
    except BrokenPipeError:
        return 1
    except OSError as error:
        warn(f"surg: {preflight.sentence(error)}")
        return 1


if __name__ == "__main__":
    sys.exit(main())
