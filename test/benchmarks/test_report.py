"""Report of results: one page in Markdown that says where every figure is from."""

import json
import math
import re

import pytest

from benchmarks.harness import known
from benchmarks.locomotion.rows import rows as locomotion_rows
from benchmarks.report import claims, paper_figures
from benchmarks.report.report import BENCHMARKS, CAPTIONS, main
from benchmarks.report.results import bench_command
from documentation.markdown import plain
from slot_core.robot import read_robot

HOSTILE = "<script>|`x`"
ESCAPED = r"\<script\>\|\`x\`"
COLUMNS = ("row", "unit", "goal", "better", "gait alone", "paper", "default")
LOCOMOTION = [  # the last row of a kind that no benchmark writes
    dict(zip(COLUMNS, ("fast", "m/s", 0.08, "larger", 0.0, 0.0, 0.07))),
    dict(zip(COLUMNS, ("odd \ud800", [1], "high", 3, 10**400, True, {}))),
]
ERRORS = """\
point,axis,samples,range,rmse,mae,nrmse,mean_error,error,accuracy
base,z,9,0.1,0.00494,0.00372,0.056,0.00138,0.0157,0.9843
tip,z,9,0.1,0.00235,0.0021,nan,0.00207,0.31,0.69
"""


def result(name, rows=(), checks=(), **others):
    return {
        "name": name,
        "quick": True,
        "options": {},
        "revision": {"commit": "1234", "describe": "v1-g1234", "dirty": True},
        "machine": {
            "cpu": "Z80",
            "architecture": "z80",
            "cores": 1,
            "system": "CP/M",
            "python": "3",
            "numpy": "2",
        },
        "rows": list(rows),
        "checks": [
            dict(zip(("name", "value", "unit", "goal", "holds"), c)) for c in checks
        ],
        **others,
    }


def write(directory, found):
    folder = directory / found["name"]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{found['name']}.json").write_text(json.dumps(found))
    return folder


def write_results(directory):
    """Results of three benchmarks and a comparison, with a hostile name and without values."""
    checks = [
        (HOSTILE, 0.125, "N", "<= 0.5", True),
        ("slow", None, "ms", "<= 2", False),
    ]
    folder = write(directory, result("rod", checks=checks))
    (folder / "rod.png").touch()
    (folder / "more.png").touch()
    write(directory, result("perturbations", options={"seed": 7, "scheduler": ""}))
    write(directory, result("locomotion", LOCOMOTION))
    (directory / "mpc.json").write_text(
        json.dumps(result("mpc"))
    )  # not in a folder of its own
    (directory / "mpc.png").touch()
    (directory / "others.png").touch()
    (directory / "walk").mkdir()
    (directory / "walk" / "walk.png").touch()
    (directory / "single_leg").mkdir()
    (directory / "single_leg" / "leg.png").touch()
    (directory / "single_leg" / "errors.csv").write_text(ERRORS)
    (directory / "single_leg" / "summary.txt").write_text(f"run {HOSTILE}")
    return directory


