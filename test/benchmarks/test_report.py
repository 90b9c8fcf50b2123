"""Report of results: one page that needs nothing else, and says where every figure is from."""

import base64
import json
import re
import shutil
import subprocess
from functools import cached_property
from html.parser import HTMLParser

import pytest

from benchmarks.harness import known
from benchmarks.locomotion.rows import rows as locomotion_rows
from benchmarks.perturbations.cases import TABLE
from benchmarks.report import paper_figures
from benchmarks.report.report import BENCHMARKS, CAPTIONS, DOC, main
from benchmarks.report.results import PNG, bench_command, fault_table

VOID = {"meta", "img", "br", "link", "hr", "input"}
CHROMIUM = shutil.which("chromium")
PICTURE = PNG + b"no more of it is read"
HOSTILE = "<script>alert('x')</script> & \"<b>\""
COLUMNS = ("row", "unit", "goal", "better", "gait alone", "paper", "default")
LOCOMOTION = [
    dict(zip(COLUMNS, row)) for row in (
        ("60 deg path, cross-track RMSE", "mm", 10.0, "smaller", 1.97, None, 2.72),
        ("fast", "m/s", 0.08, "larger", 0.0, 0.0, 0.07),
        ("odd \ud800", [1], "high", 3, 10**400, True, {}),
    )
]  # fmt: skip
LOCOMOTION.append(
    {"kind": "margin", "voltage": 9.6, "friction": 0.2, "speed": 0.0101, "load": None}
)
ERRORS = """\
point,axis,samples,range,rmse,mae,nrmse,mean_error,error,accuracy
base,z,9,0.1,0.00494,0.00372,0.056,0.00138,0.0157,0.9843
tip,z,9,0.1,0.00235,0.0021,nan,0.00207,0.31,0.69
"""


class Page(HTMLParser):
    """Elements of a page; refuses a tag that is not closed where it should be."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.text.append(" ")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    @cached_property
    def words(self):
        return " ".join("".join(self.text).split())

    def all(self, attribute):
        return [attrs[attribute] for _, attrs in self.tags if attribute in attrs]


def result(name, rows=(), checks=(), **others):
    return {
        "name": name,
        "quick": True,
        "options": {},
        "revision": {"commit": "1234", "describe": "v1-g1234", "dirty": True},
        "machine": {"cpu": "Z80", "architecture": "z80", "cores": 1, "system": "CP/M",
                    "python": "3", "numpy": "2"},
        "rows": list(rows),
        "checks": [dict(zip(("name", "value", "unit", "goal", "holds"), c)) for c in checks],
        **others,
    }  # fmt: skip


def write(directory, found):
    folder = directory / found["name"]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{found['name']}.json").write_text(json.dumps(found))
    return folder


def cases():
    """Rows of the perturbations benchmark: the paper's figures but for Pitch."""
    for case, (cost, *_) in TABLE.items():
        row = {"kind": "case", "study": "published", "case": case}
        yield row | {"max_cost": cost * (1.09 if case == "Pitch" else 1.001), "infeasible": 0}


def write_results(directory):
    """Results of three benchmarks and a comparison, with a hostile name and without values."""
    checks = [(HOSTILE, 0.125, "N", "<= 0.5", True), ("slow", None, "ms", "<= 2", False)]
    folder = write(directory, result("rod", checks=checks))
    (folder / "rod.png").write_bytes(PICTURE)
    (folder / "more.png").write_bytes(PICTURE + b"!")
    write(directory, result("perturbations", cases(), options={"seed": 7, "scheduler": ""}))
    write(directory, result("locomotion", LOCOMOTION))
    (directory / "mpc.json").write_text(json.dumps(result("mpc")))  # not in a folder of its own
    (directory / "mpc.png").write_bytes(PICTURE)
    (directory / "others.png").write_bytes(b"not read")
    (directory / "walk").mkdir()
    (directory / "walk" / "walk.png").write_bytes(PICTURE)
    (directory / "single_leg").mkdir()
    (directory / "single_leg" / "leg.png").write_bytes(PICTURE)
    (directory / "single_leg" / "errors.csv").write_text(ERRORS)
    (directory / "single_leg" / "summary.txt").write_text(f"run {HOSTILE}")
    return directory


