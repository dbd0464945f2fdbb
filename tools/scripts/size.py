"""Print how large the project is: `make size`.

A line of code is neither blank, nor a comment, nor a part of a docstring.
"""

import ast
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PROJECT = Path(__file__).parents[2]
PACKAGES = ("oracle_pipeline", "assets", "sim", "resources")
BESIDE = ("tools", "tests")

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Module:
    """A Python file: its lines of code, and those of each function's body."""

    lines: int
    bodies: list[int]
    public: int
    documented: int


@cache  # of a package, of all four
def measured(file: Path) -> Module:
    """Count the code of a file."""
    source = file.read_text("utf-8")
    tree = ast.parse(source)
    code = code_lines(source, tree)
    functions = [node for node in ast.walk(tree) if isinstance(node, Function)]
    public = list(public_functions(tree.body))
    return Module(
        lines=len(code),
        bodies=[len(code.intersection(lines_of(function.body))) for function in functions],
        public=len(public),
        documented=sum(ast.get_docstring(function) is not None for function in public),
    )


def code_lines(source: str, tree: ast.Module) -> set[int]:
    """Return the numbers of the lines of code."""
    text = {
        number
        for number, line in enumerate(source.splitlines(), 1)
        if line.strip() and not line.strip().startswith("#")
    }
    return text.difference(*(docstring_of(node) for node in ast.walk(tree)))


def docstring_of(node: ast.AST) -> range:
    """Return the lines of a node's docstring; none if it has none."""
    if not isinstance(node, ast.Module | ast.ClassDef | Function):
        return range(0)
    if ast.get_docstring(node, clean=False) is None:
        return range(0)
    return lines_of(node.body[:1])


def lines_of(body: list[ast.stmt]) -> range:
    """Return the lines of statements that follow each other."""
    return range(body[0].lineno, (body[-1].end_lineno or body[-1].lineno) + 1)


def public_functions(body: Iterable[ast.stmt]) -> Iterator[Function]:
    """Yield the functions and methods that others may call."""
    for node in body:
        if isinstance(node, ast.ClassDef | Function) and node.name.startswith("_"):
            continue
        if isinstance(node, ast.ClassDef):
            yield from public_functions(node.body)
        elif isinstance(node, Function):
            yield node


def folders() -> Iterator[tuple[str, list[Path]]]:
    """Yield each package after its folders, all four, and what stands beside them."""
    for package in PACKAGES:
        for folder in sorted((PROJECT / package).iterdir()):
            if files := sorted(folder.rglob("*.py")):
                yield f"{package}/{folder.name}", files
        yield package, files_of(package)
    yield "all four packages", [file for package in PACKAGES for file in files_of(package)]
    for folder_beside in BESIDE:
        yield folder_beside, files_of(folder_beside)


def files_of(folder: str) -> list[Path]:
    """Return the Python files below a folder of the project."""
    return sorted((PROJECT / folder).rglob("*.py"))


def row(name: str, files: list[Path]) -> str:
    """Return the printed row of a folder."""
    modules = [measured(file) for file in files]
    bodies = [lines for module in modules for lines in module.bodies]
    public = sum(module.public for module in modules)
    documented = sum(module.documented for module in modules)
    return (
        f"{name:33}{sum(module.lines for module in modules):11,}{len(modules):9,}"
        f"{statistics.median(bodies):13g}{documented / public:16.1%}"
    )


def words_of_docs() -> int:
    """Count the words of all pages of the docs."""
    return sum(len(page.read_text("utf-8").split()) for page in (PROJECT / "docs").rglob("*.md"))


def main() -> None:
    """Print a row for each folder, and the words of the docs."""
    print(f"{'':33}{'code lines':>11}{'modules':>9}{'median body':>13}{'with docstring':>16}")
    for name, files in folders():
        print(row(name, files))
    print(f"{'words of docs':33}{words_of_docs():11,}")


if __name__ == "__main__":
    main()
