"""Tables of a benchmark: medians and spreads, published figures marked as such, and exact text in every format."""

from __future__ import annotations

import csv
import json
import math

import pytest

from polarmap.benchmark import published
from polarmap.benchmark.cells import CellResult, Curve
from polarmap.benchmark.entries import Entry, Figure, Notes, mean, measured, printed
from polarmap.benchmark.formats import csv_text, entry_text, json_text, latex, latex_text, markdown
from polarmap.benchmark.output import write_outputs
from polarmap.benchmark.plots import confidence_plot, wall_plot
from polarmap.benchmark.spec import Spec
from polarmap.benchmark.tables import Column, Row, Table, tables_of

NAN = float("nan")
ABS_REL = Figure("depth.abs_rel", "AbsRel", 4)


def result(seed=0, sequence="room", method="ours", reason=None, curves=None, notes=(), **figures) -> CellResult:
    return CellResult(
        status="failed" if reason else "complete",
        sequence=sequence,
        method=method,
        seed=seed,
        configuration={},
        reason=reason,
        started="2020-01-01T00:00:00+00:00",
        seconds=1.0,
        figures={name.replace("__", "."): value for name, value in figures.items()},
        curves=curves or {},
        notes=list(notes),
        versions={"polarmap": "1.2.3"},
        processor="Abacus",
        cpu_count=2,
    )


def test_an_entry_is_the_median_with_its_spread():
    results = [result(seed, depth__abs_rel=value) for seed, value in enumerate((0.05, 0.02, 0.03))]
    entry = measured(results, ABS_REL, Notes())
    assert (entry.median, entry.low, entry.high, entry.seeds) == (0.03, 0.02, 0.05, 3)
    assert entry_text(entry) == "0.0300 [0.0200–0.0500]"
    assert entry_text(measured(results[:1], ABS_REL, Notes())) == "0.0500"


def test_failed_seeds_are_left_out_and_noted():
    notes = Notes()
    results = [result(0, depth__abs_rel=0.1), result(1, reason="no frame"), result(2, reason="no frame")]
    assert entry_text(measured(results, ABS_REL, notes)) == "0.1000 (1)"
    assert entry_text(measured(results[1:], ABS_REL, notes)) == "failed (1)"
    assert notes.lines == ["room, ours, seed 1, 2: failed: no frame"]


def test_what_was_not_run_or_not_measured():
    assert entry_text(measured([None, None], ABS_REL, Notes())) == "not run"
    assert measured([result(depth__abs_rel=NAN)], ABS_REL, Notes()) is None
    assert measured([result()], ABS_REL, Notes()) is None
    assert entry_text(measured([result(depth__abs_rel=0.2), None], ABS_REL, Notes())) == "0.2000"
    assert entry_text(None) == "–"


def test_a_mean_wants_all_of_its_parts():
    entries = [Entry("measured", 1.0, 0.0, 3.0, 2), Entry("measured", 2.0, 2.0, 2.0, 1)]
    assert entry_text(mean(entries, 1)) == "1.5"
    assert mean([*entries, None], 1) is None
    assert mean([*entries, Entry("failed")], 1) is None


TABLE = Table(
    name="small",
    title="A_table",
    label_headings=("figure", "sequence"),
    columns=(Column("ours|50 %"), Column("DSO", published=True)),
    rows=(
        Row(("AbsRel", "room_1 & <b>"), (Entry("measured", 0.025, 0.02, 0.03, 2, 4, (1,)), None)),
        Row(("AbsRel", "kt0"), (None, printed(0.0864, 4)), published=True),
    ),
    notes=("room_1, ours, seed 2: failed: a*b",),
    remarks=("Measured.",),
)


def test_markdown():
    assert markdown(TABLE) == (
        "### A\\_table\n"
        "\n"
        "| figure | sequence | ours\\|50 % | DSO (published) |\n"
        "| :-- | :-- | --: | --: |\n"
        "| AbsRel | room\\_1 & \\<b> | 0.0250 [0.0200–0.0300] (1) | – |\n"
        "| AbsRel | kt0 (published) | – | *0.0864* |\n"
        "\n"
        "1. room\\_1, ours, seed 2: failed: a\\*b\n"
        "\n"
        "Measured.\n"
    )


