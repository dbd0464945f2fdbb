"""Pages use today's terms, keep their lines short, and name only files that exist."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator

import click
import pytest

from assets.oracle_sim import main as oracle_sim
from assets.webserver.server import main as oracle_ui
from oracle_pipeline.cli import main as oracle
from oracle_pipeline.definitions import defs
from tests.docs.pages import DOCS, PAGES, REPOSITORY, blocks, name, prose

LONGEST = 100
PROGRAMS = {"oracle": oracle, "oracle-sim": oracle_sim, "oracle-ui": oracle_ui}
GENERATED = {"deploy/requirements.txt"}  # by make, and not committed
GLOSSARY = DOCS / "reference" / "glossary.md"
CHECKED_PACKAGES = (
    "assets", "resources", "sim", "tests", "tools",
    "oracle_pipeline/bags", "oracle_pipeline/clustering", "oracle_pipeline/comparison",
    "oracle_pipeline/detectors", "oracle_pipeline/evaluation", "oracle_pipeline/features",
    "oracle_pipeline/graphs", "oracle_pipeline/live",
    "oracle_pipeline/oracles", "oracle_pipeline/replay", "oracle_pipeline/reporting",
    "oracle_pipeline/robots", "oracle_pipeline/scoring",
)  # fmt: skip
CHECKED_CODE = sorted(
    file
    for pattern in ("oracle_pipeline/*.py", *(f"{name}/**/*.py" for name in CHECKED_PACKAGES))
    for file in REPOSITORY.glob(pattern)
)


def retired(*files: str) -> list[tuple[re.Pattern[str], str]]:
    """Return the retired terms of files in ``docs``, with their replacements."""
    lines = [
        line
        for file in files or ("retired_terms.txt",)
        for line in (DOCS / file).read_text("utf-8").splitlines()
    ]
    pairs = [line.split(" => ") for line in lines if line and not line.startswith("#")]
    return [(re.compile(pattern, re.I), instead) for pattern, instead in pairs]


def prose_of_code(source: str) -> Iterator[tuple[int, str]]:
    """Yield the docstrings and comments of a module with their first lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or ""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def retired_in_code(files: dict[str, str]) -> list[str]:
    """Return the retired terms in docstrings and comments of sources by name."""
    terms = retired("retired_terms.txt", "retired_terms_in_code.txt")
    any_term = re.compile("|".join(pattern.pattern for pattern, _ in terms), re.I)
    return [
        f"{name}:{line}: {match[0]!r}: {instead}"
        for name, source in files.items()
        if any_term.search(" ".join(source.split()))  # parse only candidates, which is slow
        for line, text in prose_of_code(source)
        for pattern, instead in terms
        for match in pattern.finditer(" ".join(text.split()))
    ]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_pages_use_no_retired_term(page):
    found = [
        f"{name(page)}:{number}: {match[0]!r}: {instead}"
        for number, line in prose(page)
        for pattern, instead in retired()
        for match in pattern.finditer(line)
    ]
    assert not found, "\n".join(found)


def test_the_word_list_finds_retired_terms():
    sentence = "Right runs are made again, one a processor, and told apart from the others."
    assert {match[0] for pattern, _ in retired() for match in pattern.finditer(sentence)} == {
        "Right runs", "made again", "one a processor", "told apart"
    }  # fmt: skip


def test_docstrings_and_comments_use_no_retired_term():
    found = retired_in_code({name(file): file.read_text("utf-8") for file in CHECKED_CODE})
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('"""A node that hears a topic."""', ["code:1: 'hears'"]),
        ("x = 1  # for whoever asks", ["code:1: 'whoever'"]),
        ('def f():\n    """Tell\n    what it is."""\n', ["code:1: 'Tell what'"]),
        ('told = "told"  # names and strings are not checked', []),
    ],
)
def test_a_retired_term_is_found_in_docstrings_and_comments_only(source, found):
    assert [line.rpartition(": ")[0] for line in retired_in_code({"code": source})] == found


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_lines_are_at_most_100_characters(page):
    """But rows of tables, and lines that hold one link."""
    long = [
        number
        for number, line in prose(page)
        if len(line) > LONGEST and not line.startswith("|") and not re.fullmatch(r"\S+", line)
    ]
    assert not long, f"{name(page)}, lines {long}"


def test_the_readme_keeps_its_tables_short_too():
    lines = (REPOSITORY / "README.md").read_text("utf-8").splitlines()
    assert [line for line in lines if len(line) > LONGEST] == []
    assert len(lines) <= 120


def is_module(dotted: str) -> bool:
    """Return whether this is the name of a module, or of an object in one."""
    path = REPOSITORY.joinpath(*dotted.split("."))
    return any(
        place.is_dir() or place.with_suffix(".py").is_file() for place in (path, path.parent)
    )


def test_code_names_pages_that_exist():
    sources = [
        file
        for folder in ("assets", "deploy", "oracle_pipeline", "resources", "sim", "tests")
        for ending in ("py", "yaml")
        for file in (REPOSITORY / folder).rglob(f"*.{ending}")
    ]
    named = {
        (path, file.name)
        for file in sources
        for path in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text("utf-8"))
    }
    assert {each for each in named if not (REPOSITORY / each[0]).is_file()} == set()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_pages_name_files_and_modules_that_exist(page):
    text = page.read_text("utf-8")
    files = re.findall(
        r"`((?:assets|deploy|docs|oracle_pipeline|resources|sim|tests)/[^`*<]+)`", text
    )
    modules = re.findall(r"`((?:assets|oracle_pipeline|resources|sim)(?:\.\w+)+)`", text)
    assert {file for file in files if not (REPOSITORY / file).exists()} <= GENERATED
    assert [module for module in modules if not is_module(module)] == []


def test_terms_of_the_glossary_are_defined_once():
    terms = re.findall(r"^\| ([^|]+?) \|", GLOSSARY.read_text("utf-8"), re.M)
    terms = [term for term in terms if term not in ("term", "---")]
    assert len(terms) == len(set(terms)) > 20
    assert not blocks(GLOSSARY)


def helps(command: click.Command, context: click.Context) -> Iterator[tuple[str, str]]:
    yield context.command_path, command.get_help(context)
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            yield from helps(found, click.Context(found, context, each))


@pytest.mark.parametrize(("program", "group"), PROGRAMS.items(), ids=PROGRAMS)
def test_help_uses_no_retired_term(program, group):
    found = [
        f"{path}: {match[0]!r}: {instead}"
        for path, text in helps(group, click.Context(group, info_name=program))
        for pattern, instead in retired()
        for match in pattern.finditer(" ".join(text.split()))
    ]
    assert not found, "\n".join(found)


def test_descriptions_of_assets_and_checks_use_no_retired_term():
    graph = defs.resolve_asset_graph()
    texts = {
        key.to_user_string(): graph.get(key).description or "" for key in graph.get_all_asset_keys()
    }
    texts |= {
        str(key): graph.get_check_spec(key).description or "" for key in graph.asset_check_keys
    }
    found = [
        f"{name}: {match[0]!r}: {instead}"
        for name, text in texts.items()
        for pattern, instead in retired()
        for match in pattern.finditer(text)
    ]
    assert not found, "\n".join(found)
