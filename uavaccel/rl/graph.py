"""A gradient step as a CUDA graph, recorded once and then launched without Python between its kernels."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import torch as th

from uavaccel.kernels.recording import recording
from uavaccel.rl.replay import Batch

WARM_UPS = 3  # before recording, as PyTorch asks for


class GraphedStep:
    """`step(batch)` recorded with a first batch, whose shapes later batches must have.

    Recording leaves networks and optimizer unchanged. The optimizer has to be `capturable`, its learning rate a tensor.
    """

    def __init__(
        self, step: Callable[[Batch], None], networks: th.nn.Module, optimizer: th.optim.Optimizer, batch: Batch
    ) -> None:
        self._batch = Batch(*(each.clone() for each in batch))
        weights, moments = deepcopy(networks.state_dict()), deepcopy(optimizer.state_dict()["state"])
        side = th.cuda.Stream()
        side.wait_stream(th.cuda.current_stream())
        with th.cuda.stream(side):
            for _ in range(WARM_UPS):
                step(self._batch)
        th.cuda.current_stream().wait_stream(side)
        self._graph = th.cuda.CUDAGraph()
        optimizer.zero_grad(set_to_none=True)
        with recording(self._graph):
            step(self._batch)
        networks.load_state_dict(weights)
        _restore(optimizer, moments)

    def __call__(self, batch: Batch) -> None:
        for here, there in zip(self._batch, batch, strict=True):
            here.copy_(there)
        self._graph.replay()


def _restore(optimizer: th.optim.Optimizer, moments: dict[int, dict[str, th.Tensor]]) -> None:
    """Restore the optimizer's moments in place, since the graph has their addresses; new ones become zero."""
    parameters = [each for group in optimizer.param_groups for each in group["params"]]
    for number, parameter in enumerate(parameters):
        for name, value in optimizer.state[parameter].items():
            before = moments.get(number, {}).get(name)
            if before is None:
                value.zero_()
            else:
                value.copy_(before)
