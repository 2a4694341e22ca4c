"""The exceptions of this library."""


class EpisodeError(Exception):
    """A recording that cannot be written or read.

    The message says what was wrong, where (file, line, column), what is allowed and what to do.
    """


class NoMotionError(EpisodeError):
    """A recording in which no motion was commanded."""


class ReferenceSetError(Exception):
    """A reference set that cannot be read; the message says what, where, and what is needed."""
