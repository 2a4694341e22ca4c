"""`.venv-bench`: the libraries to compare with, from pinned lock files, apart from the platform's.

Nothing here touches `.venv`. Without a network, or after a failure, the benchmark runs without
them and says so.
"""

from __future__ import annotations

import shutil
import tarfile
from dataclasses import dataclass
from pathlib import Path

from surg_cli.host import logged, paths
from surg_cli.host.terminal import CliError, Progress, say, warn

VENV = paths.ROOT / ".venv-bench"
LOCK = paths.ROOT / "benchmarks" / "requirements.lock"
SOURCES = paths.ROOT / "benchmarks" / "sources.lock"
LOG = paths.STATE / "logs" / "bench.log"


@dataclass(frozen=True)
class Libraries:
    """Where they are; None where one is not to be had.

    Attributes:
        python: Interpreter of `.venv-bench`.
        packages: Its site-packages, with the C++ headers of eiquadprog and ProxQP.
        ruckig: Ruckig's sources.
    """

    python: Path | None = None
    packages: Path | None = None
    ruckig: Path | None = None


def run(argv: list[str], title: str) -> None:
    """Run one step with its output in the log.

    Args:
        argv: Program and arguments.
        title: Shown while it runs.

    Raises:
        CliError: When it fails.
    """
    with Progress(title) as progress:
        logged.run(argv, LOG, progress)


def installed() -> Libraries:
    """What is there, nothing fetched."""
    if not _stamp().exists() or _stamp().read_text("utf-8") != _wanted():
        return Libraries()
    packages = next(iter(VENV.glob("lib/python3*/site-packages")), None)

    def unpacked(name: str) -> Path | None:
        return next(iter(sorted((VENV / "sources").glob(f"{name}-*/"))), None)

    python = VENV / "bin" / "python"
    return Libraries(python, packages, unpacked("ruckig"))


def install() -> Libraries:
    """Make `.venv-bench` and fill it from both lock files, unless that was done before."""
    there = installed()
    if there.python is not None:
        return there
    say(f"libraries to compare with: {VENV} (log: {LOG})")
    shutil.rmtree(VENV, ignore_errors=True)
    python = str(VENV / "bin" / "python")
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    sources = VENV / "sources"
    strict = ["--no-deps", "--require-hashes"]
    binary = ["--only-binary", ":all:", "-r", str(LOCK)]
    source = ["--no-build-isolation", "--no-binary", ":all:", "-r", str(SOURCES)]
    steps = {
        "make .venv-bench": [str(paths.SYSTEM_PYTHON), "-m", "venv", str(VENV)],
        "install libraries": [*pip, "install", *strict, *binary],
        "fetch sources": [*pip, "download", *strict, *source, "--dest", str(sources)],
    }
    try:
        for title, argv in steps.items():
            run(argv, title)
    except CliError as problem:
        warn(f"bench: going on without the libraries of others; {problem}")
        return Libraries()
    for archive in sorted(sources.glob("*.tar.gz")):
        with tarfile.open(archive) as tar:
            tar.extractall(sources, [member for member in tar if _wanted_source(member)])
    paths.write_text(_stamp(), _wanted())
    return installed()


def _wanted_source(member: tarfile.TarInfo) -> bool:
    """C and C++ files inside the archive's own folder."""
    path = Path(member.name)
    inside = not path.is_absolute() and ".." not in path.parts
    return member.isfile() and inside and path.suffix in (".c", ".h", ".cpp", ".hpp")


def _stamp() -> Path:
    return VENV / "lock.sha256"


def _wanted() -> str:
    return paths.file_digest(LOCK) + paths.file_digest(SOURCES)
