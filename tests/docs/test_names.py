"""Pages and code name only files, modules and pages that exist."""

import re

from tests.docs.pages import DOCS, PAGES, REPOSITORY, blocks

GENERATED = {"deploy/requirements.txt"}  # by make, and not committed
FOLDERS = ("assets", "deploy", "examples", "oracle_pipeline", "resources", "sim", "tools")
GLOSSARY = DOCS / "reference" / "glossary.md"


def is_module(dotted: str) -> bool:
    """Return whether this is the name of a module, or of an object in one."""
    path = REPOSITORY.joinpath(*dotted.split("."))
    return any(
        place.is_dir() or place.with_suffix(".py").is_file() for place in (path, path.parent)
    )


def test_code_names_pages_that_exist():
    sources = [
        file
        for folder in (*FOLDERS, "tests")
        for ending in ("py", "yaml")
        for file in (REPOSITORY / folder).rglob(f"*.{ending}")
    ]
    named = {
        (path, file.name)
        for file in sources
        for path in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text("utf-8"))
    }
    assert {each for each in named if not (REPOSITORY / each[0]).is_file()} == set()


def test_pages_name_files_and_modules_that_exist():
    for page in PAGES:
        text = page.read_text("utf-8")
        files = re.findall(rf"`((?:docs|tests|{'|'.join(FOLDERS)})/[^`*< ]+)[` ]", text)
        modules = re.findall(rf"`((?:{'|'.join(FOLDERS)})(?:\.\w+)+)`", text)
        assert {file for file in files if not (REPOSITORY / file).exists()} <= GENERATED, page
        assert [module for module in modules if not is_module(module)] == [], page


def test_terms_of_the_glossary_are_defined_once():
    terms = re.findall(r"^\| ([^|]+?) \|", GLOSSARY.read_text("utf-8"), re.M)
    terms = [term for term in terms if term not in ("term", "---")]
    assert len(terms) == len(set(terms)) > 20
    assert not blocks(GLOSSARY)
