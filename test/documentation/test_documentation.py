"""The documentation: links that lead somewhere, pictures and tables of today."""

import filecmp
import json
import re
import shutil
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from benchmarks import harness
from benchmarks.locomotion import margins
from benchmarks.locomotion.plots import COLOURS
from documentation import DOC, ROOT, figure_page, graph_tables, pictures

PAGES = [ROOT / "README.md", *sorted(DOC.rglob("*.md"))]
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def anchors(page):
    """Anchors of the headings of a page, as GitHub and MyST name them."""
    headings = re.findall(
        r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.MULTILINE
    )
    return {
        re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings
    }


@pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_every_link_leads_to_a_file_and_to_a_heading_in_it(page):
    text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", page.read_text()))
    for link in re.findall(r"\]\((?!https://)([^)\s]+)\)", text):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_pictures_and_figures_are_made_of_what_a_benchmark_has_left(tmp_path):
    row = {"row": "lateral error, split friction", "unit": "mm", "goal": 20.0}
    margin = dict.fromkeys(margins.SHOWN) | {"kind": "margin", "friction": 0.2}
    rows = [margin | {"with": "", "voltage": v} for v in margins.VOLTAGE]
    rows.append(row | {"better": "smaller"} | dict.fromkeys(COLOURS, 2.0))
    revision = {"commit": "1234", "describe": "v1", "dirty": False}
    found = {"name": "locomotion", "quick": False, "rows": rows, "checks": []}
    found |= {"revision": revision, "machine": harness.machine()}
    folder, page = tmp_path / "locomotion", tmp_path / "figures.md"
    folder.mkdir()
    (folder / "locomotion.json").write_text(json.dumps(found))
    course = np.column_stack([np.arange(90.0)] * 4)
    curves = {f"{plot}/default": course for plot in ("velocity", "path")}
    np.savez(folder / "courses.npz", **curves)
    kinds = pictures.PICTURES.items()
    drawn = [n for n, p in kinds if p.benchmark == "locomotion"]
    results = ["--results", str(tmp_path), "--out"]
    assert pictures.main([*drawn, *results, str(tmp_path)]) == 0
    assert all((tmp_path / name).exists() for name in drawn)
    page.write_text("# Figures\n\n## rod\n\nkept\n")
    assert figure_page.main([*results, str(page)]) == 0
    assert "## rod\n\nkept\n" in page.read_text()


def test_the_tables_of_arguments_topics_and_parameters_are_those_of_today(
    tmp_path,
):
    names = [f"{name}.md" for name in ("arguments", "topics", "parameters")]
    for name in names:
        shutil.copy(DOC / "reference" / name, tmp_path)
    graph_tables.main(tmp_path)
    same, *others = filecmp.cmpfiles(
        DOC / "reference", tmp_path, names, shallow=False
    )
    assert same == names, f"scripts/docs --tables writes them again: {others}"


def test_version_and_licence_are_the_same_everywhere():
    manifests = [
        ROOT / "slot_msgs",
        ROOT / "slot_bringup",
        *(ROOT / "src").iterdir(),
    ]
    packages = [
        ElementTree.parse(folder / "package.xml") for folder in manifests
    ]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    for name in ("version", "license"):
        assert {p.findtext(name) for p in packages} == {citation[name]}