@pytest.fixture
def results(tmp_path):
    return write_results(tmp_path)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Directory of the results, and the page of them."""
    directory = write_results(tmp_path_factory.mktemp("results"))
    out = directory / "deep" / "page.html"
    assert main(["--results", str(directory), "--out", str(out)]) == 0
    return directory, out.read_text()


@pytest.fixture(scope="module")
def text(made):
    return made[1]


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_a_page_is_well_formed_and_its_links_lead_into_it(page):
    ids = page.all("id")
    assert len(ids) == len(set(ids))
    assert {link.removeprefix("#") for link in page.all("href")} <= set(ids)


def test_a_page_loads_nothing_and_runs_nothing(page, text):
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "base"}
    assert all(source.startswith("data:image/") for source in page.all("src"))
    assert not re.search(r"https?://|url\(|@import", text)
    assert not [name for _, attrs in page.tags for name in attrs if name.startswith("on")]


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_a_browser_shows_the_page_and_complains_of_nothing(made, tmp_path):
    """Also of nothing that the page's own Content-Security-Policy forbids to load or to run."""
    options = "no-sandbox disable-gpu disable-sync no-first-run disable-background-networking"
    shown = subprocess.run(
        [CHROMIUM, "--headless", *(f"--{option}" for option in options.split()),
         f"--user-data-dir={tmp_path}", "--enable-logging=stderr", "--dump-dom",
         f"file://{made[0] / 'deep' / 'page.html'}"],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert "CONSOLE" not in shown.stderr
    assert Page(shown.stdout).all("src") == Page(made[1]).all("src")


def test_every_picture_of_the_results_is_inside_with_its_name(page):
    inside = [base64.b64decode(source.partition("base64,")[2]) for source in page.all("src")]
    assert inside[1:] == [PICTURE, PICTURE + b"!", PICTURE, PICTURE, PICTURE]
    assert "rod.png: speed against error" in page.words
    assert "more.png: more" in page.words
    assert "mpc.png: speed against error of the solvers" in page.words


def test_every_check_stands_with_value_goal_and_whether_it_holds(page):
    assert f"holds {HOSTILE} 0.125 N <= 0.5" in page.words
    assert "missed slow no value ms <= 2" in page.words
    assert "Of 2 checks of benchmarks 1 hold and 1 are missed" in page.words


def test_text_of_a_result_is_text_on_the_page(page, text):
    assert "<script" not in text
    assert page.words.count(HOSTILE) == 2


def test_a_result_names_command_revision_machine_and_file(made, page):
    command = "scripts/bench perturbations --quick --seed 7"
    assert f"{command} revision v1-g1234 with changes; Z80" in page.words
    assert str(made[0] / "perturbations" / "perturbations.json") in page.words
    options = {"a_b": True, "c": False, "d": "e f", "g": 0.0, "h": None, "i": ""}
    assert bench_command("x", False, options) == "scripts/bench x --a-b --d 'e f' --g 0.0"


def test_what_is_missing_is_named_with_the_command_that_makes_it(made, page):
    missing = page.words.rpartition("What is missing")[2]
    there = {"rod", "perturbations", "locomotion", "mpc"}
    for name in known(BENCHMARKS).keys() - there:
        assert f"{name}: scripts/bench {name} --out {made[0] / name}" in missing
    assert f"crawl: scripts/run --lockstep --gait crawl --bag {made[0] / 'crawl'}" in missing
    assert "Missing: robot.png, constraint_map.png. The commands above make it." in page.words
    assert not [name for name in there if f"{name}:" in missing]


def test_figures_stand_beside_the_papers_with_a_verdict(page):
    assert "Baseline 4.9739 1.1665 0 14.553 0 4.979 reproduced no value" in page.words
    assert "Pitch 4.792 1.112 0 13.695 0 5.223 not reproduced" in page.words
    assert "Noise 2.3828 0.2212 0.4943 never 0 2.385 no value" in page.words
    assert "RMSE, mm 5.2 5.72 4 0.89 4.94 no value no value 2.35" in page.words
    assert "RMSE of the path, mm 35 2.72 better" in page.words
    assert "a step (four times 0.35, and 0.18) 1.58 result missing" in page.words


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


def test_the_locomotion_table_has_its_three_columns_and_marks_what_is_missed(page):
    assert "60 deg path, cross-track RMSE mm <= 10 1.97 no value 2.72 holds" in page.words
    assert "fast m/s >= 0.08 0 0 0.07 missed" in page.words
    assert "[1] <= no value no value no value no value missed" in page.words


def test_the_margins_have_a_table_of_their_own(page):
    assert "9.6 0.2 0.0101 no value no value no value no value" in page.words
    assert "margin <=" not in page.words


def test_figures_are_looked_up_under_names_that_the_benchmarks_use():
    wanted = [
        ours for table in paper_figures.comparisons() for line in table.lines
        for ours in line.ours if ours is not None
    ]  # fmt: skip
    runs = {run.folder for run in paper_figures.RUNS}
    assert {ours.result for ours in wanted} <= known(BENCHMARKS).keys() | runs
    found = {ours.match["row"] for ours in wanted if ours.result == "locomotion"}
    assert found <= {row.name for row in locomotion_rows(quick=True)}
    assert CAPTIONS.keys() <= known(BENCHMARKS).keys()


def test_the_fault_table_is_that_of_the_page(page):
    table = fault_table(DOC / "safety.md")
    assert table[0] == ["at 1 s of a walk", "sim", "fake_bus"]
    assert {len(row) for row in table} == {3}
    assert len(table) > 20
    assert all(" ".join(row) in page.words for row in table)


NONSENSE = {
    "not JSON": "{",
    "no mapping": "[1, 2]",
    "another name": json.dumps(result("mpc")),
    "no checks": json.dumps({"name": "rod", "quick": False, "options": {}}),
    "NaN": json.dumps(result("rod", checks=[("a", float("nan"), "", "", True)])),
    "text as value": json.dumps(result("rod", checks=[("a", "1", "", "", True)])),
    "huge value": json.dumps(result("rod", checks=[("a", 10**400, "", "", True)])),
    "number as holds": json.dumps(result("rod", checks=[("a", 1, "", "", 1)])),
    "rows of text": json.dumps(result("rod", ["a"])),
    "no revision": json.dumps(result("rod", revision=None)),
    "options of text": json.dumps(result("rod", options="--fast")),
    "nested": "[" * 100_000,
}


@pytest.mark.parametrize("text", NONSENSE.values(), ids=NONSENSE)
def test_a_file_that_is_no_result_is_refused_in_one_line(results, capsys, text):
    (results / "rod" / "rod.json").write_text(text)
    assert main(["--results", str(results), "--out", str(results / "page.html")]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"scripts/report: {results / 'rod' / 'rod.json'}: not ")
    assert len(line) < 400
    assert not (results / "page.html").exists()


@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("rod/rod.png", b"GIF89a", "rod/rod.png: not a picture"),
        ("rod/rod.json", b"\xff\xfe\x00", "not text in UTF-8"),
        ("single_leg/errors.csv", b"point,axis,rmse\nbase,z,much\n", "not a table of"),
        ("single_leg/metadata.yaml", b"nonsense", "single_leg: cannot be read"),
    ],
)
def test_a_damaged_file_beside_a_result_is_refused_in_one_line(
    results, capsys, file, content, said
):
    (results / file).write_bytes(content)
    assert main(["--results", str(results), "--out", str(results / "page.html")]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--results", "{}/nowhere"], "not a directory; scripts/bench NAME makes one"),
        (["--results", "{}", "--out", "{}/page.pdf"], "expected a name that ends in .html"),
        (["--results", "{}", "--out", "{}/rod/rod.json/page.html"], "File exists"),
    ],
)
def test_a_place_that_does_not_do_is_refused_in_one_line(results, capsys, arguments, said):
    assert main([argument.format(results) for argument in arguments]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert said in line
