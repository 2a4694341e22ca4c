"""Builds v4l2loopback for the virtual machine's kernel; Debian has it as source only.

Needs no root: the packages are unpacked beside the kernel, none is installed. ::

    PYTHONPATH=tests:tools python3 -m helpers.machines.vm_loopback_module
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from helpers.machines import vm

NAME = "v4l2loopback"


def missing() -> str:
    """Why the module is not there, and what to type; empty: it is."""
    try:
        kernel = vm.kernel()
    except vm.MissingError as error:
        return str(error)
    if _module(kernel).is_file():
        return ""
    return (
        f"{_module(kernel)} is missing. Type:\n"
        "  PYTHONPATH=tests:tools python3 -m helpers.machines.vm_loopback_module"
    )


def build() -> Path:
    """Fetch the kernel's headers and the module's source, compile; returns the module.

    Raises:
        OSError, subprocess.CalledProcessError: A package or the compiler is missing.
    """
    kernel = vm.kernel()
    release = kernel.name.removeprefix("vmlinuz-")
    version, _, flavour = release.rpartition("-")
    folder = vm.FOLDER / f"headers-{release}"
    folder.mkdir(parents=True, exist_ok=True)
    packages = (
        f"linux-headers-{release}",
        f"linux-headers-{version}-common",
        f"linux-kbuild-{'.'.join(release.split('.')[:2])}",
        "v4l2loopback-dkms",
    )
    subprocess.run(["apt-get", "download", *packages], cwd=folder, check=True)
    for package in sorted(folder.glob("*.deb")):
        subprocess.run(["dpkg-deb", "-x", package.name, "."], cwd=folder, check=True)
    sources = folder / "usr" / "src"
    makefile = sources / f"linux-headers-{version}-{flavour}" / "Makefile"
    # It includes the other package's by an absolute path.
    text = makefile.read_text("utf-8").replace("include /usr/src/", f"include {sources}/")
    makefile.write_text(text, "utf-8")
    source = next(sources.glob(f"{NAME}-*"))
    subprocess.run(["make", "-C", makefile.parent, f"M={source}", "modules"], check=True)
    made = _module(kernel)
    made.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source / f"{NAME}.ko", made)
    return made


def _module(kernel: Path) -> Path:
    release = kernel.name.removeprefix("vmlinuz-")
    return kernel.parents[1] / "lib" / "modules" / release / "extra" / f"{NAME}.ko"


if __name__ == "__main__":
    try:
        print(build())
    except (vm.MissingError, OSError, subprocess.CalledProcessError, StopIteration) as error:
        sys.exit(str(error))
