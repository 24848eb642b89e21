"""Mutated messages for a server in a process of its own: does it crash or hang, does its memory stay as it was?

    python -m tests.soak.mutated_messages --count 1000000

In turns: a connection carries calls with wrong contents, then a ping that has to be answered; others carry a message
of changed bytes each, and are closed without a word. Ends with status 1 where the server died or did not answer within
two minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tests.mutated import changed_bytes, mutated_calls, send
from tests.processes import resident_mib, state_of
from tests.simulating import simulate
from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api

MOST_CALLS = 200  # of a turn
STRANGERS = 50  # connections of a turn that carry changed bytes
LOOKS = 20  # at the memory, in all


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as (server, port):
        try:
            status = soak(server, port, asked.count, random.Random(asked.seed))
        except (TimeoutError, ConnectionRefusedError) as error:
            print(f"the server did not answer ({error!r}); it is {state_of(server.pid)}, {server.poll()}")
            status = 1
    sys.exit(status)


@contextlib.contextmanager
def serving(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A server that writes whatever it says, and records, into a folder."""
    said = folder / "said"
    options = ["serve", "--port", "0", "--recordings", str(folder)]
    with said.open("wb") as file:
        server = subprocess.Popen([sys.executable, "-m", "uavaccel", *options], stdout=file, stderr=file)
    clock = MonotonicClock()
    while not (listening := re.search(r":(\d+)[^\n]*\n", said.read_text())) and server.poll() is None:
        clock.sleep_until(clock.now_ns() + 50_000_000)
    assert listening is not None, said.read_text()
    try:
        yield server, int(listening[1])
    finally:
        server.terminate()
        server.wait()
        print(
            f"it said {len(said.read_text().splitlines())} lines, at last:",
            *said.read_text().splitlines()[-3:],
            sep="\n",
        )


def soak(server: subprocess.Popen[bytes], port: int, count: int, choose: random.Random) -> int:
    """Send so many, say how the memory goes, and 1 if the server is not there any more."""
    calls, clock = mutated_calls(Api(simulate(), render=False), choose), MonotonicClock()
    sent, due, longest_ns, start_ns = 0, 0, 0, clock.now_ns()
    while sent < count:
        if sent >= due:
            due += count // LOOKS
            print(
                f"{sent} sent: {resident_mib(server.pid):.1f} MiB; longest answer {longest_ns / 1e9:.2f} s", flush=True
            )
        batch = list(itertools.islice(calls, choose.randint(0, MOST_CALLS)))
        strange = [changed_bytes(next(calls), choose) for _ in range(STRANGERS)]
        begun_ns = clock.now_ns()
        send(port, batch, strange)
        longest_ns = max(longest_ns, clock.now_ns() - begun_ns)
        sent += len(batch) + len(strange)
    took_s = (clock.now_ns() - start_ns) / NS_PER_S
    print(f"{sent} sent in {took_s:.0f} s: {resident_mib(server.pid):.1f} MiB; longest answer {longest_ns / 1e9:.2f} s")
    return int(server.poll() is not None)


if __name__ == "__main__":
    main()