def test_latex():
    assert latex(TABLE) == (
        "% A_table\n"
        "\\begin{tabular}{llrr}\n"
        "\\hline\n"
        "figure & sequence & ours\\textbar{}50 \\% & DSO (published) \\\\\n"
        "\\hline\n"
        "AbsRel & room\\_1 \\& $<$b$>$ & 0.0250 [0.0200--0.0300] (1) & -- \\\\\n"
        "AbsRel & kt0 (published) & -- & \\textit{0.0864} \\\\\n"
        "\\hline\n"
        "\\end{tabular}\n"
        "\\par\\footnotesize (1) room\\_1, ours, seed 2: failed: a*b\n"
        "\\par\\footnotesize Measured.\n"
    )


def test_latex_escapes_everything_that_is_a_command():
    assert latex_text("\\input{x} 5% $a_b^c$ #1 ~& δ < 1.25°\nnext") == (
        r"\textbackslash{}input\{x\} 5\% \$a\_b\textasciicircum{}c\$ \#1 \textasciitilde{}\& "
        r"$\delta$ $<$ 1.25$^\circ$ next"
    )


def test_csv():
    assert csv_text(TABLE) == (
        "figure,sequence,column,source,median,min,max,seeds,notes\n"
        'AbsRel,room_1 & <b>,ours|50 %,measured,0.025,0.02,0.03,2,"room_1, ours, seed 2: failed: a*b"\n'
        "AbsRel,kt0,DSO,published,0.0864,0.0864,0.0864,,\n"
    )


def test_json():
    values = json.loads(json_text(TABLE))
    assert values["columns"][1] == {"title": "DSO", "published": True}
    assert values["rows"][0]["entries"][0] == {
        "source": "measured",
        "median": 0.025,
        "low": 0.02,
        "high": 0.03,
        "seeds": 2,
        "digits": 4,
        "marks": [1],
    }
    assert values["rows"][0]["entries"][1] is None
    failed = Table("t", "t", ("a",), (Column("b"),), (Row(("c",), (Entry("failed"),)),))
    assert json.loads(json_text(failed))["rows"][0]["entries"][0]["median"] is None


def spec(**changes) -> Spec:
    return Spec.model_validate(
        {
            "sequences": [
                {"name": "room", "path": "/room"},
                {"name": "kt1", "title": "My kt1", "path": "/kt1", "published": "living-room-kt1"},
            ],
            "methods": [{"name": "ours"}, {"name": "colmap", "kind": "import", "path": "/c/{sequence}"}],
            **changes,
        }
    )


RESULTS = {
    ("room", "ours", 0): result(
        depth__abs_rel=0.02,
        depth__points=100.0,
        depth__density=0.5,
        stages__inliers__abs_rel=0.01,
        stages__inliers__points=40.0,
        run__map_points=77.0,
        curves={"confidence": Curve(x=[0.1, 0.5], y=[0.01, 0.02])},
        notes=["2 of 9 frames have no pose"],
    ),
    ("room", "colmap", 0): result(method="colmap", reason="no such folder"),
    ("kt1", "ours", 0): result(sequence="kt1", depth__abs_rel=0.04, depth__points=300.0, depth__density=0.75),
    ("kt1", "colmap", 0): None,
}


def lines_of(name, **changes) -> list[str]:
    table = next(t for t in tables_of(spec(**changes), RESULTS) if t.name == name)
    return [line for line in markdown(table).splitlines() if line.startswith("| ")][2:]


def test_the_papers_table_1_beside_what_was_measured():
    assert lines_of("accuracy") == [
        "| AbsRel | room | 0.0200 | failed (1) | – | – | – | – |",
        "| AbsRel | My kt1 | 0.0400 | not run | *0.1447* | *0.1299* | *0.0868* | *0.0602* |",
        "| AbsRel | Living room kt0 (published) | – | – | *0.1573* | – | *0.0864* | *0.0713* |",
        "| AbsRel | Office room kt1 (published) | – | – | *0.1274* | – | *0.0791* | *0.0720* |",
        "| AbsRel | Office room kt3 (published) | – | – | *0.2108* | *0.1622* | *0.0776* | *0.0793* |",
        "| points per image | room | 100 | failed (1) | – | – | – | – |",
        "| points per image | My kt1 | 300 | not run | – | – | – | – |",
        "| points per image | mean of all | 200 | – | *96673* | *284* | *1402* | *162784* |",
        "| density, % | room | 50.0 | failed (1) | – | – | – | – |",
        "| density, % | My kt1 | 75.0 | not run | – | – | – | – |",
        "| density, % | mean of all | 62.5 | – | *31.5* | *0.1* | *0.5* | *53.0* |",
    ]


