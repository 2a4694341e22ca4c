"""What the sources share that read through FFmpeg (PyAV)."""

from __future__ import annotations

import errno
from typing import Any

import av

from surg_perception.capture.picture_source import SourceError

av.logging.set_level(av.logging.FATAL)


def open_input(where: str, path: str, **options: Any) -> Any:
    """Open a container.

    Args:
        where: For the error: the source as the user stated it.
        path: File or device.
        options: Of ``av.open``.

    Raises:
        SourceError: With a code for the reason.
    """
    try:
        return av.open(path, **options)
    except (OSError, av.error.FFmpegError) as error:
        raise refusal(where, error) from error


def decode_at_once(container: Any) -> None:
    """Decode each picture when it comes: FFmpeg's frame threads would hold some back."""
    container.streams.video[0].thread_type = "SLICE"


def refusal(where: str, error: Exception) -> SourceError:
    """An error of the system or of FFmpeg, with its cure."""
    number = getattr(error, "errno", None) or 0
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return SourceError(
            "no_device",
            f"{where}: there is no such device or file; plug the device in. v4l2-ctl "
            "--list-devices, or ls /dev/v4l/by-id, lists what is there",
        )
    if number == errno.EBUSY:
        return SourceError(
            "busy",
            f"{where}: the device is busy; close the other program that reads it (fuser -v "
            "DEVICE names it)",
        )
    if number in (errno.EACCES, errno.EPERM):
        return SourceError(
            "no_permission",
            f"{where}: no permission to read it; add yourself to the group 'video' (sudo usermod "
            "-aG video $USER), then log in again",
        )
    if number in (errno.EINVAL, errno.ENOTTY) or isinstance(error, av.error.InvalidDataError):
        return SourceError(
            "wrong_format",
            f"{where}: the device or file does not have this size, rate or format "
            f"({_reason(error)}); v4l2-ctl -d DEVICE --list-formats-ext lists what a device has",
        )
    return SourceError("failed", f"{where}: {_reason(error)}")


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
