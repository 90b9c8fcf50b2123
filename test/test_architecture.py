"""Architecture: allowed imports between folders, no circles, names, and a budget of size."""

import ast
import collections
import functools
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "slot_core": ROOT / "src" / "slot_core",
    "slot_lab": ROOT / "src" / "slot_lab",
    "slot_paper": ROOT / "src" / "slot_paper",
    "slot_nodes": ROOT / "src" / "slot_nodes",
    "slot_bringup": ROOT / "slot_bringup",
}
GROUND = "ground"  # the files of a package beside its folders

# What each package may import of the others.
ABOVE = {
    "slot_core": set(),
    "slot_lab": {"slot_core"},
    "slot_paper": {"slot_core"},
    "slot_nodes": {"slot_core", "slot_msgs"},
    "slot_bringup": {"slot_core", "slot_lab", "slot_nodes", "slot_msgs"},
}
# Folders of each package that a folder may import from, besides the ground. Each line names only
# folders of the lines above it, so that there is no circle.
CORE = {
    GROUND: "",
    "dynamics": "",
    "rod": "dynamics",
    "legs": "dynamics",
    "estimation": "dynamics legs",
    "gait": "legs",
    "control": "legs estimation gait",
    "mpc": "legs estimation gait control",
    "safety": "legs estimation gait control",
    "messages": "estimation gait control safety",
    "recording": "",
    "drawing": "messages",
    "vision": "",
    "servos": "safety",
    "dynamixel": "dynamics servos",
    "simulation": "dynamics legs estimation gait control safety vision servos",
    "rollout_mpc": "dynamics legs estimation gait control",
}
BRANDS = ("dynamixel",)  # of servos; only their registry imports them
REGISTRY = "slot_core.servos.registry"
PAPER_REGISTRIES = {
    "slot_core.control.policies",
    "slot_core.simulation.make_robot",
}
LAB = {
    GROUND: "",
    "bags": "",
    "film": "bags",
    "report": "bags",
    "leg_tests": "",
    "calibration": "leg_tests",
    "validation": "bags film",
    "twin": "bags calibration",
    "tuning": "leg_tests",
    "learning": "report",
    "play": "",
}
IMPORT_ALL = """
import importlib, pkgutil, sys, slot_core
for module in pkgutil.walk_packages(slot_core.__path__, "slot_core."):
    importlib.import_module(module.name)
print(*sorted(name.split(".")[0] for name in sys.modules))
"""


@functools.cache
def modules() -> dict[str, Path]:
    """Files of the packages by dotted name."""
    found = {}
    for package, root in PACKAGES.items():
        for path in (root / package).rglob("*.py"):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


