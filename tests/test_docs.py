"""What the documents name is there: files, headings, verbs with their options, extras, make's targets, Python names."""

import ast
import importlib
import re
import shlex
import tomllib
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

from moveset.cli.__main__ import VERBS, _parse
from moveset.errors import InputError
from moveset.pipelines.generator import Sampler
from moveset.training.engine import EngineConfig
from moveset.training.tasks import load_exports, load_recipes

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "integrations").glob("*.md")])
PACKAGE = ROOT / "src" / "moveset"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
LINK = re.compile(r"\]\(([^)\s]+)\)")
# Paths of the repository wherever they stand, in commands too; what is made by running something is not among them.
PATH = re.compile(r"(?<![\w./-])((?:src/moveset|tests|benchmarks|examples|integrations|viewer|docs|\.ci)/[\w./-]*\w/?)")
# Between backquotes also paths inside the package (`io/html.py`), and files whose folder is clear (`items.py`).
SOURCE = re.compile(r"[\w./-]+\.(?:py|ts|mjs|toml)$")
SOURCES = ("src", "tests", "benchmarks", "examples", "integrations", "viewer/src", "viewer/tests", ".ci")


def text(document):
    return document.read_text(encoding="utf-8")


def ids(paths):
    return [str(path.relative_to(ROOT)) for path in paths]


every_document = pytest.mark.parametrize("document", DOCUMENTS, ids=ids(DOCUMENTS))


def slugs(document):
    """The anchors of a document's headings, as renderers make them."""
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", text(document)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@cache
def source_names():
    """Names of all source files of the repository."""
    found = {path.name for folder in SOURCES for path in (ROOT / folder).rglob("*")}
    return found | {path.name for folder in (ROOT, ROOT / "viewer") for path in folder.iterdir()}


def missing_links(document):
    for link in LINK.findall(FENCE.sub("", text(document))):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        if not target.exists() or (anchor and anchor not in slugs(target)):
            yield link


def missing_paths(document):
    said = text(document)
    # A name in capitals, a brace or a star stands for many files.
    whole = [path for path in PATH.findall(said) if not re.search(r"[A-Z]{3,}(?!\.md)|\*", path)]
    yield from (path for path in whole if not (ROOT / path).exists())
    for quoted in QUOTED.findall(FENCE.sub("", said)):
        if not SOURCE.match(quoted) or quoted in whole:
            continue
        places = [base / quoted for base in (ROOT, ROOT / "src", PACKAGE, document.parent)]
        if not any(place.exists() for place in places) and ("/" in quoted or quoted not in source_names()):
            yield quoted


def commands(document):
    """Command lines of ``moveset`` in a document's blocks, as lists of arguments."""
    for language, block in FENCE.findall(text(document)):
        if language not in ("", "bash", "sh", "console"):
            continue
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True) if re.match(r"(\.venv/bin/)?moveset ", line) else []
            if words and "…" not in words:
                yield words[1:]


@every_document
def test_links_lead_somewhere(document):
    assert list(missing_links(document)) == []


@every_document
def test_named_files_exist(document):
    assert list(missing_paths(document)) == []


def test_a_missing_file_and_heading_are_noticed(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# One, two\n[a](#one-two) [b](#three) [c](none.md) [d](https://example.org/x)\n"
        "`io/html.py` `html.py` `io/none.py` `none.py` `walk.bvh`\n```\npython benchmarks/none.py docs/NAME.json\n```\n"
    )
    assert list(missing_links(page)) == ["#three", "none.md"]
    assert list(missing_paths(page)) == ["benchmarks/none.py", "io/none.py", "none.py"]


COMMANDS = [(path.name, words) for path in DOCUMENTS for words in commands(path)]


def parse(words):
    """Parse a command line without doing what it says."""
    if words in (["--version"], ["--help"]):
        return
    _parse(*words)


@pytest.mark.parametrize("words", [words for _, words in COMMANDS], ids=[f"{n}-{' '.join(w)}" for n, w in COMMANDS])
def test_commands_can_be_given(words):
    parse(words)


