"""Runs samples with `dask.distributed` on the cores of this machine or on a cluster."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from distributed import Client, LocalCluster, as_completed

from benchmarks.perturbations.samples import Record, Sample, draw, run_sample

PACKAGE = Path(__file__).resolve().parents[1]  # benchmarks
LOOPBACK = "127.0.0.1"
REPORTS = 20  # lines of progress


@contextmanager
def workers(scheduler: str, count: int | None = None) -> Iterator[Client]:
    """Client of the cluster at `scheduler`; if empty, of `count` local processes (default: cores).

    The local cluster listens on the loopback only. A remote worker needs slot_core of the same
    revision; the package of the benchmarks is uploaded to it.
    """
    if scheduler:
        with Client(scheduler) as client:
            yield client
        return
    cores = count or len(os.sched_getaffinity(0))
    local = {"host": LOOPBACK, "processes": True, "threads_per_worker": 1}
    # By default the web servers listen on every interface.
    pages = dict.fromkeys(("dashboard_address", "worker_dashboard_address"), f"{LOOPBACK}:0")
    with (
        LocalCluster(n_workers=cores, **local, **pages) as here,
        Client(here) as client,
    ):
        yield client


def run_samples(
    client: Client, record: Record, like: Sample, count: int, progress: Callable[[str], None]
) -> Sequence[Mapping[str, Any]]:
    """Results of the samples 0 .. count-1; samples in `record` are not run again."""
    missing = record.missing(count)
    progress(f"{count - len(missing)} of {count} samples are recorded")
    if missing:
        _upload(client)
    samples = [draw(like.plant, like.seed, like.observer, index) for index in missing]
    futures = client.map(run_sample, samples, pure=False)
    for done, (_, result) in enumerate(as_completed(futures, with_results=True), start=1):
        record.add(result)
        if done % max(1, len(missing) // REPORTS) == 0:
            progress(f"{done} of {len(missing)} samples")
    return [row for row in record.rows if int(row["index"]) < count]


def _upload(client: Client) -> None:
    """Upload the package of the benchmarks to every worker."""
    with tempfile.TemporaryDirectory() as directory:
        name = str(Path(directory) / PACKAGE.name)
        archive = shutil.make_archive(name, "zip", PACKAGE.parent, PACKAGE.name)
        client.upload_file(archive)
