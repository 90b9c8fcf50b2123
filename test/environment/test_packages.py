"""The ROS packages: tests that `colcon test` runs, dependencies that package.xml names."""

import ast
import configparser
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = [*(ROOT / "src").iterdir(), ROOT / "slot_bringup"]
PACKAGES = {folder.name: folder for folder in FOLDERS}
# Keys of rosdep by what is imported; other names are those of ROS packages.
KEYS = {
    "clarabel": "python3-clarabel-pip",
    "cv2": "python3-opencv",
    "llvmlite": "python3-numba",
    "matplotlib": "python3-matplotlib",
    "mcap": "python3-mcap-pip",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "PIL": "python3-pil",
    "setproctitle": "python3-setproctitle",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
}
OPTIONAL = {  # of the extras --bench, --play and --learn of scripts/setup
    "cma",
    "distributed",
    "gymnasium",
    "onnx",
    "onnxruntime",
    "viser",
    "websockets",
}
STARTED = {  # by the launch files, part of the build, or named in a registry
    "slot_bringup": {
        "robot_state_publisher",
        "ros2bag",
        "ros2launch",
        "rosbag2_storage_mcap",
        "slot_paper",
    },
}


def settings(file):
    parser = configparser.ConfigParser()
    parser.read(file)
    return dict(parser["pytest"])


def test_colcon_test_runs_every_test_in_one_package_with_the_same_settings():
    expected, found = settings(ROOT / "test/pytest.ini"), []
    for folder in PACKAGES.values():
        own = settings(folder / "pytest.ini")
        found += [
            (folder / name).resolve() for name in own.pop("testpaths").split()
        ]
        assert (folder / own.pop("pythonpath")).resolve() == ROOT / "scripts"
        assert own.pop("addopts") == f'{expected["addopts"]} -m "not real_time"'
        assert own == {name: expected[name] for name in own}
    for file in (ROOT / "test").rglob("test_*.py"):
        times = sum(file.is_relative_to(path) for path in found)
        assert times == (file.parent.name != "real_time"), file


def imported(folder, name):
    """Imports of the modules of a package, but for itself and the standard library."""
    found = set()
    for path in [
        *(folder / name).rglob("*.py"),
        *(folder / "launch").glob("*.py"),
    ]:
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Import(names=names):
                    found |= {alias.name.partition(".")[0] for alias in names}
                case ast.ImportFrom(module=module):
                    found.add(module.partition(".")[0])
    return found - {name, *sys.stdlib_module_names} - OPTIONAL


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_names_every_dependency_and_no_other(package):
    folder = PACKAGES[package]
    manifest = ElementTree.parse(folder / "package.xml")
    named, tests = (
        {element.text for element in manifest.findall(f"{kind}_depend")}
        for kind in ("exec", "test")
    )
    needed = {KEYS.get(name, name) for name in imported(folder, package)}
    assert named == needed | STARTED.get(package, set())
    plain = package in ("slot_nodes", "slot_paper")
    drawn = set() if plain else {"python3-hypothesis"}
    assert tests == {"python3-pytest", "python3-pytest-timeout"} | drawn


def test_keys_that_rosdep_lacks_stand_in_a_list_of_our_own():
    content = yaml.safe_load((ROOT / "scripts/rosdep.yaml").read_text())
    pinned = (ROOT / "scripts/requirements/runtime.txt").read_text()
    assert {"python3-clarabel-pip", "python3-mcap-pip"} <= set(content)
    for entry in content.values():
        (name,) = entry["ubuntu"]["pip"]["packages"]
        assert f"\n{name}==" in pinned


def test_the_configuration_is_installed_as_files_of_its_package(tmp_path):
    """In the sources it is a link that leads out of the package."""
    words = ["setup.py", "-q", "build_py", "--build-lib", str(tmp_path)]
    subprocess.run(
        [sys.executable, *words], cwd=PACKAGES["slot_core"], check=True
    )
    installed = tmp_path / "slot_core" / "defaults"
    found, expected = (
        {
            path.relative_to(folder)
            for path in folder.rglob("*")
            if path.is_file()
        }
        for folder in (installed, ROOT / "config")
    )
    assert found == expected
    assert not any(
        path.is_symlink() for path in (installed, *installed.rglob("*"))
    )
