"""The rules that keep the tree readable: who imports whom, how long a file is, what a file is called."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "moveset"
SOURCES = sorted(PACKAGE.rglob("*.py"))
EVERYTHING = [*SOURCES, *sorted((ROOT / "tests").rglob("*.py")), *sorted((ROOT / "benchmarks").glob("*.py"))]
MAX_LINES = 400


def imports(path):
    """Top-level names of the modules that a file imports anywhere, ``moveset.x`` for its own packages."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module]
        else:
            continue
        for name in names:
            parts = name.split(".")
            yield ".".join(parts[:2]) if parts[0] == "moveset" else parts[0]


@pytest.mark.parametrize("path", sorted((PACKAGE / "motion").glob("*.py")), ids=lambda p: p.name)
def test_the_core_knows_numpy_torch_and_roma_only(path):
    allowed = {*sys.stdlib_module_names, "numpy", "torch", "roma", "moveset.motion", "moveset.errors"}
    if path.name == "clip.py":
        allowed.add("moveset.io")  # Motion.save hands over
    assert set(imports(path)) <= allowed


def test_nobody_imports_the_command_line():
    users = {path for path in SOURCES if "moveset.cli" in imports(path) and path.parent.name != "cli"}
    assert users == set()


def unsafe(path):
    """Calls that could run what a file says: eval, pickle, yaml.load, allow_pickle=True, weights_only=False."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            given = {word.arg: getattr(word.value, "value", None) for word in node.keywords}
            if (
                name in ("eval", "exec", "yaml.load")
                or name.startswith("pickle.")
                or given.get("allow_pickle") is True
                or given.get("weights_only") is False
            ):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {name}"


def test_nothing_unpickles_or_evaluates():
    assert [call for path in SOURCES for call in unsafe(path)] == []


def test_files_are_short():
    long = {str(p.relative_to(ROOT)): n for p in EVERYTHING if (n := p.read_text().count("\n")) > MAX_LINES}
    assert long == {}


def test_files_are_called_by_what_they_hold():
    vague = {"utils", "util", "misc", "helpers", "helper", "common"}
    assert [p for p in EVERYTHING if p.stem in vague] == []


def test_public_names_can_be_imported():
    import moveset

    assert all(getattr(moveset, name).__doc__ for name in moveset.__all__)
    assert set(moveset.__all__) <= set(dir(moveset))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        moveset.nothing  # noqa: B018


def test_the_package_ships_its_weights_and_types():
    import tomllib

    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["moveset"]
    assert {"weights/**/*", "py.typed"} <= set(data)
