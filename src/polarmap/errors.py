"""The package's own exceptions; each message is one line that names what is wrong and what to do."""


class PolarmapError(Exception):
    """Base class: something failed that is neither a bug nor bad input (a full disk, say). Exit status 1."""

    exit_status = 1


class InputError(PolarmapError):
    """What the user gave cannot be used: a file, a value, an array. Exit status 2."""

    exit_status = 2


class NothingMapped(PolarmapError):
    """A run came to its end, and there is no surface."""
