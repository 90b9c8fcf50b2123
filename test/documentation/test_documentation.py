"""The documentation: links that lead somewhere, pictures and tables of today."""

import filecmp
import json
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

from benchmarks import harness
from benchmarks.locomotion import margins
from benchmarks.locomotion.plots import COLOURS
from documentation import DOC, ROOT, figure_page, pictures
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


def write_result(results):
    """A result of the benchmark of locomotion, with courses, that a full run has left."""
    row = {"row": "lateral error, split friction", "unit": "mm", "goal": 20.0}
    table = row | {"better": "smaller"} | dict.fromkeys(COLOURS, 2.0)
    margin = dict.fromkeys(margins.SHOWN) | {"kind": "margin", "friction": 0.2}
    found = {
        "name": "locomotion",
        "quick": False,
        "revision": {"commit": "1234", "describe": "v1", "dirty": False},
        "machine": harness.machine(),
        "rows": [table, *(margin | {"voltage": volt} for volt in margins.VOLTAGE)],
        "checks": [vars(harness.at_most("slow", 3.0, 2.0, "ms"))],
    }
    folder = results / "locomotion"
    folder.mkdir()
    (folder / "locomotion.json").write_text(json.dumps(found))
    course = np.column_stack([np.arange(90.0)] * 4)
    curves = {f"{plot}/default": course for plot in ("velocity", "path")}
    np.savez(folder / "courses.npz", **curves)


def test_pictures_of_a_benchmark_are_drawn_from_what_its_run_has_left(tmp_path):
    write_result(tmp_path)
    drawn = {n for n, p in pictures.PICTURES.items() if p.benchmark == "locomotion"}
    assert len(drawn) == 4
    place = ["--results", str(tmp_path), "--out", str(tmp_path)]
    assert pictures.main([*drawn, *place]) == 0
    for name in drawn:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_the_page_of_figures_shows_results_keeps_older_ones_and_names_the_missing(
    tmp_path,
):
    write_result(tmp_path)
    out = tmp_path / "figures.md"
    out.write_text("# Figures\n\n## locomotion\n\nearlier\n\n## rod\n\nkept\n")
    assert figure_page.main(["--results", str(tmp_path), "--out", str(out)]) == 0
    page = out.read_text()
    assert "| slow | 3 ms | \\<= 2 | **missed** |" in page
    assert "| lateral error, split friction | mm | 20 | 2 | 2 | 2 | 2 |" in page
    assert "A full run, revision v1; " in page
    assert "![locomotion: margins](margins.png)" in page
    assert "## rod\n\nkept\n" in page
    assert "## servo\n\nNot measured yet: `scripts/bench servo`." in page
    assert "earlier" not in page


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
            "unknown arguments: --output x; "
            "expected --out DIR, --tables, --pictures or --figures",
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
