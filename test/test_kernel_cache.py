"""Compiled kernels on disk: shared by content, never trusted when damaged, bounded in size."""

import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import numba
import numpy as np
import pytest

from slot_core import kernel_cache
from slot_core.compiled import kernel
from slot_core.simulation.warm_up import compile_with


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty folder of kernels, in a process that has announced and lost nothing."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kernel_cache.KernelCache, "began", None)
    monkeypatch.setattr(kernel_cache.KernelCache, "lost", None)
    return tmp_path


def doubled():
    """A kernel as a new process would have it: not compiled, not loaded."""
    return kernel(lambda x: 2.0 * x)


def test_second_process_loads_what_the_first_has_compiled(folder, capsys):
    assert doubled()(1.5) == 3.0
    (file,) = folder.iterdir()
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith(f"a minute or two (once; kept in {folder})")
    assert second.endswith("<lambda>, after 0 s")
    before = file.read_bytes()
    os.utime(file, (1e9, 1e9))
    again = doubled()
    assert again(1.5) == 3.0
    assert sum(again.stats.cache_hits.values()) == 1
    assert [path.read_bytes() for path in folder.iterdir()] == [before]
    assert not capsys.readouterr().err
    assert file.stat().st_mtime > 1e9 + 1  # loading counts as use


DAMAGES = {
    "cut": lambda whole: whole[: len(whole) // 2],
    "bit": lambda whole: (
        whole[: len(whole) // 2] + b"~" + whole[len(whole) // 2 + 1 :]
    ),
    "empty": lambda whole: b"",
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_file_is_compiled_anew(folder, damage):
    doubled()(1.5)
    (file,) = folder.iterdir()
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    for loaded in (0, 1):
        again = doubled()
        assert again(1.5) == 3.0
        assert sum(again.stats.cache_hits.values()) == loaded


def test_folder_that_cannot_be_written_costs_a_compilation_and_set_up_fails(
    folder, monkeypatch, capsys
):
    """It marked the kernels as compiled, and every run compiled them again."""
    (folder / "file").write_text("")
    monkeypatch.setattr(
        numba.config, "CACHE_DIR", str(folder / "file" / "cache")
    )
    assert doubled()(1.5) == 3.0
    assert "cannot be written, so every start does" in capsys.readouterr().err
    with pytest.raises(NotADirectoryError):
        compile_with(doubled(), (1.5,))


def test_order_of_fields_is_part_of_the_key(folder):
    difference = kernel(lambda pair: pair.a - pair.b)
    for fields, expected in (("a b", 3.0), ("b a", -3.0)):
        pair = namedtuple("Pair", fields)
        assert difference(pair(5.0, 2.0)) == expected
    assert len(list(folder.iterdir())) == 2


def test_files_not_used_for_longest_leave_when_the_limit_is_exceeded(folder):
    for age, name in enumerate("abcd"):
        path = folder / f"{name}{kernel_cache.SUFFIX}"
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    kernel_cache.prune(folder, limit=250)
    assert sorted(path.stem for path in folder.iterdir()) == ["a", "b"]


def test_kernel_that_refers_to_an_object_of_the_process_is_refused():
    table = np.arange(1e6)  # too large for Numba to copy
    entry = kernel(lambda k: table[k])
    with pytest.raises(ValueError, match="refers to an object of this process"):
        entry(3)


def test_change_of_an_imported_module_compiles_anew_and_one_of_another_does_not(
    folder, tmp_path_factory
):
    root = tmp_path_factory.mktemp("copy")
    package, source = root / "slot_core", Path(kernel_cache.__file__).parent
    package.mkdir()
    for name in ("compiled.py", "kernel_cache.py", "__init__.py"):
        (package / name).write_text((source / name).read_text())
    own = (
        "from slot_core.compiled import kernel\nfrom slot_core.shared import SHARED\n\n\n"
        "@kernel\ndef times(x):\n    return SHARED * x\n"
    )
    (package / "own.py").write_text(own)
    command = [
        sys.executable,
        "-c",
        "from slot_core.own import times; times(1.0)",
    ]
    variables = os.environ | {
        "PYTHONPATH": str(root),
        "NUMBA_CACHE_DIR": str(folder),
    }
    counts = []
    for shared, other in ((2, 2), (2, 3), (3, 3)):
        (package / "shared.py").write_text(f"SHARED = {shared}.0\n")
        (package / "other.py").write_text(f"OTHER = {other}.0\n")
        subprocess.run(command, env=variables, check=True)
        counts.append(len(list(folder.glob(f"*{kernel_cache.SUFFIX}"))))
    assert counts == [counts[0], counts[0], counts[0] + 1]
