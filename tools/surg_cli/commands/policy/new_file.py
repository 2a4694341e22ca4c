"""`./surg policy new`, `./surg task new`: a file that runs, to begin with."""

from __future__ import annotations

import argparse
import keyword
from pathlib import Path

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, say

POLICIES = "src/surg_policy_bridge/client/src/surg_policy_client/policies"
SOURCES = {
    "policy": (f"{POLICIES}/skeleton.py", {"skeleton.py": "{file}"}),
    "task": (
        "examples/04_task.py",
        {
            "Step 4: a": "A",
            "examples/04_task.py": "{file}",
            "class Touch(": "class {kind}(",
            "Touch.home_cell": "{kind}.home_cell",
            '"touch"': '"{name}"',
        },
    ),
}
"""What is copied, and which of its words become the new name."""
NEXT = {"policy": "./surg run bgr --policy {file}", "task": "./surg run {file}"}


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.set_defaults(kind=parser.prog.split()[-2])  # of `./surg policy new`
    parser.add_argument("name", metavar="NAME", help="of the file, without .py, in this folder")


def main(options: argparse.Namespace, command: str) -> int:
    """Write the file and print how to run it."""
    kind, name = options.kind, options.name.removesuffix(".py")
    if not name.isidentifier() or keyword.iskeyword(name):
        raise CliError(
            f"{kind} {command} {options.name}: letters, digits and _ are allowed, a letter first", 2
        )
    file = Path(f"{name}.py")
    source, words = SOURCES[kind]
    text = (paths.ROOT / source).read_text("utf-8")
    camel = "".join(part.capitalize() for part in name.split("_"))
    for old, new in words.items():
        text = text.replace(old, new.format(file=file, name=name, kind=camel))
    try:
        with file.open("x", encoding="utf-8") as new_file:
            new_file.write(text)
    except FileExistsError:
        raise CliError(f"{file.absolute()} is there already: choose another name", 2) from None
    except OSError as error:
        raise CliError(f"{file.absolute()}: {error.strerror}", 2) from None
    say(f"{file.absolute()}\nrun it:  {NEXT[kind].format(file=file)}")
    return 0
