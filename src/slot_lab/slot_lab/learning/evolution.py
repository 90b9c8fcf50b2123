"""Evolution strategy: learns the parameters of a network from returns alone, without gradients.

After Salimans et al., "Evolution strategies as a scalable alternative to reinforcement learning",
2017: with antithetic pairs x +- sigma e_i and the ranks u, centred to [-1/2, 1/2], of their returns
less the mean of the pair,

    g = sum_i (u_i+ - u_i-) e_i / (2 n sigma),

and a step of Adam along g. Both networks of a pair walk in the same drawn scene, whose difficulty
the mean takes out. Sigma and the step fall geometrically over the generations: large ones learn
quickly, with small ones the network comes to rest where it walks best without disturbance. All
pairs walk at once, each network on another robot, in one vector environment or in several
processes.
"""

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.control.walk_actions import ACTIONS
from slot_lab.learning.network import NetworkShape
from slot_lab.learning.task import Task, mirror_of
from slot_lab.learning.vector_env import WalkVectorEnv
from slot_lab.workers import gather, workers

DECAYS, TINY = (0.9, 0.99), 1e-8  # of Adam
# of the scenes that test the mean network
TEST_SEEDS = 1_000_000 + np.arange(16)
# a value in the first generation, and in the last
Schedule = tuple[float, float]


@dataclass(frozen=True)
class Evolution:
    """Settings of the strategy."""

    generations: int = 60
    pairs: int = 16
    sigma: Schedule = (0.02, 0.007)
    rate: Schedule = (0.006, 0.0005)
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
    """Result of one generation."""

    generation: int
    steps: int  # of the environment so far
    mean: float  # return of the pairs, per step
    test: float  # return of the mean network in the scenes of TEST_SEEDS, per step
    best: Array  # (p,) the network with the best test


def shape_of(task: Task) -> NetworkShape:
    """Shape of the networks for a task: symmetric ones."""
    return NetworkShape(task.observed, ACTIONS[task.actions], mirror_of(task))


def returns(walks: Walks) -> Array:
    """Return (m,) of an episode with each network, per step of a whole episode."""
    task, evolution, parameters, seeds = walks
    env = _environment(task, len(seeds), evolution.step, evolution.threads)
    shape, found = shape_of(task), np.zeros(len(seeds))
    seen, _ = env.reset(seed=seeds.tolist())
    going = np.ones(len(seeds), dtype=bool)
    steps = round(task.duration / task.gaits.dt)
    for _ in range(steps):
        seen, reward, terminated, truncated, _ = env.step(
            shape.actions(parameters, seen)
        )
        found += np.where(going, reward, 0.0)
        going &= ~(terminated | truncated)
    return found / steps


def spread(client: Any, parts: int) -> Callable[[Walks], Array]:
    """`returns` by the workers of a client of `dask.distributed`, in so many parts."""

    def call(walks: Walks) -> Array:
        task, evolution, parameters, seeds = walks
        pieces = zip(
            np.array_split(parameters, parts), np.array_split(seeds, parts)
        )
        items = [
            Walks(task, evolution, *piece) for piece in pieces if len(piece[1])
        ]
        return np.concatenate(gather(client, returns, items))

    return call


@contextmanager
def trials(scheduler: str) -> Iterator[Callable[[Walks], Array]]:
    """Function that evaluates networks: `returns`, or workers of the scheduler at an address."""
    if not scheduler:
        yield returns
        return
    with workers(scheduler) as client:
        yield spread(client, len(client.ncores()))


def learn(
    task: Task,
    evolution: Evolution,
    evaluate: Callable[[Walks], Array] = returns,
) -> Iterator[Generation]:
    """Yield the result of every `test_every`-th generation; the first network's actions are zero."""
    e, size = evolution, shape_of(task).size
    rng = np.random.default_rng(e.seed)
    centre, moments = np.zeros(size), np.zeros((2, size))
    best, most, mean = centre.copy(), -np.inf, np.nan
    # of a generation
    steps = round(task.duration / task.gaits.dt) * 2 * e.pairs
    for generation in range(e.generations + 1):
        if generation % e.test_every == 0 or generation == e.generations:
            tested = np.tile(centre, (len(TEST_SEEDS), 1))
            test = float(evaluate(Walks(task, e, tested, TEST_SEEDS)).mean())
            if test > most:
                best, most = centre.copy(), test
            yield Generation(
                generation, steps * generation, mean, test, best.copy()
            )
        if generation == e.generations:
            return
        share = generation / e.generations
        sigma, rate = (
            first * (last / first) ** share for first, last in (e.sigma, e.rate)
        )
        directions = rng.standard_normal((e.pairs, size))
        tried = centre + sigma * np.concatenate([directions, -directions])
        seeds = rng.integers(TEST_SEEDS[0], size=e.pairs)
        found = evaluate(Walks(task, e, tried, np.tile(seeds, 2)))
        mean = float(found.mean())
        better = found - np.tile(found.reshape(2, -1).mean(axis=0), 2)
        rank = better.argsort().argsort() / (len(found) - 1) - 0.5
        gradient = (
            (rank[: e.pairs] - rank[e.pairs :])
            @ directions
            / (2 * e.pairs * sigma)
        )
        centre += rate * _adam(moments, gradient, generation + 1)


def _adam(moments: Array, gradient: Array, count: int) -> Array:
    """Direction (p,) of the step; updates the moments (2, p)."""
    decays = np.array(DECAYS)[:, None]
    moments += (1.0 - decays) * (np.stack([gradient, gradient**2]) - moments)
    first, second = (m / (1.0 - d**count) for m, d in zip(moments, DECAYS))
    return np.asarray(first / (np.sqrt(second) + TINY))


@functools.lru_cache(maxsize=4)
def _environment(
    task: Task, count: int, step: float, threads: int
) -> WalkVectorEnv:
    """A vector environment, made once in a process."""
    return WalkVectorEnv(count, task, step=step, threads=threads)
