"""The rules that keep the tree readable: who imports whom, how long a file is, what a file is called."""

import ast
import sys
from graphlib import TopologicalSorter
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


def module(path):
    """The dotted name of a file of the package."""
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


def read_with(body, known):
    """Modules of the package that are imported as soon as a file is; not what only types or calls need."""
    for node in body:
        if isinstance(node, ast.If | ast.Try | ast.With | ast.ClassDef) and "TYPE_CHECKING" not in ast.unparse(node):
            yield from read_with(node.body, known)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in known else node.module for name in names)


def test_no_files_import_each_other_in_a_circle():
    """Sorting raises for a circle, and names it."""
    known = {module(path): path for path in SOURCES}
    graph = {name: {*read_with(ast.parse(path.read_text()).body, known)} - {name} for name, path in known.items()}
    assert sum(map(len, graph.values())) > 500
    order = [*TopologicalSorter(graph).static_order()]
    assert (
        order.index("moveset.errors")
        < order.index("moveset.motion.clip")
        < order.index("moveset.pipelines.text_to_motion")
    )


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


def test_tests_that_share_run_together(request):
    """pytest 9.2 hides the groups from pytest-xdist 3.8, silently: what a file's tests share was then made twice."""
    if not getattr(request.config.option, "loadgroup", False):
        pytest.skip("tests are not grouped here")
    assert "@" in request.node.nodeid
