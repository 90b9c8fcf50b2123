"""A caller's folder and shell, which programs of the repository do not obey."""

from pathlib import Path

import pytest

MODULES = (
    "argparse",
    "json",
    "multiprocessing",
    "numpy",
    "os",
    "random",
    "re",
    "rclpy",
    "signal",
    "slot_core",
    "yaml",
)


class Caller:
    """A folder with modules of the caller's own, which write that they ran; variables of Python."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._ran = folder, folder / "ran"
        for name in MODULES:
            line = f"open({str(self._ran)!r}, 'a').write('{name} ')\nprint('my own script')\n"
            (folder / f"{name}.py").write_text(line)
        self.python = {
            "MPLBACKEND": "module://own",
            "PYTHONDEVMODE": "1",
            "PYTHONHASHSEED": "own",
            "PYTHONHOME": "/nowhere",
            "PYTHONINSPECT": "1",
            "PYTHONOPTIMIZE": "2",
            "PYTHONPATH": f"{folder}:",
            "PYTHONSTARTUP": str(folder / "random.py"),
            "PYTHONWARNINGS": "error",
        }

    @property
    def ran(self) -> str:
        """Names of the caller's modules that were executed."""
        return self._ran.read_text() if self._ran.exists() else ""


@pytest.fixture
def caller(tmp_path: Path) -> Caller:
    folder = tmp_path / "own"
    folder.mkdir()
    return Caller(folder)
