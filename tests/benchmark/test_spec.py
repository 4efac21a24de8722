"""A benchmark's specification: what is read from it, and one clear line for everything that is wrong with it."""

from __future__ import annotations

import pytest

from polarmap.benchmark.cells import cells_of, select
from polarmap.benchmark.spec import MappingMethod, read_spec
from polarmap.errors import InputError

SEQUENCES = "sequences: [{name: room, path: room}]\n"
METHODS = "methods: [{name: ours}]\n"


@pytest.fixture
def read(tmp_path):
    """Read a specification from its text."""

    def from_text(text):
        path = tmp_path / "spec.yaml"
        path.write_text(text)
        return read_spec(path)

    return from_text


FULL = """
sequences:
  - {name: office, title: Office kt1, path: $RECORDINGS/office, frames: "0:300:2", published: office-kt1}
  - name: street
    synth: scene street --frames 60
methods:
  - name: ours
    poses: true
    settings: [paper.max_steps=48]
  - {name: own-poses, poses: odometry, prior: nets/small.onnx}
  - {name: colmap, kind: import, format: colmap, path: "colmap/{sequence}"}
seeds: [0, 3]
keep: figures
tables: [accuracy, confidence]
"""


def test_a_whole_specification(read, tmp_path, monkeypatch):
    monkeypatch.setenv("RECORDINGS", str(tmp_path / "elsewhere"))
    spec = read(FULL)
    office, street = spec.sequences
    assert office.path == str(tmp_path / "elsewhere" / "office")
    assert office.frame_slice == slice(0, 300, 2)
    assert (office.label, street.label) == ("Office kt1", "street")
    assert street.synth_arguments == ["scene", "street", "--frames", "60"]
    ours, own_poses, colmap = spec.methods
    assert (ours.kind, ours.poses, ours.prior) == ("polarmap", "true", "polarnet")
    assert (own_poses.poses, own_poses.prior) == ("odometry", str(tmp_path / "nets" / "small.onnx"))
    assert colmap.path == str(tmp_path / "colmap" / "{sequence}")
    assert (spec.seeds, spec.keep, spec.tables) == ([0, 3], "figures", ["accuracy", "confidence"])