@pytest.fixture
def results(tmp_path):
    return write_results(tmp_path)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Directory of the results, and the text of their page."""
    directory = write_results(tmp_path_factory.mktemp("results"))
    out = directory / "deep" / "page.md"
    assert main(["--results", str(directory), "--out", str(out)]) == 0
    return directory, out.read_text()


@pytest.fixture(scope="module")
def page(made):
    return made[1]


def test_a_page_links_to_the_pictures_of_its_results_and_to_nothing_else(made):
    directory, page = made
    found = re.findall(r"!\[.*\]\((.*)\)", page)
    there = [
        "rod/rod.png",
        "rod/more.png",
        "mpc.png",
        "walk/walk.png",
        "single_leg/leg.png",
    ]
    linked = [(directory / "deep" / link).resolve() for link in found]
    assert linked == [directory.resolve() / file for file in there]
    outside = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
    assert not re.search(r"https?://|(?<!\\)<", outside)


def test_names_in_a_result_are_taken_as_text(page):
    assert page.count(f"| holds | {ESCAPED} | 0.125 N | \\<= 0.5 |") == 1
    assert "| **missed** | slow | no value ms | \\<= 2 |" in page
    assert "| [rod](#rod) | slow |" in page


def test_a_result_stands_with_its_command_revision_and_machine(page):
    (section,) = re.findall(r"### perturbations\n(.*?)\n### ", page, re.DOTALL)
    assert "```bash\nscripts/bench perturbations --quick --seed 7\n```" in section
    assert "revision v1-g1234 with changes; Z80, z80, 1 cores" in section
    assert "| fast | m/s | \\>= 0.08 | 0 | 0 | 0.07 | **missed** |" in page


def test_what_is_missing_is_named_with_the_command_that_makes_it(made):
    missing = made[1].rpartition("What is missing")[2]
    for name in known(BENCHMARKS).keys() - {
        "rod",
        "perturbations",
        "locomotion",
        "mpc",
    }:
        assert f"scripts/bench {name} --out {made[0] / name}" in missing
    assert f"scripts/run --lockstep --gait crawl --bag {made[0] / 'crawl'}" in missing


def test_without_results_the_papers_figures_stand_alone_with_what_would_be_beside_them(
    tmp_path,
):
    (tmp_path / "empty").mkdir()
    arguments = [
        "--results",
        str(tmp_path / "empty"),
        "--out",
        str(tmp_path / "page.md"),
    ]
    assert main(arguments) == 0
    tables = (tmp_path / "page.md").read_text().partition("The paper beside ours")[2]
    assert "| here: " not in tables
    assert "Not run: robot, mpc, graph." in tables


def test_a_command_repeats_the_options_of_its_result():
    options = {"a_b": True, "c": False, "d": "e f", "g": 0.0, "h": None, "i": ""}
    assert (
        bench_command("x", False, options) == "scripts/bench x --a-b --d 'e f' --g 0.0"
    )


@pytest.mark.parametrize(
    ("judged", "paper", "ours", "verdict"),
    [
        ("equal", 2.0, 2.009, "reproduced"),
        ("equal", 2.0, 2.011, "not reproduced"),
        ("equal", 0.0, 0.0, "reproduced"),
        ("smaller", 2.0, 1.0, "better"),
        ("smaller", 2.0, 2.009, "equal"),
        ("smaller", 2.0, 3.0, "worse"),
        ("larger", 2.0, 3.0, "better"),
        ("larger", 0.08, 0.08, "equal"),
        ("larger", "never", 3.0, ""),
        ("", 2.0, 2.0, ""),
    ],
)
def test_a_figure_is_judged_by_its_number(judged, paper, ours, verdict):
    assert paper_figures.judge(judged, paper, ours) == verdict


def test_figures_are_looked_up_under_names_that_the_benchmarks_use():
    wanted = [
        ours
        for table in paper_figures.comparisons()
        for line in table.lines
        for ours in line.ours
        if ours is not None
    ]
    runs = {run.folder for run in paper_figures.RUNS}
    assert {ours.result for ours in wanted} <= known(BENCHMARKS).keys() | runs
    found = {ours.match["row"] for ours in wanted if ours.result == "locomotion"}
    assert found <= {row.name for row in locomotion_rows(quick=False)}
    assert CAPTIONS.keys() <= known(BENCHMARKS).keys()


@pytest.mark.parametrize(
    "about",
    [
        "1.4 cm",
        "22.374 and 61.875 s",
        "crawl's centre of mass",
        "real time",
        "below 2 mm",
        "less than 5 mm",
        "1.5 N m; servos of 1.4 N m",
        "out-of-plane",
        "gyroscopic term",
        "Velocity settles in 10.098 s",
        "0.08 m/s at a height of 0.04 m",
        "4.792 of Pitch",
    ],
)
def test_a_claim_of_the_paper_has_one_verdict_and_a_reason(page, about):
    (claim,) = [claim for claim in claims.CLAIMS if about in claim.text]
    assert claim.verdict in claims.VERDICTS
    assert f"{plain(claim.text)} | {claim.verdict} | {plain(claim.reason)} |" in page


def test_every_claim_is_counted_once_under_its_verdict(page):
    count = [
        sum(c.verdict == verdict for c in claims.CLAIMS) for verdict in claims.VERDICTS
    ]
    assert sum(count) == len(claims.CLAIMS) > 40
    for number, verdict in zip(count, claims.VERDICTS):
        assert f"{number} {verdict}" in page


def test_what_the_papers_own_numbers_refute_is_so():
    weight, line = read_robot().weight, (6.0 + 6.91) / 0.107
    assert pytest.approx(1.58) == 4 * 0.35 + 0.18  # ms, of a step of 0.1 ms
    assert 3 * 6.0 < weight < 4 * 6.0
    assert line == pytest.approx(120.65, abs=0.01)
    assert pytest.approx(5.532, abs=1e-3) == 0.107 * 116.28 - 6.91
    assert (weight / 4 + 6.91) / 0.107 == pytest.approx(114.1, abs=0.1)
    assert math.hypot(0.052, 0.09) == pytest.approx(0.104, abs=1e-4)
    assert pytest.approx(0.495) == 15 * 0.033


NONSENSE = {
    "not JSON": "{",
    "no mapping": "[1, 2]",
    "another name": json.dumps(result("mpc")),
    "no checks": json.dumps({"name": "rod", "quick": False, "options": {}}),
    "NaN": json.dumps(result("rod", checks=[("a", float("nan"), "", "", True)])),
    "huge value": json.dumps(result("rod", checks=[("a", 10**400, "", "", True)])),
    "rows of text": json.dumps(result("rod", ["a"])),
    "no revision": json.dumps(result("rod", revision=None)),
    "nested": "[" * 100_000,
}


@pytest.mark.parametrize("text", NONSENSE.values(), ids=NONSENSE)
def test_a_file_that_is_no_result_is_refused_in_one_line(results, refusal, text):
    (results / "rod" / "rod.json").write_text(text)
    line = refusal(main, "--results", results, "--out", results / "page.md")
    assert line.startswith(f"scripts/report: {results / 'rod' / 'rod.json'}: not ")
    assert not (results / "page.md").exists()


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("rod/rod.json", b"\xff\xfe\x00", "not text in UTF-8"),
        ("single_leg/errors.csv", b"point,axis,rmse\nbase,z,much\n", "not a table of"),
        ("single_leg/metadata.yaml", b"nonsense", "single_leg: cannot be read"),
    ],
)
def test_a_damaged_file_beside_a_result_is_refused_in_one_line(
    results, refusal, file, content, said
):
    (results / file).write_bytes(content)
    assert said in refusal(main, "--results", results, "--out", results / "page.md")


@pytest.mark.parametrize(
    ("folder", "out", "said"),
    [
        ("nowhere", "page.md", "not a directory; scripts/bench NAME makes one"),
        ("", "page.pdf", "expected a name that ends in .md"),
        ("", "rod/rod.json/page.md", "File exists"),
    ],
)
def test_a_place_that_does_not_do_is_refused_in_one_line(
    results, refusal, folder, out, said
):
    assert said in refusal(main, "--results", results / folder, "--out", results / out)
