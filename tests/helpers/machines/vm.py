"""A small virtual machine: Debian's own kernel, the host's files read-only, real virtual devices.

Without hardware, KVM or root beyond what QEMU needs: the processor is emulated (about ten times
slower), so times inside are stated in the guest's clock and prove order, not speed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from surg_cli.host import paths

FOLDER = paths.STATE / "vm"
# In the order in which they must be loaded; what a kernel has built in is left out.
MODULES = (
    "virtio_ring",
    "virtio",
    "virtio_pci_legacy_dev",
    "virtio_pci_modern_dev",
    "virtio_pci",
    "netfs",
    "fscache",
    "9pnet",
    "9pnet_virtio",
    "9p",
    "evdev",
    "uinput",
)
INIT = """\
#!/bin/busybox sh
/bin/busybox mkdir -p /proc /host
/bin/busybox mount -t proc proc /proc
for module in {modules}; do /bin/busybox insmod /modules/$module.ko || echo "no $module"; done
/bin/busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=524288 host /host ||
  /bin/busybox poweroff -f
/bin/busybox mount -t proc proc /host/proc
/bin/busybox mount -t sysfs sys /host/sys
/bin/busybox mount -t devtmpfs dev /host/dev
/bin/busybox mount -t tmpfs run /host/run
/bin/busybox chroot /host /usr/bin/env -i {words}
echo "guest: exit status $?"
/bin/busybox poweroff -f
"""


class MissingError(RuntimeError):
    """What a virtual machine needs is not on this machine; says what to type."""


def run(
    words: Sequence[str], env: dict[str, str], timeout_s: float, modules: Sequence[str] = ()
) -> tuple[int, str]:
    """Boots, runs a program of the host's files in the guest, powers off.

    Args:
        words: Its command line; the first word is an absolute path.
        env: Its whole environment; values without white space.
        timeout_s: Wall clock, after which the machine is taken away.
        modules: Further modules of the kernel, in the order in which they must be loaded.

    Returns:
        The program's exit status (-1: it did not come to its end), and all that was said.

    Raises:
        MissingError: QEMU, busybox or the kernel is missing.
    """
    image = kernel()
    line = [*(f"{name}={value}" for name, value in env.items()), *words]
    assert not any(" " in word for word in line), "words go through a shell"
    wanted = (*MODULES, *modules)
    found = {name: next(image.parents[1].rglob(f"{name}.ko"), None) for name in wanted}
    there = {name: path for name, path in found.items() if path is not None}
    init = INIT.format(modules=" ".join(there), words=" ".join(line))
    initrd = FOLDER / f"initrd.{os.getpid()}"
    files = {"init": init.encode(), "bin/busybox": Path(_program("busybox")).read_bytes()}
    files |= {f"modules/{name}.ko": path.read_bytes() for name, path in there.items()}
    initrd.write_bytes(cpio(files))
    argv = [_program("qemu-system-x86_64"), "-accel", "tcg,thread=multi", "-cpu", "Nehalem"]
    argv += ["-smp", "1", "-m", "1024", "-nodefaults", "-no-reboot", "-display", "none"]
    argv += ["-serial", "stdio", "-kernel", str(image), "-initrd", str(initrd)]
    argv += ["-append", "console=ttyS0 quiet panic=-1 no_timer_check"]
    share = "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"
    try:
        done = subprocess.run(
            [*argv, "-virtfs", share],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout_s,
            check=False,
        )
        said = done.stdout.decode(errors="replace")
    except subprocess.TimeoutExpired as late:
        said = (late.stdout or b"").decode(errors="replace") + "\nguest: not done in time"
    finally:
        initrd.unlink()
    mark = "guest: exit status "
    at = said.rfind(mark)
    return (int(said[at + len(mark) :].split()[0]) if at >= 0 else -1), said


def cpio(files: dict[str, bytes]) -> bytes:
    """An archive as the kernel reads it (format "newc"), every file executable.

    Args:
        files: Contents by path, without a leading slash.
    """
    folders = {str(parent) for name in files for parent in Path(name).parents} - {"."}
    entries = [(name, 0o040755, b"") for name in sorted(folders)]
    entries += [(name, 0o100755, data) for name, data in files.items()]
    entries.append(("TRAILER!!!", 0, b""))
    archive = b""
    for number, (name, mode, data) in enumerate(entries, 1):
        links = 1 if mode else 0
        fields = (number, mode, 0, 0, links, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0)
        head = b"070701" + b"".join(b"%08x" % field for field in fields) + name.encode() + b"\0"
        archive += _padded(head) + _padded(data)
    return archive


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def kernel() -> Path:
    """The newest kernel that lies extracted under FOLDER."""
    found = sorted(FOLDER.glob("**/boot/vmlinuz-*-amd64"), key=_age)
    if found:
        return found[-1]
    raise MissingError(
        f"no Debian kernel under {FOLDER}. Type:\n"
        f"  mkdir -p {FOLDER} && cd {FOLDER}\n"
        "  apt-get download $(apt-cache depends linux-image-amd64 | awk '/Depends/{print $2}')\n"
        "  dpkg-deb -x linux-image-*.deb kernel"
    )


def _age(path: Path) -> float:
    return path.stat().st_mtime


def _program(name: str) -> str:
    packages = {"busybox": "busybox-static", "qemu-system-x86_64": "qemu-system-x86"}
    path = shutil.which(name)
    if path is None:
        raise MissingError(
            f"{name} is missing. Type, as root:\n"
            f"  apt-get install -y --no-install-recommends {packages[name]}"
        )
    return path


if __name__ == "__main__":
    started = time.monotonic()
    status, text = run(["/bin/uname", "-a"], {}, 120.0)
    print(text, f"status {status}, {time.monotonic() - started:.1f} s")
