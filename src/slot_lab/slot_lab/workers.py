"""Processes that compute in parallel with `dask.distributed`, on this machine or on a cluster."""

import argparse
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from slot_core.command_line import positive_integer

LOOPBACK = "127.0.0.1"
Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def workers(scheduler: str, count: int | None = None) -> Iterator[Any]:
    """Client of the cluster at `scheduler`; if empty, of `count` local processes (default: cores).

    The local cluster listens on the loopback only. A remote worker needs slot_core of the same
    revision. Raises ModuleNotFoundError without `distributed` (`scripts/setup --learn`).
    """
    from distributed import Client, LocalCluster  # noqa: PLC0415 - not installed with the robot

    # An interrupted `gather` leaves exceptions that nobody retrieves.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    if scheduler:
        with Client(scheduler) as client:
            yield client
        return
    cores = count or len(os.sched_getaffinity(0))
    local = {
        "host": LOOPBACK,
        "processes": True,
        "threads_per_worker": 1,
        "silence_logs": logging.ERROR,
    }
    # By default the web servers listen on every interface.
    pages = dict.fromkeys(
        ("dashboard_address", "worker_dashboard_address"), f"{LOOPBACK}:0"
    )
    with (
        LocalCluster(n_workers=cores, **local, **pages) as here,
        Client(here) as client,
    ):
        yield client


def gather(
    client: Any, call: Callable[[Item], Result], items: Sequence[Item]
) -> list[Result]:
    """Results of a call for each of the items, in their order."""
    return list(client.gather(client.map(call, list(items), pure=False)))


def serially(
    call: Callable[[Item], Result], items: Sequence[Item]
) -> list[Result]:
    """As `gather`, one after the other in this process."""
    return [call(item) for item in items]


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that computes by `mapper`."""
    parser.add_argument(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="of dask; default: this machine",
    )
    parser.add_argument(
        "--workers",
        type=positive_integer,
        metavar="N",
        help="local processes (default: cores); with 1, this process",
    )


@contextmanager
def mapper(
    scheduler: str, count: int | None
) -> Iterator[Callable[..., list[Any]]]:
    """`gather` by `workers`, or `serially` for one local process."""
    if count == 1 and not scheduler:
        yield serially
        return
    with workers(scheduler, count) as client:
        yield partial(gather, client)
