"""Machine code that belongs to the sources.

Numba's cache looks at the file of a cached function alone, not at those of the functions compiled into it: after a
change of the autopilot the hot loop would fly the old one. So each state of the sources has a cache of its own here.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[1]


def use_cache_of_the_sources() -> None:
    """Before numba is imported; server and worker processes inherit it."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "uavaccel").rglob("*.py")):
        source = path.read_bytes()
        if b"numba" in source:
            digest.update(source)
    cache = ROOT / ".pytest_cache" / f"numba-{digest.hexdigest()[:12]}"
    for other in cache.parent.glob("numba-*"):
        if other != cache:
            shutil.rmtree(other, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(cache)


use_cache_of_the_sources()
