"""Installs the Python packages of the workspace as links to their sources, without a build.

usage: install_packages.py INSTALL PACKAGE...

It does what `colcon build --symlink-install` does with a setup.py: data files and the entry of the ament index are
links below INSTALL/share, programs are scripts in INSTALL/lib/PACKAGE, name, version and programs are told to
importlib.metadata. scripts/env puts the sources on PYTHONPATH.
"""

import os
import runpy
import sys
from pathlib import Path
from types import ModuleType

SITE = "lib/python{}.{}/site-packages".format(*sys.version_info)
PROGRAM = """#!{python}
import sys

from {module} import {function}

sys.exit({function}())
"""


def settings_of(package):
    """Arguments that a package's setup.py gives to setuptools."""
    given = {}
    setuptools = ModuleType("setuptools")
    setuptools.setup = given.update
    setuptools.find_packages = list
    sys.modules["setuptools"] = setuptools
    os.chdir(package)
    runpy.run_path("setup.py")
    return given


def install(package, prefix):
    """Links and programs of a package."""
    settings = settings_of(package)
    for folder, files in settings["data_files"]:
        (prefix / folder).mkdir(parents=True, exist_ok=True)
        for file in files:
            (prefix / folder / Path(file).name).symlink_to(package / file)
    entries = settings.get("entry_points", {}).get("console_scripts", [])
    about = (
        prefix / SITE / f"{settings['name']}-{settings['version']}.dist-info"
    )
    about.mkdir(parents=True)
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n".format(
            **settings
        )
    )
    (about / "entry_points.txt").write_text(
        "\n".join(["[console_scripts]", *entries, ""])
    )
    for entry in entries:
        name, module, function = entry.replace(":", " = ").split(" = ")
        program = prefix / "lib" / settings["name"] / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(
            PROGRAM.format(
                python=sys.executable, module=module, function=function
            )
        )
        program.chmod(0o755)


def main():
    """Install the packages given as arguments."""
    prefix, *packages = [Path(argument).resolve() for argument in sys.argv[1:]]
    for package in packages:
        if (package / "setup.py").exists():
            install(package, prefix)


if __name__ == "__main__":
    main()
