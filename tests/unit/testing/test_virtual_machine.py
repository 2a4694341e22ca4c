"""What the virtual machine of the tier `vm` is made of, as far as no machine is needed."""

import shutil
from pathlib import Path

import pytest

from helpers.machines import vm


def test_an_archive_is_what_the_kernel_reads() -> None:
    files = {"init": b"#!x", "bin/busybox": b"12345", "modules/a.ko": b""}
    archive, found = vm.cpio(files), {}
    at = 0
    while at < len(archive):
        assert archive[at : at + 6] == b"070701"
        mode, size, length = (
            int(archive[at + 6 + 8 * i : at + 14 + 8 * i], 16) for i in (1, 6, 11)
        )
        name = archive[at + 110 : at + 110 + length - 1].decode()
        data_at = at + (110 + length + 3) // 4 * 4
        if mode & 0o100000:
            found[name] = archive[data_at : data_at + size]
            assert mode & 0o111
        at = data_at + (size + 3) // 4 * 4
    assert found == files


def test_a_missing_kernel_or_program_says_what_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vm, "FOLDER", tmp_path)
    with pytest.raises(vm.MissingError, match=r"(?s)no Debian kernel.*dpkg-deb -x"):
        vm.run(["/bin/true"], {}, 1.0)
    (tmp_path / "kernel/boot").mkdir(parents=True)
    (tmp_path / "kernel/boot/vmlinuz-6.1.0-56-amd64").touch()
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(vm.MissingError, match=r"install -y .* busybox-static"):
        vm.run(["/bin/true"], {}, 1.0)