def test_the_papers_table_2():
    lines = lines_of("ablation")
    assert lines[0] == "| room | ours | AbsRel | – | – | 0.0100 | – | – |"
    assert lines[-2:] == [
        "| Living room kt1 | paper's method | AbsRel (published) | *0.0868* | – | *0.0315* | *0.0587* | *0.0602* |",
        "| Living room kt1 | paper's method | points per image (published) "
        "| *1485* | – | *10362* | *125996* | *159237* |",
    ]


def test_the_papers_table_3():
    lines = lines_of("points")
    assert lines[0] == "| fused map | room | 77 | failed (1) | – | – | – | – |"
    assert lines[-1] == "| reconstructed | Lab3 (published) | – | – | *182931* | *186* | *654* | *804179* |"


def test_everything_published_is_marked_in_every_format():
    for table in tables_of(spec(), RESULTS):
        for row in table.rows:
            for column, entry in zip(table.columns, row.entries, strict=True):
                if entry is not None and entry.source == "published":
                    assert row.published or column.published
                    assert entry.seeds == 0
                elif entry is not None:
                    assert not row.published and not column.published
    rows = list(csv.DictReader(csv_text(tables_of(spec(), RESULTS)[0]).splitlines()))
    theirs = {row["column"] for row in rows if row["source"] == "published"}
    assert theirs == set(published.METHODS)


def test_only_the_tables_that_are_asked_for():
    assert [t.name for t in tables_of(spec(tables=["points", "confidence"]), RESULTS)] == ["points"]


def test_remarks_say_what_it_was_measured_with():
    table = next(t for t in tables_of(spec(), RESULTS) if t.name == "figures_depth")
    assert table.remarks == (
        "Measured with polarmap 1.2.3.",
        "Measured on Abacus (2 processors).",
        "room, ours, seed 0: 2 of 9 frames have no pose.",
    )


def test_the_figures_of_the_paper_add_up():
    assert published.POINTS_PER_IMAGE[-1] / published.PIXELS == pytest.approx(0.53, abs=0.001)
    assert published.ABLATION["final"][0] == published.ABS_REL[published.ABLATION_SEQUENCE][-1]
    assert published.ABLATION["sparse"][0] == published.ABS_REL[published.ABLATION_SEQUENCE][2]
    assert all(len(values) == len(published.METHODS) for values in published.ABS_REL.values())
    assert set(published.ABS_REL) == set(published.SEQUENCES)


def test_the_plot_of_accuracy_against_density():
    figure = confidence_plot(spec(), RESULTS)
    (axes,) = figure.axes  # kt1 has no curve
    assert axes.get_title() == "room"
    ours, theirs = axes.lines
    assert ours.get_xdata().tolist() == [10.0, 50.0] and ours.get_ydata().tolist() == [0.01, 0.02]
    assert theirs.get_xdata()[0] == pytest.approx(52.99, abs=0.01)
    assert theirs.get_ydata()[0] == pytest.approx(0.0707, abs=1e-9)
    assert axes.get_ylim()[1] > 0.0707  # it can be seen
    assert "published" in [text.get_text() for text in figure.legends[0].get_texts()][-1]
    assert wall_plot(spec(), RESULTS) is None


def test_all_is_written(tmp_path):
    write_outputs(spec(), RESULTS, tmp_path)
    for name in ("accuracy", "ablation", "points", "wall", "figures_depth", "figures_surface", "figures_path"):
        for suffix in ("md", "csv", "tex", "json"):
            assert (tmp_path / "tables" / f"{name}.{suffix}").stat().st_size > 0
    assert (tmp_path / "plots" / "confidence.png").read_bytes().startswith(b"\x89PNG")
    svg = (tmp_path / "plots" / "confidence.svg").read_text()
    page = (tmp_path / "tables.md").read_text()
    assert "<svg" in svg and "![confidence](plots/confidence.svg)" in page and page.count("### ") == 7
    write_outputs(spec(), RESULTS, tmp_path)
    assert (tmp_path / "plots" / "confidence.svg").read_text() == svg  # the same figures, the same file


def test_a_result_without_figures_reads_back_as_nan():
    text = result(depth__abs_rel=NAN).model_dump_json()
    assert '"depth.abs_rel":null' in text
    assert math.isnan(CellResult.model_validate_json(text).figures["depth.abs_rel"])
