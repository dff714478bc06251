"""The base of every error that a user can cause."""


class ClunkError(Exception):
    """An error that a user can cause and mend: its text says what happened, where, and what to do about it."""
