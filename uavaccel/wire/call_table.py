"""Writes docs/airsim-calls.md: which of AirSim's calls are done, accepted or refused here.

python -m uavaccel.wire.call_table > docs/airsim-calls.md
"""

from __future__ import annotations

from uavaccel.wire.api import GROUPS
from uavaccel.wire.calls import WireCall

OWN = "uavaccel"  # prefix of the calls that are not AirSim's
HEAD = """# AirSim's calls

Every call of AirSim v1.8.1's Python client, by its name on the wire. *Done*: it does here what it does there.
*Accepted*: it is answered without effect, and the server names it once on its terminal. *Refused*: the caller gets an
error that names it. Made by `python -m uavaccel.wire.call_table`.
"""


def sections() -> dict[str, list[WireCall]]:
    """AirSim's calls by section, in the order of the code."""
    found: dict[str, list[WireCall]] = {}
    for group in GROUPS:
        calls = [call for call in group.calls.values() if not call.name.startswith(OWN)]
        if calls:
            found.setdefault(group.title, []).extend(calls)
    return found


def page() -> str:
    """Return the page in Markdown."""
    answers = [call.status for calls in sections().values() for call in calls]
    done, accepted, refused = (
        sum(answer.startswith(word) for answer in answers) for word in ("done", "accepted", "refused")
    )
    lines = [HEAD, f"Of {len(answers)} calls {done} are done, {accepted} accepted, {refused} refused."]
    for title, calls in sections().items():
        named: dict[str, list[str]] = {}
        for call in calls:
            named.setdefault(call.status, []).append(f"`{call.name}`")
        lines += ["", f"## {title}", "", *(f"- *{status}*: {', '.join(names)}" for status, names in named.items())]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
