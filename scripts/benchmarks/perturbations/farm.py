"""Runs samples with `dask.distributed` on the cores of this machine or on a cluster."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from distributed import Client, as_completed

from benchmarks.harness import Progress
from benchmarks.perturbations.samples import RandomSample, SampleRecord, draw, run_sample

PACKAGE = Path(__file__).resolve().parents[1]  # benchmarks
REPORTS = 20  # lines of progress


def run_samples(
    client: Client, record: SampleRecord, like: RandomSample, count: int, progress: Progress
) -> list[dict[str, Any]]:
    """Results of the samples 0 .. count-1; samples in `record` are not run again."""
    missing = record.missing(count)
    progress(f"{count - len(missing)} of {count} samples are recorded")
    # A local cluster has the package of the benchmarks: its scheduler, in this process, would
    # import it again, from the archive.
    if missing and client.cluster is None:
        with tempfile.TemporaryDirectory() as directory:
            name = str(Path(directory) / PACKAGE.name)
            client.upload_file(shutil.make_archive(name, "zip", PACKAGE.parent, PACKAGE.name))
    samples = [draw(like.plant, like.seed, like.observer, index) for index in missing]
    futures = client.map(run_sample, samples, pure=False)
    for done, (_, result) in enumerate(as_completed(futures, with_results=True), start=1):
        record.add(result)
        if done % max(1, len(missing) // REPORTS) == 0:
            progress(f"{done} of {len(missing)} samples")
    return [row for row in record.rows if int(row["index"]) < count]