def test_a_relative_path_starts_from_the_specification(read, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    assert read(SEQUENCES + METHODS).sequences[0].path == str(tmp_path / "room")


def test_what_a_variable_holds_starts_from_the_working_directory(read, tmp_path, monkeypatch):
    here = tmp_path / "here"
    (here / "mine").mkdir(parents=True)
    monkeypatch.chdir(here)
    for name, value in (("RECORDINGS", "../recordings"), ("MINE", "mine"), ("KIND", "small")):
        monkeypatch.setenv(name, value)
    paths = ["${RECORDINGS}/room", "$MINE/room", "$KIND/$KIND"]
    spec = read(
        f"sequences: [{', '.join(f'{{name: n{i}, path: {path!r}}}' for i, path in enumerate(paths))}]\n{METHODS}"
    )
    expected = ["recordings/room", "here/mine/room", "small/small"]
    assert [s.path for s in spec.sequences] == [str(tmp_path / path) for path in expected]


def test_a_seed_is_run_only_where_it_plays_a_part(read, monkeypatch):
    monkeypatch.setenv("RECORDINGS", "/recordings")
    cells = [cell.key for cell in cells_of(read(FULL))]
    assert cells == [
        ("office", "ours", 0),
        ("office", "own-poses", 0),
        ("office", "colmap", 0),
        ("office", "own-poses", 3),
        ("street", "ours", 0),
        ("street", "own-poses", 0),
        ("street", "colmap", 0),
        ("street", "ours", 3),
        ("street", "own-poses", 3),
    ]


def test_cells_are_chosen_by_patterns(read, monkeypatch):
    monkeypatch.setenv("RECORDINGS", "/recordings")
    cells = cells_of(read(FULL))
    assert [cell.key for cell in select(cells, ["office/own*"])] == [
        ("office", "own-poses", 0),
        ("office", "own-poses", 3),
    ]
    assert {cell.sequence.name for cell in select(cells, ["street"])} == {"street"}
    assert select(cells, []) == cells
    with pytest.raises(InputError, match=r"--only office/theirs: .* office/ours, office/own-poses"):
        select(cells, ["office/ours", "office/theirs"])


def test_yaml_true_means_the_true_poses(read):
    for text in ("true", "'true'", "yes"):
        method = read(SEQUENCES + f"methods: [{{name: ours, poses: {text}}}]").methods[0]
        assert isinstance(method, MappingMethod) and method.poses == "true"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (SEQUENCES, r"methods: is missing"),
        (METHODS + "sequences: []", r"sequences: list should have at least 1 item"),
        (METHODS + "sequences: {}", r"sequences: input should be a valid list"),
        (SEQUENCES + METHODS + "seed: [1]", r"seed: there is no such key; known are sequences, methods, seeds, keep"),
        (SEQUENCES + METHODS + "seeds: [true]", r"seeds\[0\]: input should be a valid integer"),
        (SEQUENCES + METHODS + "seeds: [-1]", r"seeds\[0\]: input should be greater than or equal to 0"),
        (SEQUENCES + METHODS + "seeds: [1, 1]", r"seeds: 1 is there twice"),
        (SEQUENCES + METHODS + "keep: all", r"keep: input should be 'run' or 'figures'"),
        (SEQUENCES + METHODS + "tables: [speed]", r"tables\[0\]: input should be 'accuracy', 'ablation'"),
        (SEQUENCES + "methods: [3]", r"methods\[0\]: must be a mapping whose kind is polarmap or import"),
        (SEQUENCES + "methods: [{name: a, kind: colmap}]", r"methods\[0\]: .*kind is polarmap or import"),
        (SEQUENCES + "methods: [{name: a, kind: import}]", r"methods\[0\]\.path: is missing"),
        (
            SEQUENCES + "methods: [{name: a, kind: import, path: x, keyframes_of: b}, {name: b}]",
            r"a: keyframes_of: b is",
        ),
        (SEQUENCES + "methods: [{name: a, pose: true}]", r"methods\[0\]\.pose: .*; known are name, title, kind, poses"),
        (
            SEQUENCES + "methods: [{name: a, poses: given}]",
            r"methods\[0\]\.poses: input should be 'true' or 'odometry'",
        ),
        (SEQUENCES + "methods: [{name: ../a}]", r"methods\[0\]\.name: must be letters, digits"),
        (SEQUENCES + "methods: [{name: a}, {name: A}]", r"methods: a is there twice"),
        (SEQUENCES + "methods: [{name: a, title: x}, {name: b, title: x}]", r"methods: x is there twice"),
        (SEQUENCES + "methods: [{name: a, prior: $NO_SUCH/net.onnx}]", r"methods\[0\]\.prior: \$NO_SUCH is not set"),
        (METHODS + "sequences: [{name: a}]", r"sequences\[0\]: needs either path"),
        (METHODS + "sequences: [{name: a, path: a, synth: b}]", r"sequences\[0\]: needs either path"),
        (METHODS + "sequences: [{name: a, synth: 'scene \"x'}]", r"sequences\[0\]: synth: No closing quotation"),
        (METHODS + "sequences: [{name: a, synth: ''}]", r"sequences\[0\]: synth: must name"),
        (METHODS + "sequences: [{name: a, synth: scene x --seed 1}]", r"sequences\[0\]: synth: leave --seed out"),
        (METHODS + "sequences: [{name: a, path: a, frames: 10:50}]", r"sequences\[0\]\.frames: write it in quotes"),
        (METHODS + "sequences: [{name: a, path: a, frames: '1:9:0'}]", r"sequences\[0\]\.frames: must be A:B"),
        (METHODS + "sequences: [{name: a, path: a, published: kt9}]", r"published: must be one of .*office-kt3"),
        ("sequences: [1,\n", r"not valid YAML at line 2: "),
        ("!!python/object/apply:os.system ['true']", r"not valid YAML at line 1: the tag .* is not known"),
        ("- room", r"must map sequences and methods to lists"),
        ("", r"must map sequences and methods to lists"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(read, tmp_path, text, problem):
    with pytest.raises(InputError, match=problem) as raised:
        read(text)
    assert str(raised.value).startswith(f"{tmp_path / 'spec.yaml'}: ")
    assert "\n" not in str(raised.value)


def test_a_missing_specification(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.yaml: no such file"):
        read_spec(tmp_path / "nowhere.yaml")


def test_a_huge_specification_is_not_read(tmp_path):
    path = tmp_path / "spec.yaml"
    path.write_bytes(b"#" * (1 << 20) + b"\n")
    with pytest.raises(InputError, match="bytes, more than"):
        read_spec(path)
