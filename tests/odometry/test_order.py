"""No module of odometry knows those above it, and its three folders do not know each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from polarmap import odometry

FOLDER = Path(odometry.__file__).parent
BOTTOM = ("options", "pattern", "projection", "pyramid", "points", "selection", "keyframe_rule", "records")
FOLDERS = ("start", "track", "window")
TOP = ("keyframing", "back_end", "local_map", "between", "work", "frame_queue", "odometry", "side_by_side")


def imported(name: str) -> set[str]:
    """The modules and folders of odometry that one of them names."""
    paths = sorted((FOLDER / name).rglob("*.py")) or [FOLDER / f"{name}.py"]
    nodes = [node for path in paths for node in ast.walk(ast.parse(path.read_text()))]
    modules = [node.module.split(".") for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    return {module[2] for module in modules if module[:2] == ["polarmap", "odometry"]} - {name}


@pytest.mark.parametrize("name", [*BOTTOM, *FOLDERS, *TOP])
def test_imports_run_downward(name):
    order = [*BOTTOM, *FOLDERS, *TOP]
    below = set(BOTTOM) if name in FOLDERS else set(order[: order.index(name)])
    assert imported(name) <= below


def test_every_module_has_its_place():
    found = {path.stem for path in FOLDER.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert found - {"__init__"} == {*BOTTOM, *FOLDERS, *TOP}
