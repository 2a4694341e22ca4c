"""A policy's program in a process of its own that can reach nothing of the simulator.

bubblewrap gives it namespaces of its own: no network (so no ROS master and no topics), no other
process, no shared memory, an empty environment, and a file system that holds Debian, the virtual
environment, the policy's own files and one socket. The packages of the simulator are not there.
"""

from __future__ import annotations

import hashlib
import importlib
import re
import resource
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from surg_cli.host import paths
from surg_cli.host.terminal import CliError
from surg_recording import file_io

PACKAGES = ("surg_policy_client", "surg_learn", "surg_core")
"""What a policy may import of the platform: its own side, and kinematics."""
SYSTEM = ("/usr", "/bin", "/sbin", "/lib", "/lib64", "/etc/alternatives", "/etc/ld.so.cache")
_HIDDEN = re.compile(r"(^|/)(\.[^/]|__pycache__)")
"""Such as .git, which change without the policy."""
SOCKET = "/run/policy.socket"
"""Where the program finds its server: the same in each run, as its last words may name it."""
SCRATCH_BYTES = 64 << 20
"""What it may write into its /tmp, and into one file [bytes]; the disk is not filled."""
INSTALL = "apt install bubblewrap (./surg dev setup --all does), or start the policy yourself and"
INSTALL += " name the address at which it looks for its server"


@dataclass(frozen=True)
class Program:
    """A policy's program.

    Attributes:
        script: Its .py file.
        words: Of its command line; a file or folder among them is readable for it.
    """

    script: Path
    words: tuple[str, ...] = ()

    @classmethod
    def of(cls, given: str, keep: Path = paths.ROOT) -> Program:
        """From words such as ``policy.py --weights best.npz``; cards go to ``keep``.

        Raises:
            CliError: There is no such file, or its folder holds the platform or the cards.
        """
        try:
            first, *words = [given] if Path(given).is_file() else shlex.split(given)
        except ValueError:  # no word, or a quote that is left open
            first, words = given, []
        script = Path(first).resolve()
        if script.suffix != ".py" or not script.is_file():
            raise CliError(f"{given}: no such .py file; ./surg policy new NAME writes one", 2)
        words = [str(Path(word).resolve()) if Path(word).exists() else word for word in words]
        program = cls(script, tuple(words))
        for folder in (script.parent, *map(Path, program.files)):
            for what, path in (("the platform", paths.ROOT), ("--keep", keep.resolve())):
                if path.is_relative_to(folder):
                    raise CliError(
                        f"{given}: {folder} holds {what} too, and the policy could read it; put "
                        "the policy's files into a folder of their own",
                        2,
                    )
        return program

    @property
    def files(self) -> list[str]:
        """Files and folders that its words name."""
        return [word for word in self.words if word.startswith("/") and Path(word).exists()]

    @property
    def sha256(self) -> str:
        """Of its folder but what is hidden there, of its words, and of the files that they name."""
        found = hashlib.sha256()
        for root in (self.script.parent, *map(Path, self.files)):
            for file in (root, *sorted(root.rglob("*"))):
                if file.is_file() and not _HIDDEN.search(str(file.relative_to(root))):
                    found.update(f"{file.name}\0{file_io.file_hash(file)}\0".encode())
        named = [Path(word).name if word in self.files else word for word in self.words]
        found.update("\0".join([self.script.name, *named]).encode())
        return found.hexdigest()


def problem() -> str:
    """Why no program can be shut in on this machine; empty: one can."""
    try:
        done = subprocess.run(
            ["bwrap", "--unshare-all", "--ro-bind", "/", "/", "true"],
            capture_output=True,
            text=True,
            check=False,
        )
    except FileNotFoundError:
        return f"a policy cannot be shut in: bubblewrap is missing; {INSTALL}"
    said = done.stderr.strip()
    return f"a policy cannot be shut in: {said}; {INSTALL}" if done.returncode else ""


def start(program: Program, folder: Path) -> subprocess.Popen[bytes]:
    """Start a program; what it prints goes to ``output`` in the folder.

    Args:
        program: The policy's.
        folder: With the server's ``socket``; the program sees nothing else of it.
    """
    argv = ["bwrap", "--unshare-all", "--die-with-parent", "--new-session", "--clearenv"]
    for path in SYSTEM:
        argv += ["--ro-bind-try", path, path]
    argv += ["--proc", "/proc", "--dev", "/dev", "--size", str(SCRATCH_BYTES), "--tmpfs", "/tmp"]
    for name, value in _environment().items():
        argv += ["--setenv", name, value]
    for path in [str(paths.VENV), *_packages(), str(program.script.parent), *program.files]:
        argv += ["--ro-bind", path, path]
    argv += ["--bind", str(folder / "socket"), SOCKET, "--chdir", str(program.script.parent), "--"]
    argv += [str(paths.VENV_PYTHON), "-s", str(program.script), "--server", f"ipc://{SOCKET}"]
    with (folder / "output").open("wb") as output:
        return subprocess.Popen(
            [*argv, *program.words],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={"PATH": "/usr/bin:/bin"},
            close_fds=True,
            preexec_fn=_limit,
        )


def last_words(folder: Path) -> str:
    """The last line that a program printed."""
    try:
        with (folder / "output").open("rb") as output:
            output.seek(max(0, (folder / "output").stat().st_size - 4096))
            lines = output.read().decode("utf-8", "replace").split("\n")
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")[:300]


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (SCRATCH_BYTES, SCRATCH_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _environment() -> dict[str, str]:
    """All of a program's: one thread for linear algebra, so that a run repeats bit for bit."""
    threads = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    return {
        "PATH": f"{paths.VENV / 'bin'}:/usr/bin:/bin",
        "HOME": "/tmp",
        "LC_ALL": "C.UTF-8",
        "PYTHONPATH": str(_modules()),
        "PYTHONUNBUFFERED": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONHASHSEED": "0",
        **dict.fromkeys(threads, "1"),
    }


def _modules() -> Path:
    return paths.DEVEL / f"lib/python{sys.version_info.major}/dist-packages"


def _packages() -> list[str]:
    """Folders and libraries of `PACKAGES`."""
    found = [str(path) for path in (paths.DEVEL / "lib").glob("libsurg_core*.so*")]
    for name in PACKAGES:
        # catkin's folder of the built ones, which a worker's sys.path may hide, and the sources.
        found += [str(_modules() / name), *importlib.import_module(name).__path__]
    return sorted(set(found))
