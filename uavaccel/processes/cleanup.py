"""Removal of what killed runs leave behind: joblib's semaphores and shared memory, temporary folders of flights."""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
OF_JOBLIB = re.compile(r"(?:sem\.loky-|joblib_memmapping_folder_)(\d+)[-_]")


def remove_orphaned_files(folder: Path = SHARED_MEMORY, named_by: re.Pattern[str] = OF_JOBLIB) -> None:
    """Remove this user's files in `folder` whose process has ended; nothing happens without such a folder.

    `named_by` matches the names of such files; its first group is the id of the process.
    """
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        named = named_by.match(path.name)
        with suppress(OSError):  # another run clears it too
            if named is None or path.stat().st_uid != os.getuid() or _alive(int(named[1])):
                continue
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another's
        pass
    return True
