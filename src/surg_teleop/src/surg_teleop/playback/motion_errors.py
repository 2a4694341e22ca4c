"""What can be wrong with a motion, said so that a person can put it right."""


class MotionError(ValueError):
    """A motion that must not be played: says which file, where, which value and what is allowed."""
