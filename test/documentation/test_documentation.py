"""The documentation: links that lead somewhere, pictures and tables of today."""

import filecmp
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from benchmarks import harness
from documentation import DOC, ROOT, pictures
from slot_bringup.graph import read_graph

PAGES = [ROOT / "README.md", *sorted(DOC.rglob("*.md"))]
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


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


def test_every_picture_is_drawn_by_a_command_and_shown_on_a_page():
    files = {p.name for p in DOC.iterdir() if p.suffix in (".png", ".gif", ".html")}
    assert files == set(pictures.PICTURES)
    links = {
        Path(link).name for page in PAGES for link in LINK.findall(page.read_text())
    }
    assert files - links == {"walk.html"}  # which the site shows for walk.gif


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
    old = DOC / "reference"
    names = [f"{name}.md" for name in ("arguments", "topics", "parameters")]
    for name in names:
        shutil.copy(old / name, tmp_path)
    command = [sys.executable, "-m", "documentation.graph_tables", str(tmp_path)]
    path = os.pathsep.join([str(ROOT / "scripts"), os.environ.get("PYTHONPATH", "")])
    subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, check=True)
    same, *different = filecmp.cmpfiles(old, tmp_path, names, shallow=False)
    assert same == names, f"scripts/docs --tables writes them again: {different}"


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
    for name in ("version", "license"):
        assert {p.findtext(name) for p in packages} == {citation[name]}


def test_the_workflow_of_github_calls_what_there_is():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    lines = "\n".join(step.get("run", "") for step in steps)
    files = set(re.findall(r"(?:scripts|test|slot_bringup)/[\w/.]+", lines))
    assert len(files) > 5
    assert {file for file in files if not (ROOT / file).exists()} == set()
    arguments = set(re.findall(r"(\w+):=", lines))
    assert arguments <= {argument.name for argument in read_graph().arguments}
