"""Compiled kernels on disk: shared by content, never trusted when damaged, bounded in size."""

import os
import resource
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import numba
import numpy as np
import pytest

from slot_core import kernel_cache
from slot_core.compiled import kernel
from slot_core.kernel_cache import KernelCache, prune
from slot_core.simulation.warm_up import compile_with


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels, in a process that has announced and lost nothing."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(KernelCache, "told", False)
    monkeypatch.setattr(KernelCache, "lost", None)
    return tmp_path


def doubled():
    """A kernel as a new process would have it: not compiled, not loaded."""
    return kernel(lambda x: 2.0 * x)


def test_second_process_loads_what_the_first_has_compiled(folder, capsys):
    assert doubled()(1.5) == 3.0
    (file,) = folder.iterdir()
    assert (
        f"compiling kernels for this processor (kept in {folder})"
        in capsys.readouterr().err
    )
    again, before = doubled(), file.read_bytes()
    assert again(1.5) == 3.0
    assert sum(again.stats.cache_hits.values()) == 1
    assert [path.read_bytes() for path in folder.iterdir()] == [before]
    assert not capsys.readouterr().err


@pytest.mark.parametrize("change", ["cut", "bit", "empty"])
def test_damaged_file_is_compiled_anew(folder, change):
    doubled()(1.5)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    middle = len(whole) // 2
    damaged = {
        "cut": whole[:middle],
        "bit": whole[:middle] + b"~" + whole[middle + 1 :],
        "empty": b"",
    }
    file.write_bytes(damaged[change])
    for loaded in (0, 1):
        again = doubled()
        assert again(1.5) == 3.0
        assert sum(again.stats.cache_hits.values()) == loaded


def test_folder_that_cannot_be_written_costs_a_compilation_at_every_start(
    folder, monkeypatch, capsys
):
    (folder / "file").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder / "file" / "cache"))
    assert doubled()(1.5) == 3.0
    assert "cannot be written, so every start does" in capsys.readouterr().err


def test_full_disk_costs_a_compilation_at_every_start(folder, capsys):
    """An empty file could be made on it, so it was said that the kernel is kept."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        assert doubled()(1.5) == 3.0
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "cannot be written, so every start does" in capsys.readouterr().err
    assert not list(folder.iterdir())


def test_setup_fails_where_a_kernel_cannot_be_kept(folder, monkeypatch):
    """It marked the kernels as compiled, and every run compiled them again."""
    compile_with(doubled(), (1.5,))
    (folder / "file").write_text("")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder / "file" / "cache"))
    with pytest.raises(NotADirectoryError):
        compile_with(doubled(), (1.5,))


def test_order_of_fields_is_part_of_the_key(folder):
    first = namedtuple("Pair", "a b")
    second = namedtuple("Pair", "b a")

    def difference(pair):
        return pair.a - pair.b

    assert kernel(difference)(first(5.0, 2.0)) == 3.0
    assert kernel(difference)(second(5.0, 2.0)) == -3.0
    assert len(list(folder.iterdir())) == 2


def test_files_not_used_for_longest_leave_when_the_limit_is_exceeded(folder):
    for age, name in enumerate("abcd"):
        path = folder / f"{name}{kernel_cache.SUFFIX}"
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    prune(folder, limit=250)
    assert sorted(path.stem for path in folder.iterdir()) == ["a", "b"]


def test_loading_counts_as_use(folder):
    doubled()(1.5)
    (file,) = folder.iterdir()
    os.utime(file, (1e9, 1e9))
    doubled()(1.5)
    assert file.stat().st_mtime > 1e9 + 1


def test_kernel_that_refers_to_an_object_of_the_process_is_refused():
    table = np.arange(1e6)  # too large for Numba to copy

    def entry(k):
        return table[k]

    with pytest.raises(ValueError, match="refers to an object of this process"):
        kernel(entry)(3)


def test_change_of_an_imported_module_compiles_anew_and_one_of_another_does_not(
    folder, tmp_path_factory
):
    root = tmp_path_factory.mktemp("copy")
    package = root / "slot_core"
    package.mkdir()
    source = Path(kernel_cache.__file__).parent
    for name in ("compiled.py", "kernel_cache.py", "__init__.py"):
        (package / name).write_text((source / name).read_text())
    (package / "shared.py").write_text("SHARED = 2.0\n")
    (package / "other.py").write_text("OTHER = 2.0\n")
    (package / "own.py").write_text(
        "from slot_core.compiled import kernel\nfrom slot_core.shared import SHARED\n\n\n"
        "@kernel\ndef times(x):\n    return SHARED * x\n"
    )

    def files():
        command = [sys.executable, "-c", "from slot_core.own import times; times(1.0)"]
        subprocess.run(
            command,
            env=os.environ | {"PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(folder)},
            check=True,
        )
        return len(list(folder.glob(f"*{kernel_cache.SUFFIX}")))

    first = files()
    (package / "other.py").write_text("OTHER = 3.0\n")
    assert files() == first
    (package / "shared.py").write_text("SHARED = 3.0\n")
    assert files() == first + 1
