"""Pages use today's terms, keep their lines short, and name only files that exist."""

import re

import pytest

from tests.docs.pages import DOCS, PAGES, REPOSITORY, blocks, name, prose

LONGEST = 100
GENERATED = {"deploy/requirements.txt"}  # by make, and not committed
GLOSSARY = DOCS / "reference" / "glossary.md"


def retired() -> list[tuple[re.Pattern[str], str]]:
    lines = (DOCS / "retired_terms.txt").read_text("utf-8").splitlines()
    pairs = [line.split(" => ") for line in lines if line and not line.startswith("#")]
    return [(re.compile(pattern, re.I), instead) for pattern, instead in pairs]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_pages_use_no_retired_term(page):
    found = [
        f"{name(page)}:{number}: {match[0]!r}: {instead}"
        for number, line in prose(page)
        for pattern, instead in retired()
        for match in pattern.finditer(line)
    ]
    assert not found, "\n".join(found)


def test_the_word_list_finds_what_it_is_for():
    sentence = "Right runs are made again, one a processor, and told apart from the others."
    assert {match[0] for pattern, _ in retired() for match in pattern.finditer(sentence)} == {
        "Right runs", "made again", "one a processor", "told apart"
    }  # fmt: skip


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
    """Say whether a module, or what a module holds, goes by this name."""
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
