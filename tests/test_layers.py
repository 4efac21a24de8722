"""No room of the package knows those above it (docs/architecture.md)."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import polarmap

PACKAGE = Path(polarmap.__file__).parent
FLOORS = (
    *("errors", "jit", "options", "timing", "niceness", "interrupts", "version", "geometry", "data", "io", "sensing"),
    *("polarization", "materials", "stereo", "prior", "densify", "odometry", "fusion", "pipeline", "synth"),
    *("evaluation", "report", "export", "viewer", "run", "warm_up", "benchmark", "cli"),
)
"""From the bottom to the top; each may import those before it and itself."""


def rooms_imported(path: Path) -> set[str]:
    """The rooms that a module names, in functions and under TYPE_CHECKING too; the package's own front door is none."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    names = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    names += [
        f"polarmap.{a.name}" for n in nodes if isinstance(n, ast.ImportFrom) and n.module == "polarmap" for a in n.names
    ]
    names += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return {name.split(".")[1] for name in names if name.startswith("polarmap.")}


@pytest.mark.parametrize("floor", FLOORS)
def test_imports_run_downward(floor):
    paths = sorted((PACKAGE / floor).rglob("*.py")) or [PACKAGE / f"{floor}.py"]
    allowed = set(FLOORS[: FLOORS.index(floor) + 1])
    upward = {str(path.relative_to(PACKAGE)): rooms_imported(path) - allowed for path in paths}
    assert not {path: rooms for path, rooms in upward.items() if rooms}


def test_every_room_has_a_floor():
    found = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert found - {"__init__", "__main__"} == set(FLOORS)


def test_imports_are_seen_wherever_they_stand(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(
        "from polarmap import cli\nif TYPE_CHECKING:\n    from polarmap.run import x\n"
        "def f():\n    import polarmap.io.files\n"
    )
    assert rooms_imported(path) == {"cli", "run", "io"}
