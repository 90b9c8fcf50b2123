"""Architecture: allowed imports between folders, size of folders, unique file names."""

import ast
import collections
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "src" / "slot_core" / "slot_core"
GROUND = "ground"
LARGEST_FOLDER = 17  # files, `__init__.py` not counted

# Folders that each folder may import from; `ground`: the files beside the folders.
ALLOWED = {
    GROUND: "",
    "rod": "ground dynamics dynamics/spatial",
    "dynamics/planar": "ground dynamics",
    "dynamics/spatial": "ground dynamics",
    "dynamics": "ground dynamics/planar dynamics/spatial",
    "control": "ground",
    "control/mpc": "ground control",
    "legs": "ground dynamics dynamics/planar dynamics/spatial",
    "paper": "ground dynamics",
    "safety": "ground control control/mpc",
    "dynamixel": "ground safety",
    "emulator": "ground dynamics dynamixel",
    "vision": "ground bags",
    "simulation": "ground dynamics legs paper control control/mpc safety dynamixel emulator vision",
    "bags": "ground control control/mpc safety",
    "report": "ground dynamics control control/mpc bags",
    "calibration": "ground dynamics legs simulation report",
    "validation": "ground bags report vision",
    "twin": "ground dynamics simulation safety bags report calibration validation",
    "tuning": "ground dynamics control simulation",
}
# The controller combines the MPC with its other stages.
EXCEPTIONS = {("control/controller.py", "control/mpc")}
# File names that occur in several folders, with the reason.
REPEATED = {
    "__init__.py": "subject of the folder",
    "model.py": "numerical form of the equations of the folder's subject",
    "kernels.py": "the compiled functions of the folder's subject",
    "settings.py": "settings class of the folder's YAML file",
    "statics.py": "equilibria of the rod, and those of its benchmark",
    "strain.py": "strains of planar and of spatial legs",
    "elimination.py": "elimination of planar and of spatial legs, and of the public rod",
    "leg.py": "a planar and a spatial leg in a time step, and the choice between them",
    "setup.py": "one in each ROS package",
    "conftest.py": "pytest fixtures of a folder",
    "benchmark.py": "main function of each benchmark",
    "picture.py": "plots of each benchmark, and of a run",
    "cases.py": "cases of each benchmark",
}
IMPORT_ALL = """
import importlib, pkgutil, sys, slot_core
for module in pkgutil.walk_packages(slot_core.__path__, "slot_core."):
    importlib.import_module(module.name)
print(*sorted(name.split(".")[0] for name in sys.modules))
"""


def imports_of(path: Path) -> set[str]:
    """Dotted names of all imports in a file, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def folder_of(path: Path) -> str:
    """Folder of a file of the core, relative to the core."""
    folder = path.parent.relative_to(CORE).as_posix()
    return GROUND if folder == "." else folder


def imported_folders(path: Path) -> set[str]:
    """Folders of the core that a file imports from, without its own."""
    folders = set()
    for name in imports_of(path):
        parts = name.split(".")
        if parts[0] == "slot_core":
            places = (
                CORE.joinpath(*parts[1:n]).with_suffix(".py") for n in (len(parts) - 1, len(parts))
            )
            found = next((p for p in places if p.is_file()), None)
            folders.add(GROUND if found is None else folder_of(found))
    return folders - {folder_of(path)}


def test_core_imports_nothing_of_ros():
    run = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=True, timeout=120
    )
    loaded = set(run.stdout.split())
    assert "slot_core" in loaded
    assert not loaded & {"rclpy", "rosidl_parser", "slot_msgs", "slot_nodes", "ament_index_python"}


def test_every_folder_of_the_core_is_in_the_table():
    assert {folder_of(path) for path in CORE.rglob("*.py")} == set(ALLOWED)


@pytest.mark.parametrize("folder", ALLOWED)
def test_a_folder_imports_only_what_the_table_allows(folder):
    files = [path for path in CORE.rglob("*.py") if folder_of(path) == folder]
    assert len(files) > 2
    for path in files:
        for other in imported_folders(path) - set(ALLOWED[folder].split()):
            assert (path.relative_to(CORE).as_posix(), other) in EXCEPTIONS, f"{path}: {other}"
        names = {name.split(".")[0] for name in imports_of(path)}
        assert not names & {"slot_nodes", "slot_bringup", "slot_msgs", "benchmarks"}, path


def test_nodes_do_not_import_the_bring_up():
    files = list((ROOT / "src" / "slot_nodes").rglob("*.py"))
    assert len(files) > 10
    for path in files:
        assert not {name.split(".")[0] for name in imports_of(path)} & {"slot_bringup"}, path


def tracked() -> list[Path]:
    """Files of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [Path(line) for line in listed.stdout.splitlines() if (ROOT / line).exists()]


def test_no_folder_has_too_many_python_files():
    python = [path for path in tracked() if path.suffix == ".py" and path.name != "__init__.py"]
    sizes = collections.Counter(path.parent for path in python)
    assert len(sizes) > 20
    assert {str(p): n for p, n in sizes.items() if n > LARGEST_FOLDER} == {}


def test_a_file_name_occurs_in_several_folders_only_with_a_reason():
    python = [path for path in tracked() if path.suffix == ".py"]
    counts = collections.Counter(path.name for path in python)
    assert {name for name, n in counts.items() if n > 1} == set(REPEATED)


def test_no_file_name_has_a_leading_underscore():
    private = [p for p in tracked() if p.suffix == ".py" and p.name.startswith("_")]
    assert {p.name for p in private} <= {"__init__.py", "__main__.py"}


def test_launch_is_imported_only_by_the_launch_file():
    sources = [*ROOT.glob("src/**/*.py"), *ROOT.glob("slot_bringup/slot_bringup/**/*.py")]
    assert len(sources) > 20
    for path in sources:
        tops = {name.split(".")[0] for name in imports_of(path)}
        assert not tops & {"launch", "launch_ros"}, path
