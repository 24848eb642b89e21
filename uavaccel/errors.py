"""Errors that are the user's to mend: one clear line each, and an exit status."""


class UserError(Exception):
    """A mistake in the input (a file, a key, a value, a port): one line that says what would be right.

    The command line prints the line without a traceback and exits with `exit_status`.
    """

    exit_status = 1


class UsageError(UserError):
    """A call that cannot be meant: options that contradict each other, or a combination that is refused."""

    exit_status = 2


class Interrupted(UserError):
    """Stopped by Ctrl-C; the line says how to go on."""

    exit_status = 130
