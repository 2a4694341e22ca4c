"""The exceptions of this library, and what other libraries say of damaged files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

LONGEST_WORDS = 200
"""Characters of another library's message that are told: some repeat the file."""


class EpisodeError(Exception):
    """A recording that cannot be written or read.

    The message says what was wrong, where (file, line, column), what is allowed and what to do.
    """


def words_of(problem: Exception, folder: object) -> str:
    """An error as the reason why a recording was left out; it names the recording's folder.

    An exception that is no ``EpisodeError`` comes from a defect or a library: one recording shall
    not end the work on all, so it is told with its type.
    """
    text = str(problem) if isinstance(problem, EpisodeError) else _typed(problem)
    return text if str(folder) in text else f"{folder}: {text}"


def _typed(problem: Exception) -> str:
    return f"{type(problem).__name__}: {_plain(problem)}"


def _plain(problem: Exception) -> str:
    """What another library says, for people: one short line, without control characters."""
    if isinstance(problem, MemoryError):
        return "it needs more memory than one recording may take"
    if isinstance(problem, UnicodeError):
        return "it has bytes that are no text where text is needed"
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(problem).split()))
    if not line or isinstance(problem, (AssertionError, IndexError, KeyError, TypeError)):
        return f"its parts do not fit together: {line or type(problem).__name__}"[:LONGEST_WORDS]
    return line if len(line) <= LONGEST_WORDS else f"{line[:LONGEST_WORDS]} …"


@contextlib.contextmanager
def telling(file: Path, words: str) -> Iterator[None]:
    """Turn whatever a library raises over a file into an ``EpisodeError``: file, words, why."""
    try:
        yield
    except EpisodeError:
        raise
    except Exception as problem:  # of any kind: libraries trust the lengths in a file
        raise EpisodeError(f"{file}: {words} ({_plain(problem)})") from None


class NoMotionError(EpisodeError):
    """A recording in which no motion was commanded."""


class ReferenceSetError(Exception):
    """A reference set that cannot be read; the message says what, where, and what is needed."""
