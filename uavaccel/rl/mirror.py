"""The lane is symmetric on average: what is seen and done, turned left to right."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch as th


def turned_actions(headings_deg: Sequence[float]) -> list[int]:
    """For each action that which it is in a mirror: the number of the opposite heading."""
    headings = list(headings_deg)
    return [headings.index(-heading) for heading in headings]


def rated_both_ways(
    rate: Callable[[th.Tensor], th.Tensor], seen: th.Tensor, turned: Sequence[int]
) -> th.Tensor:
    """Mean of the ratings (n, actions) of what is seen (n, ..., columns), and of its mirror image, turned back."""
    both = rate(th.cat([seen, seen.flip(-1)]))
    count = seen.shape[0]  # not len(): the exporter to ONNX would take it for fixed
    straight, mirrored = both[:count], both[count:]
    return (straight + mirrored[:, list(turned)]) / 2
