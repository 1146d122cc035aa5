"""Suite files expand into cells, and anything wrong in one is a clean error."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panobench.bench.suite.file import read_suite
from panobench.cli.main import run as command
from panobench.errors import PanobenchError

pytestmark = pytest.mark.usefixtures("fake_plugin")

SUITE = """
name: demo
methods:
  - fake-still
  - {name: fake-options, preset: quick, set: {features: 5, inner.steps: [1, 2]}, cameras: erp,
     options: {depth: constant}}
cameras: [erp, "pinhole:front"]
datasets:
  - {name: tiny, sequences: [a, b]}
  - {name: tiny, sequences: all, options: {width: 64}}
seeds: [0, 1]
options: {width: 128, max_frames: 5, timeout_s: 9, memory_gib: 2, holdout: 4}
"""


def read(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    return read_suite(path)


def test_a_matrix_is_expanded(tmp_path: Path) -> None:
    suite = read(tmp_path, SUITE)
    assert suite.name == "demo"
    # still: 2 cameras, options: 1; times 2 + 3 sequences, 2 seeds
    assert len(suite.cells) == (2 + 1) * (2 + 3) * 2
    assert len({c.identity for c in suite.cells}) == len({c.slug for c in suite.cells}) == len(suite.cells)
    first = suite.cells[0]
    assert first.label == "fake-still erp 128 px 5 frames holdout 4 tiny/a seed 0"
    assert (first.request.width, first.request.max_frames, first.request.holdout) == (128, 5, 4)
    assert (first.limits.timeout_s, first.limits.memory_gib) == (9, 2)
    options = [c for c in suite.cells if c.request.method == "fake-options"]
    assert {c.request.camera for c in options} == {"erp"}
    assert {c.request.depth for c in options} == {"constant"}
    assert options[0].request.settings == {"features": 5, "inner.steps": [1, 2]}
    assert {c.request.width for c in options} == {128, 64}


def test_repeats_are_cells_of_their_own_and_doubles_are_not(tmp_path: Path) -> None:
    text = "methods: [fake-still, fake-still]\ndatasets: [{name: tiny, sequences: [a]}]\nrepeats: 3\n"
    assert [c.repeat for c in read(tmp_path, text).cells] == [0, 1, 2]


def test_data_that_are_not_there_keep_a_row(tmp_path: Path) -> None:
    text = f"methods: [fake-still]\ndatasets: [{{name: synpano, root: {tmp_path}/none, sequences: all}}]\n"
    suite = read(tmp_path, text)
    assert len(suite.cells) == 1
    assert "cannot be listed" in suite.notes[0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "a suite must be a mapping, not nothing"),
        ("- a\n- b\n", "a suite must be a mapping, not list"),
        ("methods: [a\n", "suite.yaml:2: not valid YAML"),
        ("method: [a]\n", "unknown suite key 'method': did you mean 'methods'"),
        ("methods: []\n", "methods must be a list with at least one entry"),
        ("methods: [fake-still]\n", "datasets must be a list"),
        ("methods: [fake-stil]\ndatasets: [tiny]\n", "did you mean 'fake-still'"),
        ("methods: [fake-still]\ndatasets: [tinny]\n", "did you mean 'tiny'"),
        ("methods: [{preset: x}]\ndatasets: [tiny]\n", "has no name"),
        ("methods: [{name: fake-still, sets: {}}]\ndatasets: [tiny]\n", "did you mean 'set'"),
        ("methods: [fake-still]\ndatasets: [tiny]\noptions: {widht: 3}\n", "did you mean 'width'"),
        ("methods: [fake-still]\ndatasets: [tiny]\noptions: {width: big}\n", "--width big"),
        ("methods: [fake-still]\ndatasets: [tiny]\noptions: {timeout_s: -1}\n", "timeout_s: '-1' is not a positive"),
        ("methods: [fake-still]\ndatasets: [tiny]\noptions: {memory_gib: .nan}\n", "memory_gib"),
        ("methods: [fake-still]\ndatasets: [tiny]\nseeds: [x]\n", "seeds: expected a whole number"),
        ("methods: [fake-still]\ndatasets: [tiny]\nseeds: [-1]\n", "seeds: expected a whole number"),
        ("methods: [fake-still]\ndatasets: [tiny]\nrepeats: 1000000\n", "more than 100000 cells"),
        ("methods: [{name: fake-still, set: {a: {b: 1}}}]\ndatasets: [tiny]\n", "must be a plain value"),
        ("a: &a [*a]\n", "or for themselves"),
        ("methods: &m [*m]\ndatasets: [tiny]\n", "or for themselves"),
        ("!!python/object/apply:os.system ['true']\n", "not valid YAML"),
        ("methods: [2001-02-30]\n", "not usable YAML"),
        ("[" * 1200, "YAML"),
    ],
)
def test_mistakes_are_clean_errors(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(PanobenchError) as caught:
        read(tmp_path, text)
    assert says in str(caught.value)


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(PanobenchError, match="the suite file is missing"):
        read_suite(tmp_path / "absent.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(PanobenchError, match="not UTF-8"):
        read_suite(tmp_path / "binary.yaml")
    (tmp_path / "large.yaml").write_bytes(b"#" * (1 << 21))
    with pytest.raises(PanobenchError, match="too large"):
        read_suite(tmp_path / "large.yaml")


scalars = st.one_of(st.none(), st.booleans(), st.integers(-3, 2000), st.floats(), st.text(max_size=8))
words = st.sampled_from(
    [
        "name",
        "methods",
        "cameras",
        "datasets",
        "seeds",
        "repeats",
        "options",
        "set",
        "preset",
        "root",
        "sequences",
        "width",
        "timeout_s",
        "fake-still",
        "tiny",
        "erp",
        "all",
        "a",
    ]
)
values = st.recursive(
    st.one_of(scalars, words),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.one_of(words, scalars), inner, max_size=4)),
    max_leaves=12,
)


@given(st.dictionaries(words, values, max_size=6))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_yaml_gives_cells_or_a_clean_error(tmp_path: Path, document: dict[str, Any]) -> None:
    try:
        suite = read(tmp_path, yaml.safe_dump(document))
    except PanobenchError:
        return
    assert suite.cells


@given(st.binary(max_size=200))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_give_a_clean_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bytes.yaml"
    path.write_bytes(content)
    with pytest.raises(PanobenchError):
        read_suite(path)


#: Packages under plugins/ whose methods a suite names.
PACKAGES = {
    "real-systems": {"panobench-stella-vslam", "panobench-orbslam3"},
    "inertial-pal": {"panobench-vins-mono", "panobench-lf-vislam"},
    "inertial-pinhole": {"panobench-vins-mono", "panobench-orbslam3"},
}


@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[2] / "reports" / "suites").glob("*.yaml")), ids=lambda p: p.stem
)
def test_the_suites_that_come_with_panobench_are_read_and_name_what_there_is(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from panobench.bench.run.config import method_config
    from panobench.bench.run.setup import check_camera
    from panobench.plugins import registry
    from panobench.specs import MethodSpec

    wanted = PACKAGES.get(path.stem, set())
    if not wanted <= {d.name for d in importlib.metadata.distributions()}:
        pytest.skip("needs " + " and ".join(sorted(wanted)))
    monkeypatch.delenv("PANOBENCH_DATA", raising=False)
    suite = read_suite(path)
    assert suite.name == path.stem
    assert suite.cells
    for request in {
        c.request.method + str(c.request.settings) + c.request.camera: c.request for c in suite.cells
    }.values():
        spec = registry().get(MethodSpec, request.method)
        method_config(spec, request.preset, request.settings)
        if path.stem.startswith("paper"):
            check_camera(request.camera, spec)


def test_editors_learn_what_may_stand_in_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The schema accepts what is read and refuses what is not."""
    jsonschema = pytest.importorskip("jsonschema")
    assert command(["suite", "schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    good = "methods: [{name: sparse, preset: fast, set: {features: 500}}, panogs]\ndatasets: rooms\nseeds: [0, 1]\n"
    for text in (SUITE, good + "options: {width: 64, timeout_s: 5}\n"):
        read(tmp_path, text)
        assert list(validator.iter_errors(yaml.safe_load(text))) == []
    bad = {
        "method: [a]\n": "method",
        "methods: [sparse]\n": "datasets",
        "methods: [spars]\ndatasets: [rooms]\n": "spars",
        "methods: [{name: sparse, set: {feature: 5}}]\ndatasets: [rooms]\n": "feature",
        "methods: [{name: sparse, preset: quick}]\ndatasets: [rooms]\n": "quick",
        "methods: [sparse]\ndatasets: [rooms]\noptions: {widht: 5}\n": "widht",
        "methods: [sparse]\ndatasets: [rooms]\nseeds: [-1]\n": "-1",
    }
    for text, culprit in bad.items():
        errors = [str(e.message) for e in validator.iter_errors(yaml.safe_load(text))]
        assert errors, text
        assert any(culprit in e for e in errors), errors
    described = schema["$defs"]["MethodEntry"]["allOf"]
    panogs = next(m["then"]["properties"]["set"]["properties"] for m in described if "panogs" in str(m["if"]))
    assert all(o["description"] for o in panogs.values())
    assert command(["suite", "schema", "-o", str(tmp_path / "s.json")]) == 0
    assert json.loads((tmp_path / "s.json").read_text()) == schema
