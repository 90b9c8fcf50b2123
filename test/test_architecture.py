"""Who may import whom."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import slot_core

CORE = Path(slot_core.__file__).parent
IMPORT_ALL = """
import importlib, pkgutil, sys, slot_core
for module in pkgutil.walk_packages(slot_core.__path__, "slot_core."):
    importlib.import_module(module.name)
print(*sorted(name.split(".")[0] for name in sys.modules))
"""


def imports_of(path: Path) -> set[str]:
    """Dotted names that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_core_imports_nothing_of_ros():
    run = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=True, timeout=120
    )
    loaded = set(run.stdout.split())
    assert "slot_core" in loaded
    assert not loaded & {"rclpy", "rosidl_parser", "slot_msgs", "slot_nodes", "ament_index_python"}


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("dynamics", ("control", "dynamixel", "evaluation", "calibration")),
        ("control", ("dynamics", "dynamixel", "evaluation", "calibration")),
        ("calibration", ("control", "dynamixel")),
        ("dynamixel", ("control", "evaluation", "calibration")),
    ],
)
def test_a_package_knows_only_those_below_it(package, forbidden):
    files = sorted((CORE / package).glob("**/*.py"))
    assert len(files) > 3
    forbidden = tuple(f"slot_core.{name}" for name in forbidden)
    for path in files:
        for name in imports_of(path):
            assert not name.startswith(("slot_nodes", "slot_bringup", *forbidden)), (
                f"{path}: {name}"
            )


def test_launch_is_imported_by_the_launch_file_alone():
    root = CORE.resolve().parents[2]
    sources = [*root.glob("src/**/*.py"), *root.glob("slot_bringup/slot_bringup/*.py")]
    assert len(sources) > 20
    for path in sources:
        tops = {name.split(".")[0] for name in imports_of(path)}
        assert not tops & {"launch", "launch_ros"}, path
