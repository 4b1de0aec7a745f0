"""Prose uses the terms of the field (docs/glossary.md): words with a meaning of our own may not come back.

`language.tsv` lists them as regular expressions, how often each may occur at most, and what to write instead. A limit
may only fall. Identifiers do not count: text in backticks, names of parameters in docstrings, strings without a blank.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from support.house import PACKAGE, ROOT

LIST = Path(__file__).with_name("language.tsv")
PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "exercises" / "README.md",
]
EXERCISES = sorted((ROOT / "exercises").rglob("*.py"))
SOURCES = sorted(path for kind in ("py", "cpp", "hpp", "js") for path in PACKAGE.rglob(f"*.{kind}"))


class Word(NamedTuple):
    pattern: str
    most: int
    instead: str


WORDS = [
    Word(pattern, int(most), instead)
    for pattern, most, instead in (
        line.split("\t") for line in LIST.read_text(encoding="utf-8").splitlines() if not line.startswith("#")
    )
]


def of_page(text: str) -> Iterator[str]:
    """Lines of a page without blocks of code, comments, code in backticks and targets of links."""
    text = re.sub(r"^```.*?^```$|<!--.*?-->|^ {4}.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    for line in text.split("\n"):
        yield re.sub(r"`[^`]*`|\]\([^)]*\)", "", line)


@cache
def tokens_of(text: str) -> list[tokenize.TokenInfo]:
    return list(tokenize.generate_tokens(io.StringIO(text).readline))


def of_source(text: str, suffix: str) -> Iterator[str]:
    """Lines of docstrings, comments and messages without the identifiers in them."""
    if suffix != ".py":
        yield from re.findall(r"//(.*)", text)
        return
    for token in tokens_of(text):
        if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and re.search(r"\s", token.string)):
            for line in token.string.split("\n"):
                without = re.sub(r"`[^`]*`|\{[^{}]*\}|^\s*[\w, .]+ : .*", "", line)
                yield re.sub(r"^f?\"[\w.]+\"$", "", without)


def prose() -> dict[str, list[str]]:
    pages = {path.relative_to(ROOT).as_posix(): list(of_page(path.read_text(encoding="utf-8"))) for path in PAGES}
    sources = {
        path.relative_to(PACKAGE).as_posix(): list(of_source(path.read_text(encoding="utf-8"), path.suffix))
        for path in SOURCES
    }
    exercises = {path.name: list(of_source(path.read_text(encoding="utf-8"), ".py")) for path in EXERCISES}
    return pages | sources | exercises


def found(pattern: str, texts: dict[str, list[str]]) -> list[str]:
    """Where a pattern occurs, once for each occurrence."""
    word = re.compile(pattern)
    return [f"{name}: {line.strip()}" for name, lines in texts.items() for line in lines for _ in word.finditer(line)]


@pytest.fixture(scope="module")
def texts():
    return prose()


@pytest.mark.parametrize("word", WORDS, ids=lambda word: word.pattern)
def test_words_of_our_own_do_not_come_back(texts, word):
    places = found(word.pattern, texts)
    assert len(places) <= word.most, f"write {word.instead} (see docs/glossary.md):\n" + "\n".join(places)


@pytest.mark.parametrize(
    ("source", "suffix", "count"),
    [
        ('"""The scan tells where the robot is."""\n', ".py", 1),
        ("x = 1  # what the log tells\n", ".py", 1),
        ('raise ValueError(f"{path}: the log tells {nothing}")\n', ".py", 1),
        ("// what a beam tells\n", ".cpp", 1),
        ('tells = state["tells"]\n', ".py", 0),
        ('def f(tells):\n    """Return `tells`.\n\n    tells : int\n    """\n', ".py", 0),
    ],
)
def test_a_planted_word_is_found_and_an_identifier_is_not(source, suffix, count):
    assert len(found(r"\btells?\b", {"planted": list(of_source(source, suffix))})) == count


def test_a_planted_word_is_found_on_a_page():
    page = "A scan tells it.\n\n```python\ntells = 1\n```\n\nSee `tells` and [this](tells.md).\n"
    assert found(r"\btells?\b", {"planted": list(of_page(page))}) == ["planted: A scan tells it."]


CLAUSE = re.compile(r"\b[Ww]hat(ever)?\b|\b[Ww]hoever\b|\b[Gg]o(es|ing|ne)? on\b|\b[Nn]ow and then\b")
CLAUSES_LEFT = {"ros": 60, "slam": 12, "tracking": 4}
"""First lines of docstrings that are still to be rewritten, by folder; none elsewhere. A limit may only fall."""


def first_lines(text: str) -> Iterator[str]:
    """Yield the first line of each docstring, those of attributes included."""
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", [])
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            for statement in body if not isinstance(node, ast.FunctionDef) else body[:1]:
                match statement:
                    case ast.Expr(ast.Constant(str(value))):
                        yield value.strip().partition("\n")[0]


def test_first_lines_of_docstrings_are_plain():
    found: dict[str, list[str]] = {}
    for path in SOURCES:
        if path.suffix == ".py":
            folder = path.relative_to(PACKAGE).parts[0]
            lines = first_lines(path.read_text(encoding="utf-8"))
            found.setdefault(folder, []).extend(f"{path.name}: {line}" for line in lines if CLAUSE.search(line))
    over = {folder: lines for folder, lines in found.items() if len(lines) > CLAUSES_LEFT.get(folder, 0)}
    assert over == {}, "begin with a verb or a noun, without a clause: see language.tsv"


def test_a_planted_clause_in_a_first_line_is_seen():
    text = '"""What a run left."""\nX = 1\n"""Length, m."""\ndef f():\n    """Refuse what is no seed."""\n'
    assert [bool(CLAUSE.search(line)) for line in first_lines(text)] == [True, False, True]
    assert [bool(CLAUSE.search(line)) for line in ("It goes on.", "Return the result.")] == [True, False]


IDENTIFIERS = {
    "aboard",
    "adrift",
    "raft",
    "said",
    "says",
    "sighting",
    "sightings",
    "strange",
    "surveyed",
    "tell",
    "tells",
    "tick",
    "tie",
    "tied",
    "ties",
    "told",
    "whereabouts",
}
"""Words that no name of the package has as a part; a file's own method `tell` is another's name."""


def words_of_names(text: str) -> set[str]:
    """Parts of all names in a text of Python, in lower case, without those of others' methods."""
    tokens = tokens_of(text)
    names = [
        token.string
        for before, token in zip([None, *tokens], tokens, strict=False)
        if token.type == tokenize.NAME and not (token.string == "tell" and before is not None and before.string == ".")
    ]
    return {part.lower() for name in names for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)}


def test_words_of_our_own_are_in_no_name():
    texts = {path: path.read_text(encoding="utf-8") for path in SOURCES if path.suffix == ".py"}
    found = {f"{path.name}: {word}" for path, text in texts.items() for word in words_of_names(text) & IDENTIFIERS}
    assert found == set()


def test_a_word_in_a_name_is_seen():
    assert words_of_names("told_poses = f.tell(LastTie)") & IDENTIFIERS == {"told", "tie"}