def test_the_front_page_shows_every_verb():
    shown = {words[0] for name, words in COMMANDS if name == "README.md"}
    shown |= set(re.findall(r"`moveset (\w+)", text(ROOT / "README.md")))
    assert set(VERBS) <= shown


@every_document
def test_verbs_in_sentences_exist(document):
    said = [quoted.split()[1:] for quoted in QUOTED.findall(FENCE.sub("", text(document)))]
    heads = [quoted.split()[0] for quoted in QUOTED.findall(FENCE.sub("", text(document))) if quoted.strip()]
    named = {words[0] for head, words in zip(heads, said, strict=True) if head == "moveset" and words}
    assert {name for name in named if re.fullmatch(r"[a-z]+", name)} <= set(VERBS)


def test_a_wrong_option_is_noticed():
    with pytest.raises(InputError, match="--stepz"):
        parse(["generate", "a person walks", "--stepz", "2", "-o", "walk.bvh"])
    with pytest.raises(InputError, match="did you mean 'generate'"):
        parse(["generat", "a person walks"])


def test_every_picture_is_shown_somewhere():
    said = "".join(text(document) for document in DOCUMENTS)
    assert [path.name for path in (ROOT / "docs" / "images").iterdir() if f"images/{path.name}" not in said] == []


@every_document
def test_no_path_of_anybodys_machine(document):
    assert re.findall(r"(?<![\w.])/(?:work|home|root|tmp|Users|mnt)/\S*", text(document)) == []


@every_document
def test_extras_and_targets_exist(document):
    extras = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]["optional-dependencies"]
    said = {name for group in re.findall(r"(?:moveset|'\.)\[([\w,]+)\]", text(document)) for name in group.split(",")}
    assert said <= set(extras)
    rules = set(re.findall(r"^(\w+):", text(ROOT / "Makefile"), re.MULTILINE))
    blocks = re.findall(r"^make (\w+)", "\n".join(block for _, block in FENCE.findall(text(document))), re.MULTILINE)
    assert {*blocks, *re.findall(r"`make (\w+)`", text(document))} <= rules


@every_document
def test_python_is_python(document):
    for language, block in FENCE.findall(text(document)):
        if language != "python":
            continue
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("moveset"):
                module = importlib.import_module(node.module)
                assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


def test_sections_of_the_front_page_are_in_order():
    """One heading of the first level, none skipped: what a table of contents is made of."""
    levels = [len(marks) for marks in re.findall(r"^(#+) ", FENCE.sub("", text(ROOT / "README.md")), re.MULTILINE)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_the_fidelity_tables_name_what_is_there_and_why_what_is_not():
    lines = re.findall(r"^\| (?!\*\*)(.+) \|$", text(ROOT / "docs" / "fidelity.md"), re.MULTILINE)
    rows = [re.split(r"(?<!\\) \| ", line) for line in lines]
    assert len(rows) > 100
    for what, where, state in (row for row in rows if row[-1] != "state"):
        assert re.match(r"faithful(: .+)?$|(option|deviation|missing): .+", state), what
        for path, names in re.findall(r"`([\w/]+\.py)`((?:,? `[A-Za-z_.]+`)*)", where):
            place = next(base / path for base in (PACKAGE, ROOT) if (base / path).exists())
            for name in re.findall(r"`([\w.]+)`", names):
                assert name.endswith(".py") or re.search(rf"\b{name.split('.')[-1]}\b", text(place)), (what, name)


def test_settings_in_the_fidelity_tables_exist():
    recipes = load_recipes("paper")
    known = {Sampler, EngineConfig, *map(type, load_exports("paper")), *(type(one.task) for one in recipes.values())}
    nested = (value for one in recipes.values() for value in vars(one.task).values())
    names = {f.name for kind in (*known, *map(type, nested)) if is_dataclass(kind) for f in fields(kind)}
    quoted = " ".join(QUOTED.findall(text(ROOT / "docs" / "fidelity.md")))
    said = set(re.findall(r"(?<![\w-])([a-z_.0-9]+)=", quoted))
    assert len(said) > 20
    assert {name for name in said if name.split(".")[-1] not in names} == set()
