"""A lock of a folder for one process at a time, which the system releases however that process ends."""

from __future__ import annotations

import errno
import os
import sys
import weakref
from pathlib import Path

from uavaccel.errors import UserError

_NO_LOCKS = (errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EBADF)


class FolderLock:
    """Locks an existing folder as long as this object exists. Raises UserError if another process has locked it.

    Nothing is written into the folder. On Windows, and on file systems without locks, it has no effect.
    """

    def __init__(self, folder: Path) -> None:
        if sys.platform == "win32":
            return
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        weakref.finalize(self, os.close, descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{folder}: another process is flying this run; let it end, or stop it, before --resume"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise


_HELD: weakref.WeakValueDictionary[Path, FolderLock] = weakref.WeakValueDictionary()


def lock_of(folder: Path) -> FolderLock:
    """Return this process's lock of a folder, which is shared within it. Raises UserError as `FolderLock` does."""
    place = folder.resolve()
    lock = _HELD.get(place)
    if lock is None:
        lock = _HELD[place] = FolderLock(folder)
    return lock
