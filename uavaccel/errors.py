"""Errors that users can mend: one clear line each, and an exit status."""

import difflib
import errno
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

MOST_LISTED = 60  # known words that a mistake is answered with


class UserError(Exception):
    """A mistake in the input (a file, a key, a value, a port): one line that says what would be right.

    The command line prints the line without a traceback and exits with `exit_status`.
    """

    exit_status = 1


class UsageError(UserError):
    """A wrong usage: options that contradict each other, or a combination that is refused."""

    exit_status = 2


class Interrupted(UserError):
    """An interruption by Ctrl-C; the line says how to continue."""

    exit_status = 130


_SYSTEM_REFUSES = {
    *(errno.EACCES, errno.EDQUOT, errno.EEXIST, errno.EFBIG, errno.EIO, errno.EISDIR, errno.ELOOP),
    *(errno.EMFILE, errno.ENAMETOOLONG, errno.ENFILE, errno.ENOENT, errno.ENOSPC, errno.ENOTDIR),
    *(errno.ENOTEMPTY, errno.EPERM, errno.EPIPE, errno.EROFS),
}


def mistake_of(error: BaseException) -> UserError | None:
    """Return the user's mistake behind an exception; None for an error of this program.

    What the system refuses is the user's to mend: a full disk, a folder that is not writable, a lack of memory.
    """
    if isinstance(error, UserError):
        return error
    if isinstance(error, OSError) and error.errno in _SYSTEM_REFUSES:
        if name := error.filename2 or error.filename:  # of a file that is renamed, its new one
            return UserError(f"{name}: {error.strerror}")
        return UserError(f"cannot write: {error.strerror}")  # only opening a file reports its name
    if isinstance(error, ValueError) and str(error) == "embedded null byte":  # of a path, which it does not name
        return UserError("the name of a file has a null byte in it")
    if isinstance(error, MemoryError):
        return UserError("not enough memory: fewer environments, a smaller buffer_size, or fewer --jobs")
    return None


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Raise a UserError that names the file where the system refuses to write it, which its own error may not."""
    try:
        yield
    except OSError as error:
        if error.errno not in _SYSTEM_REFUSES:
            raise
        more = "; make room" if error.errno == errno.ENOSPC else ""
        raise UserError(f"{error.filename2 or error.filename or path}: {error.strerror}{more}") from error


def suggestion(word: str, known: Collection[str]) -> str:
    """Suggest what an unknown word may mean: a known one that is close to it, or all of them, or some of very many."""
    if close := difflib.get_close_matches(word, known, n=1):
        return f"did you mean {close[0]!r}?"
    listed = [*known] if len(known) <= MOST_LISTED else [*islice(known, 3), f"... ({len(known)} in all)"]
    return f"known: {', '.join(listed)}"
