"""The documentation: links that lead somewhere, and a reference that leaves nothing out."""

import ast
import json
import re
import subprocess
from xml.etree import ElementTree

import pytest
import yaml
from real_graph import domain  # noqa: F401 - a fixture

from documentation import generated, nodes, pages
from documentation.markdown import DOC, ROOT
from slot_bringup.graph import read_graph

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
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
    found = {page.relative_to(DOC).with_suffix("").as_posix() for page in DOC.rglob("*.md")}
    assert found - set(listed) == {"index"}


def test_every_mark_stands_for_a_generated_part():
    marks = [mark for page in PAGES for mark in pages.MARK.findall(page.read_text())]
    assert sorted(marks) == sorted(pages.PARTS)
    with pytest.raises(ValueError, match="generated: nothing: expected one of readme, "):
        pages.read("<!-- generated: nothing -->", DOC / "index.md")


def test_the_front_page_is_the_readme_with_links_from_its_place():
    text = pages.read("<!-- generated: readme -->", DOC / "index.md")
    assert "# SLOT" in text
    assert "](../../src/slot_core/slot_core/control/policy.py)" in text
    assert "](graph.md#topics-and-services)" in text
    assert "[config](" not in text  # a folder has no page
    back = pages.read("[table](../../../README.md#results)", DOC / "reference" / "results.md")
    assert back == "[table](../index.md#results)"


def test_the_reference_has_every_message_and_service():
    text = generated.messages()
    files = [*(ROOT / "slot_msgs/msg").iterdir(), *(ROOT / "slot_msgs/srv").iterdir()]
    assert len(files) > 9
    for file in files:
        assert f"## {file.stem}\n" in text
        assert file.read_text() in text


def test_the_reference_has_every_argument_of_the_graph():
    text = generated.arguments()
    for argument in read_graph().arguments:
        assert f"`--{argument.name.replace('_', '-')}` | `{argument.name}`" in text


def settings_in(path):
    """Names of the classes of a file with a field made by one of `FIELDS`."""
    for kind in ast.walk(ast.parse(path.read_text())):
        if isinstance(kind, ast.ClassDef):
            values = [line.value for line in kind.body if isinstance(line, ast.AnnAssign)]
            calls = [ast.unparse(value.func) for value in values if isinstance(value, ast.Call)]
            if {call.removeprefix("config.") for call in calls} & FIELDS:
                yield kind.name


def test_the_reference_has_every_settings_class_and_file_of_the_configuration():
    core = ROOT / "src" / "slot_core" / "slot_core"
    described = {name for path in core.rglob("*.py") for name in settings_in(path)}
    assert len(described) > 40
    listed = {kind.__name__ for kind in generated.settings_classes()}
    assert described - listed == {"ServoLimits"}  # read from a message, see decode.servo_limits
    files = {path.name for path in (ROOT / "config").glob("*.yaml")}
    assert files <= set(generated.SETTINGS)


@pytest.fixture
def force_mapper(monkeypatch):
    """The reference of one node that needs no compilation, in place of all."""
    described = (nodes.describe("force_mapper", {}),)
    monkeypatch.setattr(nodes, "descriptions", lambda: described)


@pytest.mark.usefixtures("force_mapper")
def test_the_reference_has_what_a_node_declares():
    topics, parameters = nodes.topics(), nodes.parameters()
    angles = "| `/desired_joint_angles` | `sensor_msgs/JointState`, latched | force\\_mapper |  |"
    assert angles in topics
    state = "[`slot_msgs/MpcState`](messages.md#mpcstate), latched |  | force\\_mapper |"
    assert f"| `/mpc_state` | {state}" in topics
    assert "describe_parameters" not in topics
    assert "## force_mapper" in parameters
    assert "| `line_slope` | `0.107` |" in parameters
    assert "use_sim_time" not in parameters


def test_a_row_of_the_configuration_has_value_unit_bounds_and_meaning():
    row = "| `torso.mass` | `2` | kg | 0.02 to 20 | mass of the torso |"
    assert row in generated.configuration()


@pytest.mark.parametrize("holds", [True, False])
def test_results_of_a_benchmark_become_tables(tmp_path, monkeypatch, holds):
    (tmp_path / "results" / "tiny").mkdir(parents=True)
    check = {"name": "error", "value": 0.123456, "unit": "mm", "goal": "<= 1", "holds": holds}
    result = {
        "name": "tiny", "quick": True, "options": {}, "rows": [{"case": "a", "n": 3}],
        "revision": {"commit": "0", "describe": "v1", "dirty": True},
        "machine": {"cpu": "a cpu", "cores": 2, "python": "3.11.7"}, "checks": [check],
    }  # fmt: skip
    (tmp_path / "results" / "tiny" / "tiny.json").write_text(json.dumps(result))
    monkeypatch.setattr(generated, "ROOT", tmp_path)
    text = generated.results()
    assert "`scripts/bench tiny --quick`, revision v1, with changes, a cpu, 2 cores" in text
    assert f"| {'holds' if holds else '**missed**'} | error | 0.1235 | mm |" in text
    assert "| case | n |\n| --- | --- |\n| a | 3 |" in text


def test_a_damaged_result_is_named(tmp_path, monkeypatch):
    (tmp_path / "results" / "tiny").mkdir(parents=True)
    (tmp_path / "results" / "tiny" / "tiny.json").write_text('{"name": ')
    monkeypatch.setattr(generated, "ROOT", tmp_path)
    with pytest.raises(ValueError, match=r"results/tiny/tiny\.json: Expecting value"):
        generated.results()


def test_without_results_the_page_says_which_command_makes_them(tmp_path, monkeypatch):
    (tmp_path / "scripts/benchmarks/tiny").mkdir(parents=True)
    (tmp_path / "scripts/benchmarks/tiny/benchmark.py").write_text("")
    monkeypatch.setattr(generated, "ROOT", tmp_path)
    assert "`scripts/bench NAME` writes" in generated.results()
    assert "one of tiny." in generated.results()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--output", "x"], "unknown arguments: --output x; expected --out DIR"),
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
    assert {package.findtext("version") for package in packages} == {citation["version"]}
    assert {package.findtext("license") for package in packages} == {citation["license"]}
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
