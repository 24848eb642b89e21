"""A folder held by one process at a time; the system lets go of it when that process ends, however it ends."""

from __future__ import annotations

import errno
import os
import sys
import weakref
from pathlib import Path

from uavaccel.errors import UserError

_NO_LOCKS = (errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EBADF)


class FolderLock:
    """Holds a folder that exists, for as long as this object lives. Raises UserError if another process holds it.

    Nothing is written into the folder. On Windows, and where the file system knows no locks, nobody is kept out.
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


def hold(folder: Path) -> FolderLock:
    """The lock of a folder, one for all who ask in this process. Raises UserError as `FolderLock`."""
    place = folder.resolve()
    lock = _HELD.get(place)
    if lock is None:
        lock = _HELD[place] = FolderLock(folder)
    return lock