@functools.cache
def imports_of(path: Path) -> frozenset[str]:
    """Dotted names of all imports in a file, also in functions and under `TYPE_CHECKING`."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {
                name if name in modules() else node.module for name in inside
            }
    return frozenset(names)


def tops(path: Path) -> set[str]:
    """Packages that a file imports."""
    return {name.split(".")[0] for name in imports_of(path)}


def room(name: str) -> tuple[str, str]:
    """Package and folder of a module; a folder in a folder belongs to it."""
    package, *inside = name.split(".")
    return package, inside[0] if len(inside) > 1 else GROUND


def test_core_imports_nothing_of_ros():
    run = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(run.stdout.split())
    assert "slot_core" in loaded
    assert loaded & {
        "rclpy",
        "rosidl_parser",
        "ament_index_python",
        *PACKAGES,
        "slot_msgs",
    } == {"slot_core"}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_packages_below_it(package):
    files = [
        path for name, path in modules().items() if room(name)[0] == package
    ]
    assert len(files) > 5
    ours = {
        *PACKAGES,
        "slot_msgs",
        "benchmarks",
        "documentation",
        "examples",
    } - {package}
    for path in files:
        assert tops(path) & ours <= ABOVE[package], path


@pytest.mark.parametrize("table", [CORE, LAB], ids=["slot_core", "slot_lab"])
def test_a_folder_of_the_table_imports_only_folders_above_it(table):
    known = []
    for folder, allowed in table.items():
        assert set(allowed.split()) <= set(known)
        known.append(folder)


@pytest.mark.parametrize(
    ("package", "table"), [("slot_core", CORE), ("slot_lab", LAB)]
)
def test_a_folder_imports_only_what_the_table_allows(package, table):
    seen = set()
    for name, path in modules().items():
        mine, folder = room(name)
        if mine == package and name != package:
            seen.add(
                folder if path.name != "__init__.py" else name.split(".")[1]
            )
            others = {room(n) for n in imports_of(path) & modules().keys()}
            inside = {other for which, other in others if which == package} - {
                folder,
                GROUND,
            }
            inside -= set(BRANDS) if name == REGISTRY else set()
            assert inside <= set(table[folder].split()), path
    assert seen == set(table)


def test_only_the_registry_imports_a_brand_of_servos():
    brands = tuple(f"slot_core.{brand}" for brand in BRANDS)
    users = {
        name
        for name, path in modules().items()
        if not name.startswith(brands)
        and any(n.startswith(brands) for n in imports_of(path))
    }
    assert users == {REGISTRY}


def test_only_the_registries_of_policies_and_levels_name_the_papers_package():
    """In text: it is imported when one of its parts is used."""
    naming = {
        name
        for name, path in modules().items()
        if room(name)[0] != "slot_paper" and '"slot_paper.' in path.read_text()
    }
    assert naming == PAPER_REGISTRIES
    assert not any("slot_paper" in tops(modules()[name]) for name in naming)


def test_no_module_imports_itself_by_way_of_others():
    graph = {
        name: imports_of(path) & modules().keys() - {name}
        for name, path in modules().items()
    }
    assert len(list(graphlib.TopologicalSorter(graph).static_order())) == len(
        modules()
    )


def test_no_package_imports_what_is_for_tests_or_for_launch_files():
    others = {"pytest", "unittest", "launch", "launch_ros"}
    for path in modules().values():
        assert not tops(path) & others, path


def tracked() -> list[Path]:
    """Python files of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.py"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [
        Path(line)
        for line in listed.stdout.splitlines()
        if (ROOT / line).exists()
    ]


def test_a_class_name_occurs_once():
    found = collections.Counter(
        node.name
        for path in tracked()
        if path.parts[0] != "test"
        for node in ast.parse((ROOT / path).read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert {name for name, n in found.items() if n > 1} == set()


# Statements that each part of the repository may have. What goes beyond brings its own cut.
BUDGET = {
    "src/slot_core": 15_677,
    "src/slot_lab": 6299,
    "src/slot_paper": 681,
    "src/slot_nodes": 2342,
    "slot_bringup": 2888,
    "scripts": 4808,
    "test": 15_504,
}


def statements(path: Path) -> int:
    """Number of statements of a Python file, those within others too."""
    tree = ast.parse((ROOT / path).read_text())
    return sum(isinstance(node, ast.stmt) for node in ast.walk(tree))


def test_each_package_keeps_its_budget_of_statements():
    sizes = {path: statements(path) for path in tracked()}
    counts = {
        package: sum(
            n for path, n in sizes.items() if path.is_relative_to(package)
        )
        for package in BUDGET
    }
    beyond = {name: n for name, n in counts.items() if n > BUDGET[name]}
    largest = sorted(sizes, key=sizes.__getitem__)[-3:]
    named = ", ".join(f"{path} {sizes[path]}" for path in reversed(largest))
    assert not beyond, (
        f"beyond BUDGET: {beyond}; all: {counts}; largest: {named}"
    )
    # the budget of all is less than the sum of its parts
    assert sum(counts.values()) <= 48_200, f"beyond: {counts}; {named}"
    assert sum(counts.values()) == sum(sizes.values()), (
        "a file outside of BUDGET"
    )


def test_the_formatter_lays_out_all_code():
    kept = [
        p for p in tracked() if "# fmt: " + "skip" in (ROOT / p).read_text()
    ]
    assert kept == []
