"""Evolution strategy: learns the parameters of a network from returns alone, without gradients.

After Salimans et al., "Evolution strategies as a scalable alternative to reinforcement learning",
2017: with antithetic pairs x +- sigma e_i and the ranks u, centred to [-1/2, 1/2], of their returns
less the mean of the pair,

    g = sum_i (u_i+ - u_i-) e_i / (2 n sigma),

and a step of Adam along g. Both networks of a pair walk in the same drawn scene, whose difficulty
the mean takes out. All pairs walk at once, each network on a robot of its own, in one vector
environment or in several processes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.control.walk_actions import ACTIONS
from slot_core.robot import Array
from slot_lab.learning.network import NetworkShape
from slot_lab.learning.spaces import mirror_of
from slot_lab.learning.task import Task
from slot_lab.learning.vector_env import WalkVectorEnv
from slot_lab.workers import gather, workers

DECAYS, TINY = (0.9, 0.99), 1e-8  # of Adam
TEST_SEEDS = 1_000_000 + np.arange(16)  # of the scenes in which the mean network is tested


@dataclass(frozen=True)
class Evolution:
    """Settings of the strategy."""

    hidden: int = 8  # neurons, and as many mirror images
    pairs: int = 32
    sigma: float = 0.1
    rate: float = 0.02
    seed: int = 0
    step: float = 0.0  # s, longest time step of the simulation; 0: the level's
    threads: int = 1  # of a process
    test_every: int = 10  # generations


class Walks(NamedTuple):
    """Networks (m, p) to be tried, each in the scene of its seed."""

    task: Task
    evolution: Evolution
    parameters: Array
    seeds: NDArray[np.int64]  # (m,)


class Generation(NamedTuple):
    """What is known after a generation."""

    generation: int
    steps: int  # of the environment so far
    mean: float  # return of the pairs, per step
    test: float  # return of the mean network in the scenes of TEST_SEEDS, per step
    best: Array  # (p,) the network with the best test


def shape_of(task: Task, evolution: Evolution) -> NetworkShape:
    """Shape of the networks for a task: symmetric ones."""
    return NetworkShape(task.observed, evolution.hidden, ACTIONS[task.actions], mirror_of(task))


def returns(walks: Walks) -> Array:
    """Return (m,) of an episode with each network, per step of a whole episode."""
    task, evolution, parameters, seeds = walks
    env = _environment(task, len(seeds), evolution.step, evolution.threads)
    shape, found = shape_of(task, evolution), np.zeros(len(seeds))
    seen, _ = env.reset(seed=seeds.tolist())
    going = np.ones(len(seeds), dtype=bool)
    steps = round(task.duration / task.gaits.dt)
    for _ in range(steps):
        seen, reward, terminated, truncated, _ = env.step(shape.actions(parameters, seen))
        found += np.where(going, reward, 0.0)
        going &= ~(terminated | truncated)
    return found / steps


def spread(client: Any, parts: int) -> Callable[[Walks], Array]:
    """`returns` by the workers of a client of `dask.distributed`, in so many parts."""

    def call(walks: Walks) -> Array:
        task, evolution, parameters, seeds = walks
        pieces = zip(np.array_split(parameters, parts), np.array_split(seeds, parts))
        items = [Walks(task, evolution, *piece) for piece in pieces if len(piece[1])]
        return np.concatenate(gather(client, returns, items))

    return call


@contextmanager
def trials(scheduler: str) -> Iterator[Callable[[Walks], Array]]:
    """What tries networks: `returns`, or the workers of the scheduler at an address."""
    if not scheduler:
        yield returns
        return
    with workers(scheduler) as client:
        yield spread(client, len(client.ncores()))


def learn(
    task: Task, evolution: Evolution, evaluate: Callable[[Walks], Array] = returns
) -> Iterator[Generation]:
    """Generations without end; the first is the network whose actions are zero."""
    e, shape = evolution, shape_of(task, evolution)
    rng = np.random.default_rng(e.seed)
    centre, steps = shape.first(rng), 0
    best, most, moments = centre.copy(), -np.inf, np.zeros((2, shape.size))
    length, generation, mean = round(task.duration / task.gaits.dt), 0, np.nan
    while True:
        if generation % e.test_every == 0:
            tested = np.tile(centre, (len(TEST_SEEDS), 1))
            test = float(evaluate(Walks(task, e, tested, TEST_SEEDS)).mean())
            if test > most:
                best, most = centre.copy(), test
            yield Generation(generation, steps, mean, test, best.copy())
        directions = rng.standard_normal((e.pairs, shape.size))
        tried = centre + e.sigma * np.concatenate([directions, -directions])
        seeds = rng.integers(TEST_SEEDS[0], size=e.pairs)
        found = evaluate(Walks(task, e, tried, np.tile(seeds, 2)))
        generation, steps, mean = generation + 1, steps + length * len(tried), float(found.mean())
        better = found - np.tile(found.reshape(2, -1).mean(axis=0), 2)
        rank = better.argsort().argsort() / (len(found) - 1) - 0.5
        gradient = (rank[: e.pairs] - rank[e.pairs :]) @ directions / (2 * e.pairs * e.sigma)
        centre += e.rate * _adam(moments, gradient, generation)


def _adam(moments: Array, gradient: Array, count: int) -> Array:
    """Direction (p,) of the step; updates the moments (2, p)."""
    decays = np.array(DECAYS)[:, None]
    moments += (1.0 - decays) * (np.stack([gradient, gradient**2]) - moments)
    first, second = (m / (1.0 - d**count) for m, d in zip(moments, DECAYS))
    return np.asarray(first / (np.sqrt(second) + TINY))


@functools.lru_cache(maxsize=4)
def _environment(task: Task, count: int, step: float, threads: int) -> WalkVectorEnv:
    """A vector environment, made once in a process."""
    return WalkVectorEnv(count, task, step=step, threads=threads)
