"""`./surg dev bench [NAME]`: runs a program in `benchmarks/`."""

from __future__ import annotations

import argparse
import subprocess

from surg_cli.host import environment, paths
from surg_cli.host.terminal import CliError, say


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Declare the options."""
    parser.add_argument("name", nargs="?", help="benchmark to run (default: list them)")
    parser.add_argument("rest", nargs=argparse.REMAINDER, help="its own options")


def main(options: argparse.Namespace, command: str) -> int:
    """List the benchmarks, or run one."""
    files = {p.stem.removeprefix("bench_"): p for p in paths.ROOT.glob("benchmarks/bench_*.py")}
    if options.name is None:
        say("benchmarks (./surg dev bench NAME [options], --help says more):")
        for name, path in sorted(files.items()):
            say(f"  {name}: {first_line(path.read_text('utf-8'))}")
        return 0
    if options.name not in files:
        raise CliError(f"no benchmark {options.name!r}; there are: {', '.join(sorted(files))}", 2)
    env = environment.for_nodes()
    env["PYTHONPATH"] = f"{paths.ROOT / 'tools'}:{env.get('PYTHONPATH', '')}".rstrip(":")
    argv = [str(paths.VENV_PYTHON), str(files[options.name]), *options.rest]
    return subprocess.run(argv, env=env, check=False).returncode


def first_line(source: str) -> str:
    """First line of a program's docstring."""
    return source.lstrip().removeprefix('"""').splitlines()[0].strip().removesuffix('"""')
