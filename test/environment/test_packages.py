"""The ROS packages: tests that `colcon test` runs, dependencies that package.xml names."""

import ast
import configparser
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    folder.name: folder
    for folder in (*(ROOT / "src").iterdir(), ROOT / "slot_bringup")
}
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
# Names of distributions by what is imported; other names are the same.
DISTRIBUTIONS = {
    "cv2": "opencv-python-headless",
    "dynamixel_sdk": "dynamixel-sdk",
    "PIL": "pillow",
    "serial": "pyserial",
    "yaml": "PyYAML",
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
    return found - {name, *sys.stdlib_module_names}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_names_every_dependency_and_no_other(package):
    folder = PACKAGES[package]
    manifest = ElementTree.parse(folder / "package.xml")
    named, tests = (
        {element.text for element in manifest.findall(f"{kind}_depend")}
        for kind in ("exec", "test")
    )
    imports = imported(folder, package) - OPTIONAL
    needed = {KEYS.get(name, name) for name in imports}
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


def requirements(package):
    """Requirements of a package's setup.cfg: without and with its extras, less those of tests."""
    parser = configparser.ConfigParser()
    parser.read(PACKAGES[package] / "setup.cfg")
    base = parser["options"]["install_requires"]
    extras = dict(parser["options.extras_require"], test="")
    return tuple(
        [Requirement(line) for line in text.split("\n") if line]
        for text in (base, "\n".join([base, *extras.values()]))
    )


@pytest.mark.parametrize("package", ["slot_core", "slot_lab", "slot_paper"])
def test_pip_installs_every_dependency_and_no_other_within_bounds_around_the_pins(
    package,
):
    pins = dict.fromkeys(PACKAGES, "0.1.0")
    for path in (ROOT / "scripts/requirements").glob("*.txt"):
        pins |= re.findall(
            r"^([\w-]+)==([\w.]+)", path.read_text(), re.MULTILINE
        )
    _, declared = requirements(package)
    needed = imported(PACKAGES[package], package)
    assert {entry.name for entry in declared} == {
        DISTRIBUTIONS.get(name, name) for name in needed
    }
    for entry in declared:
        assert entry.specifier.contains(pins[entry.name.lower()]), entry
        assert entry.specifier or entry.name in PACKAGES


def test_robot_rod_and_controller_need_no_extra():
    base, _ = requirements("slot_core")
    extra = {
        name
        for name in imported(PACKAGES["slot_core"], "slot_core")
        if DISTRIBUTIONS.get(name, name) not in {entry.name for entry in base}
    }
    assert "cv2" in extra
    code = (
        f"import sys; sys.modules |= dict.fromkeys({extra})\n"
        "import slot_core.rod.cosserat_rod, slot_core.simulation.closed_loop"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_installed_wheel_reads_the_configuration_that_it_holds(tmp_path):
    """In the sources it is a link that leads out of the package."""
    source, target = tmp_path / "src" / "slot_core", tmp_path / "target"
    shutil.copytree(PACKAGES["slot_core"], source, symlinks=True)
    (tmp_path / "config").symlink_to(ROOT / "config")
    words = (
        "-m pip install -q --no-index --no-deps --no-build-isolation --target"
    )
    subprocess.run([sys.executable, *words.split(), target, source], check=True)
    code = (
        f"import sys; sys.path.insert(0, {str(target)!r})\n"
        "from slot_core import robot; robot.read_robot(); print(robot.__file__)"
    )
    found = subprocess.check_output(
        [sys.executable, "-I", "-c", code], text=True
    )
    assert found.strip() == str(target / "slot_core" / "robot.py")
    installed, expected = (
        {
            path.relative_to(folder)
            for path in folder.rglob("*")
            if path.is_file() and not path.is_symlink()
        }
        for folder in (target / "slot_core" / "defaults", ROOT / "config")
    )
    assert installed == expected
