"""The exceptions of this library."""


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
    return f"{type(problem).__name__}: {problem}"


class NoMotionError(EpisodeError):
    """A recording in which no motion was commanded."""


class ReferenceSetError(Exception):
    """A reference set that cannot be read; the message says what, where, and what is needed."""
