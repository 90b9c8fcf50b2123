"""Report of results: one page in Markdown that says where every figure is from."""

import json
import re

import pytest

from benchmarks.report.report import main

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
            dict(zip(("name", "value", "unit", "goal", "holds"), c))
            for c in checks
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
    write(directory, result("perturbations"))
    write(directory, result("locomotion", LOCOMOTION))
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
def page(tmp_path_factory):
    """Text of the results' page."""
    directory = write_results(tmp_path_factory.mktemp("results"))
    out = directory / "deep" / "page.md"
    assert main(["--results", str(directory), "--out", str(out)]) == 0
    return out.read_text()


def test_names_in_a_result_are_taken_as_text(page):
    assert page.count(f"| holds | {ESCAPED} | 0.125 N | \\<= 0.5 |") == 1
    assert "| **missed** | slow | no value ms | \\<= 2 |" in page
    assert "| [rod](#rod) | slow |" in page


def test_a_result_stands_with_its_command_revision_and_machine(page):
    (section,) = re.findall(r"### perturbations\n(.*?)\n### ", page, re.DOTALL)
    assert "```bash\nscripts/bench perturbations --quick\n```" in section
    assert "revision v1-g1234 with changes; Z80, z80, 1 cores" in section
    assert "| fast | m/s | \\>= 0.08 | 0 | 0 | 0.07 |" in page


RESULT = "rod/rod.json"
NONSENSE = {
    "not JSON": (RESULT, b"{", "not "),
    "no mapping": (RESULT, b"[1, 2]", "not "),
    "another name": (RESULT, json.dumps(result("mpc")).encode(), "not "),
    "no checks": (RESULT, b'{"name": "rod", "quick": false}', "not "),
    "text": (RESULT, json.dumps(result("rod", ["a"])).encode(), "not "),
    "no revision": (
        RESULT,
        json.dumps(result("rod", revision=None)).encode(),
        "not ",
    ),
    "nested": (RESULT, b"[" * 100_000, "not "),
    "bytes": (RESULT, b"\xff\xfe\x00", "not text in UTF-8"),
    "table": (
        "single_leg/errors.csv",
        b"point,axis,rmse\nbase,z,much\n",
        "not a table of",
    ),
    "bag": (
        "single_leg/metadata.yaml",
        b"nonsense",
        "single_leg: cannot be read",
    ),
}


@pytest.mark.parametrize("kind", NONSENSE)
def test_a_file_that_is_no_result_is_refused_in_one_line(
    results, refusal, kind
):
    file, content, said = NONSENSE[kind]
    (results / file).write_bytes(content)
    line = refusal(main, "--results", results, "--out", results / "page.md")
    assert line.startswith(f"scripts/report: {(results / file).parent}")
    assert said in line
    assert not (results / "page.md").exists()


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
    assert said in refusal(
        main, "--results", results / folder, "--out", results / out
    )
