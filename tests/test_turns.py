"""Who has been served least, and asks for least, comes first; nobody saves up turns, and nobody loses them."""

from __future__ import annotations

from dataclasses import dataclass

from uavaccel.wire.fair_queue import DurationEstimates, FairQueue


@dataclass(eq=False)
class Client:
    cost_ns: int
    served_ns: int = 0
    has_turn: bool = False


def serve(turns: FairQueue[Client], rounds: int) -> list[Client]:
    """Each that is served asks again."""
    served = []
    for _ in range(rounds):
        client = turns.next()
        client.served_ns += client.cost_ns
        served.append(client)
        turns.add(client, begins=False)
    return served


def test_time_is_shared_evenly_whatever_requests_cost() -> None:
    turns: FairQueue[Client] = FairQueue(lambda client: client.cost_ns)
    cheap, costly = Client(1), Client(10)
    turns.add(cheap)
    turns.add(costly)
    serve(turns, 1100)
    assert cheap.served_ns == 1000
    assert abs(cheap.served_ns - costly.served_ns) <= 100


def test_one_small_request_waits_for_none_of_a_crowds_large_ones() -> None:
    costs = DurationEstimates(["small", "large"])
    turns: FairQueue[Client] = FairQueue(
        lambda client: costs.expected_ns("large" if client.cost_ns > 9 else "small", False)
    )
    good, crowd = Client(1), [Client(1000) for _ in range(500)]
    for client in crowd:  # while nobody knows what they will take
        turns.add(client)
    good.served_ns = 50  # it has been there for long
    turns.add(good)
    first = serve(turns, 1)
    costs.took("large", False, 1000)
    assert first[0] in crowd
    for _ in range(100):
        assert serve(turns, 1) == [good], "those that are known by now come later, though they came before"
    assert good.served_ns == 150


def test_who_begins_to_ask_has_no_claim_on_time_that_is_past() -> None:
    turns: FairQueue[Client] = FairQueue(lambda client: client.cost_ns)
    old, new = Client(1), Client(1)
    turns.add(old)
    serve(turns, 1000)
    turns.add(new)
    assert serve(turns, 100).count(old) == 50
    turns.next()
    turns.next()
    third = Client(1)
    turns.add(third)  # nobody else asks
    serve(turns, 1)
    turns.add(old)
    assert serve(turns, 100).count(old) >= 45


def test_what_is_expected_follows_and_outliers_change_little() -> None:
    costs = DurationEstimates(["ping"])
    assert costs.expected_ns("ping", False) == 0
    costs.took("ping", False, 100)
    costs.took("ping", False, 1_000_000)
    assert costs.expected_ns("ping", False) <= 150
    for _ in range(60):
        costs.took("ping", False, 10_000)
    assert costs.expected_ns("ping", False) > 9_000
    costs.took("made up", False, 100)
    assert costs.expected_ns("made up", False) == 0
