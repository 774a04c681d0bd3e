"""Exceptions with the one line of the command line."""


class PalpateError(Exception):
    """Base of the errors of this package: one line with the file, the problem and the fix."""


class InputError(PalpateError, ValueError):
    """The input cannot be used; the command line exits with code 2."""


class SolveError(PalpateError, RuntimeError):
    """The input is valid, but the work failed; the command line exits with code 1."""
