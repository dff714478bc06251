"""The bases of every error that a user can cause, and of every warning."""


class ClunkError(Exception):
    """An error that a user can cause and mend: its text says what happened, where, and what to do about it."""


class ClunkWarning(UserWarning):
    """A warning of what a user has probably not meant."""
