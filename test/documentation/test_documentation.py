"""The documentation: links that lead somewhere, and a reference that leaves nothing out."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from PIL import Image

from benchmarks import harness
from documentation import DOC, ROOT, pictures
from slot_bringup.graph import read_graph
from slot_core.drawing.palette import LEG_COLOURS

PAGES = [ROOT / "README.md", *sorted(DOC.rglob("*.md"))]
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
FIELDS = {"quantity", "choice", "flag", "text"}  # of slot_core.config
README_LINES = 110  # at most


def anchors(page):
    """Anchors of the headings of a page, as GitHub and MyST name them."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_every_link_leads_to_a_file_and_to_a_heading_in_it(page):
    text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", page.read_text()))
    for link in LINK.findall(text):
        if re.match(r"https://", link):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_in_the_table_of_contents():
    listed = re.findall(r"^([\w/]+)$", (DOC / "index.md").read_text(), re.MULTILINE)
    found = {
        page.relative_to(DOC).with_suffix("").as_posix() for page in DOC.rglob("*.md")
    }
    assert found - set(listed) == {"index"}


def test_scripts_pictures_draws_every_picture():
    files = {
        path.name for path in DOC.iterdir() if path.suffix in (".png", ".gif", ".html")
    }
    assert files == set(pictures.PICTURES)


def test_every_picture_is_shown_on_a_page():
    shown = {
        Path(link).name for page in PAGES for link in LINK.findall(page.read_text())
    }
    assert {*pictures.PICTURES} - shown == {
        "walk.html"
    }  # which the site shows for walk.gif


MEASURED = """
import math
import numpy as np
from benchmarks.locomotion import margins
from benchmarks.locomotion.plots import MARKS

def run(quick, out, progress):
    walked = np.column_stack([np.arange(90.0)] * 4)
    np.savez(out / "courses.npz", **{f"{plot}/default": walked for plot in ("velocity", "path")})
    table = {"row": "v", "unit": "m/s", "goal": 1.0, "better": "larger"} | dict.fromkeys(MARKS, 2.0)
    found = dict.fromkeys(margins.SHOWN, math.nan) | {"kind": "margin", "friction": 0.2}
    return [table, *(found | {"voltage": volt} for volt in margins.VOLTAGE)], []
"""


def test_a_picture_keeps_the_colours_of_its_curves(tmp_path):
    """A few thin curves in colour beside many shades of grey."""
    shades = np.random.default_rng(0).integers(0, 256, (300, 300, 1)).repeat(3, axis=2)
    legs = [tuple(bytes.fromhex(colour[1:])) for colour in LEG_COLOURS.values()]
    shades[0, : 10 * len(legs)] = np.repeat(legs, 10, axis=0)
    Image.fromarray(shades.astype(np.uint8)).save(tmp_path / "x.png")
    pictures.shrink(tmp_path / "x.png")
    with Image.open(tmp_path / "x.png") as shown:
        assert np.abs(np.array(shown.convert("RGB"), int) - shades).max() <= 20


def test_pictures_of_a_benchmark_are_drawn_from_what_its_run_has_left(tmp_path):
    (tmp_path / "locomotion").mkdir()
    (tmp_path / "locomotion" / "benchmark.py").write_text(f'"""Tiny."""\n{MEASURED}')
    results = tmp_path / "results"
    harness.run("locomotion", tmp_path, True, results / "locomotion", print)
    mine = [name for name, p in pictures.PICTURES.items() if p.needs[0] == "locomotion"]
    assert len(mine) == 4
    assert (
        pictures.main([*mine, "--results", str(results), "--out", str(tmp_path)]) == 0
    )
    for name in mine:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_the_tables_of_arguments_topics_and_parameters_are_those_of_today(tmp_path):
    pages = [
        DOC / "reference" / f"{name}.md"
        for name in ("arguments", "topics", "parameters")
    ]
    for page in pages:
        shutil.copy(page, tmp_path)
    command = [sys.executable, "-m", "documentation.graph_tables", str(tmp_path)]
    path = os.pathsep.join([str(ROOT / "scripts"), os.environ.get("PYTHONPATH", "")])
    subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, check=True)
    old = [
        page.name
        for page in pages
        if (tmp_path / page.name).read_text() != page.read_text()
    ]
    assert old == [], "scripts/docs --tables writes them again"


def test_the_reference_has_every_message_and_service():
    text = (DOC / "reference" / "messages.md").read_text()
    files = [*(ROOT / "slot_msgs/msg").iterdir(), *(ROOT / "slot_msgs/srv").iterdir()]
    assert len(files) > 9
    for file in files:
        assert f"```{{literalinclude}} ../../../{file.relative_to(ROOT)}\n" in text


def settings_in(path, package):
    """Full names of the classes of a file with a field made by one of `FIELDS`."""
    module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
    for kind in ast.walk(ast.parse(path.read_text())):
        if isinstance(kind, ast.ClassDef):
            values = [
                line.value for line in kind.body if isinstance(line, ast.AnnAssign)
            ]
            calls = [
                ast.unparse(value.func)
                for value in values
                if isinstance(value, ast.Call)
            ]
            if {call.removeprefix("config.") for call in calls} & FIELDS:
                yield f"{module}.{kind.name}"


def test_the_reference_has_every_settings_class_and_file_of_the_configuration():
    packages = [ROOT / "src" / name / name for name in ("slot_core", "slot_lab")]
    described = {
        name
        for package in packages
        for path in package.rglob("*.py")
        for name in settings_in(path, package)
    }
    assert len(described) > 40
    text = (DOC / "reference" / "configuration.md").read_text()
    listed = set(re.findall(r"^\.\. autoclass:: (.*)$", text, re.MULTILINE))
    # read from a message, see decode.servo_limits; named on the command line
    others = {
        "slot_core.safety.settings.ServoLimits",
        "slot_core.control.onnx_policy.OnnxSettings",
    }
    assert described - listed == others
    for path in (ROOT / "config").glob("*.yaml"):
        assert f"```{{literalinclude}} ../../../config/{path.name}\n" in text


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["--output", "x"],
            "unknown arguments: --output x; expected --out DIR, --tables or --pictures",
        ),
        (["--out", "/dev/null"], "--out /dev/null: not a directory that can be made"),
    ],
)
def test_a_site_that_cannot_be_made_is_refused_before_the_work(arguments, reason):
    command = [ROOT / "scripts" / "docs", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (2, f"scripts/docs: {reason}\n")


def test_version_and_licence_are_the_same_everywhere():
    manifests = [ROOT / "slot_msgs", ROOT / "slot_bringup", *(ROOT / "src").iterdir()]
    packages = [ElementTree.parse(folder / "package.xml") for folder in manifests]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert len(packages) == 5
    assert {package.findtext("version") for package in packages} == {
        citation["version"]
    }
    assert {package.findtext("license") for package in packages} == {
        citation["license"]
    }
    assert f"## {citation['version']}" in (DOC / "changelog.md").read_text()
    assert "Apache License" in (ROOT / "LICENSE").read_text().splitlines()[1]


def test_the_readme_stays_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= README_LINES


def test_the_workflow_of_github_calls_what_there_is():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    lines = "\n".join(step.get("run", "") for step in steps)
    files = set(re.findall(r"(?:scripts|test|slot_bringup)/[\w/.]+", lines))
    assert len(files) > 5
    assert {file for file in files if not (ROOT / file).exists()} == set()
    arguments = set(re.findall(r"(\w+):=", lines))
    assert arguments <= {argument.name for argument in read_graph().arguments}
