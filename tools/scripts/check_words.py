"""Warn about words that we no longer use, and about lines that are too long: `make lint`.

A warning helps who writes; it fails nothing.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

PROJECT = Path(__file__).parents[2]
PAGES = sorted([*PROJECT.glob("docs/**/*.md"), *PROJECT.glob("*.md")])
PACKAGES = ("assets", "oracle_pipeline", "resources", "sim", "tests", "tools")
LONGEST_LINE = 100
LONGEST_README = 120  # lines

Terms = list[tuple[re.Pattern[str], str]]

_BLOCK = re.compile(r"^ *```.*?^ *```$", re.M | re.S)


def retired(*files: str) -> Terms:
    """Return the retired terms that files list, each with what to write instead."""
    lines = [
        line
        for file in files
        for line in Path(__file__).with_name(file).read_text("utf-8").splitlines()
    ]
    pairs = [line.split(" => ") for line in lines if line and not line.startswith("#")]
    return [(re.compile(pattern, re.I), instead) for pattern, instead in pairs]


def prose_of_page(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a page outside its fenced blocks, with their numbers."""
    blank = _BLOCK.sub(lambda block: "\n" * block[0].count("\n"), text)
    yield from enumerate(blank.splitlines(), 1)


def prose_of_code(source: str) -> Iterator[tuple[int, str]]:
    """Yield the docstrings and comments of a module, with their first lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield getattr(node, "lineno", 1), " ".join((ast.get_docstring(node) or "").split())
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def found_terms(prose: Iterable[tuple[int, str]], terms: Terms) -> Iterator[tuple[int, str]]:
    """Yield where a retired term stands, and what to write instead."""
    for number, text in prose:
        for pattern, instead in terms:
            for found in pattern.finditer(text):
                yield number, f"{found[0]!r}: {instead}"


def long_lines(prose: Iterable[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Yield the lines that are too long, but for rows of tables and lines that hold one link."""
    for number, line in prose:
        if len(line) > LONGEST_LINE and not line.startswith("|") and " " in line.strip():
            yield number, f"{len(line)} characters"


def in_pages() -> Iterator[str]:
    """Yield a warning for each finding in the pages."""
    terms = retired("retired_terms.txt")
    for page in PAGES:
        prose = list(prose_of_page(page.read_text("utf-8")))
        for number, finding in (*long_lines(prose), *found_terms(prose, terms)):
            yield f"{page.relative_to(PROJECT)}:{number}: {finding}"


def in_code() -> Iterator[str]:
    """Yield a warning for each finding in docstrings and comments."""
    terms = retired("retired_terms.txt", "retired_terms_in_code.txt")
    candidate = re.compile("|".join(pattern.pattern for pattern, _ in terms), re.I)
    for file in sorted(file for folder in PACKAGES for file in (PROJECT / folder).rglob("*.py")):
        source = file.read_text("utf-8")
        if candidate.search(" ".join(source.split())):  # to parse all would be slow
            for number, finding in found_terms(prose_of_code(source), terms):
                yield f"{file.relative_to(PROJECT)}:{number}: {finding}"


def in_readme() -> Iterator[str]:
    """Yield a warning if README does not fit on two screens."""
    lines = len((PROJECT / "README.md").read_text("utf-8").splitlines())
    if lines > LONGEST_README:
        yield f"README.md: {lines} lines, more than {LONGEST_README}"


def main() -> None:
    """Print the warnings."""
    for warning in (*in_pages(), *in_code(), *in_readme()):
        print(f"warning: {warning}")


if __name__ == "__main__":
    main()
