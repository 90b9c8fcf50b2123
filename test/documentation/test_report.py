"""The paper's figures beside ours: one page in Markdown."""

import json

import pytest

from benchmarks import harness
from documentation.report import main

ERRORS = """\
point,axis,rmse,mae,nrmse,error
base,z,0.00494,0.00372,0.056,0.0157
tip,z,0.00235,0.0021,nan,0.31
"""


def result(name, rows=(), **others):
    revision = {"commit": "1234", "describe": "v1-g1234", "dirty": True}
    about = {"name": name, "quick": True, "revision": revision}
    found = about | {"machine": harness.machine(), "rows": list(rows)}
    return json.dumps(found | {"checks": []} | others)


@pytest.fixture
def results(tmp_path):
    """Two results: a figure of the paper's solver, and errors of a leg."""
    for name in ("mpc", "single_leg"):
        (tmp_path / name).mkdir()
    solver = {"kind": "solver", "solver": "clarabel", "tolerance": 1e-10}
    rows = [solver | {"median_ms": 3.1}]
    (tmp_path / "mpc" / "mpc.json").write_text(result("mpc", rows))
    (tmp_path / "single_leg" / "errors.csv").write_text(ERRORS)
    return tmp_path


def test_ours_stand_beside_the_papers_with_verdict_and_origin(results):
    out = results / "deep" / "page.md"
    assert main(["--results", str(results), "--out", str(out)]) == 0
    page = out.read_text()
    assert "| 6.2 | 3.1 better |" in page
    assert (
        "| 5.2 | 5.72 | 4 | 0.89 | 4.94 | no value | no value | 2.35 |" in page
    )
    assert "revision v1-g1234 with changes" in page
    assert "| graph | missing: `scripts/bench graph` |" in page


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("mpc/mpc.json", b"{"),
        ("mpc/mpc.json", b"[1, 2]"),
        ("mpc/mpc.json", result("rod").encode()),  # another name
        ("mpc/mpc.json", b'{"name": "mpc", "quick": false}'),  # no checks
        ("mpc/mpc.json", result("mpc", ["a"]).encode()),
        ("mpc/mpc.json", result("mpc", revision=None).encode()),
        ("mpc/mpc.json", b"[" * 100_000),
        ("mpc/mpc.json", b"\xff\xfe\x00"),
        ("single_leg/errors.csv", b"point,axis,rmse\nbase,z,much\n"),
    ],
)
def test_a_file_that_is_no_result_is_refused_in_one_line(
    results, refusal, file, content
):
    (results / file).write_bytes(content)
    line = refusal(main, "--results", results, "--out", results / "page.md")
    assert f"{file}: not " in line
    assert not (results / "page.md").exists()


@pytest.mark.parametrize(
    ("folder", "out", "said"),
    [
        ("nowhere", "page.md", "not a directory; scripts/bench NAME makes one"),
        ("", "page.pdf", "expected a name that ends in .md"),
        ("", "mpc/mpc.json/page.md", "File exists"),
    ],
)
def test_a_place_that_does_not_do_is_refused_in_one_line(
    results, refusal, folder, out, said
):
    assert said in refusal(
        main, "--results", results / folder, "--out", results / out
    )
