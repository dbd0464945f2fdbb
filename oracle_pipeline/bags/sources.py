"""Hashes of source code: what our own modules mean that a result depends on, by their imports.

A module counts by its syntax tree, without comments, docstrings and layout. The imports, those
inside functions too, are followed through the four packages of the distribution, and through that
of a plug-in; nothing is imported for it. Trees are not read again while a file stays the same: its
findings are kept in the user's cache folder.
"""

import ast
import contextlib
import functools
import hashlib
import json
import sys
from collections.abc import Collection, Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import platformdirs

from oracle_pipeline.bags.scratch import scratch_beside

PACKAGES = ("assets", "oracle_pipeline", "resources", "sim")
ROOT = Path(__file__).parents[2]  # of the packages

_PACKAGE = "__init__.py"
# Fields of a syntax tree that follow from the rest, or mean nothing.
_REDUNDANT = frozenset({"ctx", "kind", "type_comment", "type_ignores"})

_Identity: TypeAlias = list[int]  # of an unchanged file: times, size and inode


class _Module(NamedTuple):
    """What a module means and needs."""

    digest: str  # of its syntax tree
    imports: list[str]  # absolute names


def code_hash(
    modules: Iterable[str],
    *others: str,
    folders: Iterable[Path] = (),
    within: Collection[str] = PACKAGES,
    root: Path = ROOT,
) -> str:
    """Return a hash over the modules that modules depend on, and over additional content.

    Parameters
    ----------
    modules
        Dotted names of our modules, or of those of a plug-in.
    others
        Additional texts.
    folders
        Additional folders, with all their files.
    within
        Packages whose imports are followed; all others are ignored.
    root
        The folder of the packages.

    Returns
    -------
    str
        16 hexadecimal digits: of the names of the files, not of their place, of the meaning of
        modules and of the bytes of data.
    """
    digest = hashlib.sha256()
    named = _dependencies(modules, within, root)
    named += [(folder, file) for folder in folders for file in sorted(_files(folder))]
    for base, file in named:
        name = file.relative_to(base).as_posix()
        digest.update(f"{name}\0{_content_hash(file)}\0".encode())
    for text in others:
        digest.update(text.encode() + b"\0")
    _modules.keep()
    return digest.hexdigest()[:16]


def dependencies(modules: Iterable[str], *, root: Path = ROOT) -> list[Path]:
    """Return the files that modules depend on, in order: modules, and the data of their packages.

    Importing a module runs the ``__init__`` of each package above it, so these count as well. Data
    are all other files in a package's folder and in those of its folders that are no packages.

    Raises
    ------
    LookupError
        If there is no such module.
    """
    return [file for _, file in _dependencies(modules, PACKAGES, root)]


def _dependencies(
    modules: Iterable[str], within: Collection[str], root: Path
) -> list[tuple[Path, Path]]:
    """Return what ``dependencies`` does, with the folder of the package that each file is in."""
    waiting, files = list(modules), dict[str, tuple[Path, Path]]()
    tops = {name.partition(".")[0] for name in waiting}
    roots = {top: _place(top) for top in tops.difference(PACKAGES)}  # of plug-ins
    inside = tuple(f"{package}." for package in {*within, *roots})
    for name in waiting:
        place = roots.get(name.partition(".")[0], root)
        if _file(name, place) is None:
            raise LookupError(f"There is no module {name} in {place}.")
    while waiting:
        name = waiting.pop()
        place = roots.get(name.partition(".")[0], root)
        if name in files or (file := _file(name, place)) is None:
            continue
        files[name] = place, file
        package = name if file.name == _PACKAGE else name.rpartition(".")[0]
        imported = (_absolute(each, package) for each in _modules[file].imports)
        waiting += [each for each in imported if f"{each}.".startswith(inside)]
        waiting += _above(name)
    packages = [(place, file.parent) for place, file in files.values() if file.name == _PACKAGE]
    data = ((place, file) for place, at in packages for file in _files(at, is_package=True))
    return sorted({*files.values(), *data})


def _place(package: str) -> Path:
    """Return the folder that holds a package or module of a plug-in."""
    spec = find_spec(package)
    where = [] if spec is None else [*(spec.submodule_search_locations or [spec.origin or ""])]
    if not where:
        raise LookupError(f"There is no module {package}.")
    return Path(where[0]).parent


def imports(tree: ast.AST) -> set[str]:
    """Return the dotted names that a module may import, but for type checking only.

    Of ``from a import b`` both ``a`` and ``a.b`` are returned, as ``b`` may be a module. Relative
    names begin with their dots.
    """
    names: set[str] = set()
    for node in _executed(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            stem = base if base.endswith(".") else f"{base}."
            names.update([base, *(f"{stem}{alias.name}" for alias in node.names)])
    return names


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what is in a syntax tree, but for ``if TYPE_CHECKING`` and expressions."""
    for child in ast.iter_child_nodes(node):
        is_types_only = (
            isinstance(child, ast.If)
            and isinstance(child.test, ast.Name)
            and child.test.id == "TYPE_CHECKING"
        )
        if not (is_types_only or isinstance(child, ast.expr)):
            yield child
            yield from _executed(child)


def _content_hash(file: Path) -> str:
    """Return a hash of what a module means, or of the bytes of another file."""
    if file.suffix == ".py":
        with contextlib.suppress(SyntaxError, ValueError):
            return _modules[file].digest
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _outline(part: Any, into: list[str]) -> None:
    """Write down a syntax tree, alike in all releases of Python that have it.

    Empty fields are left out, since newer releases add some. Text as a statement, such as a
    docstring, does nothing.
    """
    if isinstance(part, ast.AST):
        into.append(f"{type(part).__name__}(")
        for name in part._fields:
            value = getattr(part, name, None)
            if value is not None and value != [] and name not in _REDUNDANT:
                into.append(f"{name}=")
                _outline(value, into)
        into.append(")")
    elif isinstance(part, list):
        into.append("[")
        for each in part:
            if not _is_text(each):
                _outline(each, into)
        into.append("]")
    else:
        into.append(f"{part!a},")


def _is_text(part: Any) -> bool:
    return (
        isinstance(part, ast.Expr)
        and isinstance(part.value, ast.Constant)
        and isinstance(part.value.value, str)
    )


class _Modules:
    """What is in modules, by their files; of the modules below `ROOT` it is kept in a file."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[_Identity, str, list[str]]] = {}
        self._is_new = False

    def __getitem__(self, file: Path) -> _Module:
        kept, name, identity = self._kept(), str(file), _identity(file)
        if name not in kept or kept[name][0] != identity:
            tree, outline = ast.parse(file.read_bytes()), list[str]()
            _outline(tree, outline)
            digest = hashlib.sha256("".join(outline).encode()).hexdigest()
            kept[name] = (identity, digest, sorted(imports(tree)))
            self._is_new = True
        return _Module(*kept[name][1:])

    def _kept(self) -> dict[str, tuple[_Identity, str, list[str]]]:
        """Return the findings in modules, before the first use that of former processes."""
        if not self._found:
            with contextlib.suppress(OSError, ValueError):  # none yet, or damaged
                self._found = json.loads(_kept_at().read_bytes())
        return self._found

    def keep(self) -> None:
        """Keep what is new; a cache that cannot be written is no loss but of time."""
        if not self._is_new:
            return
        self._is_new = False
        ours = {name: each for name, each in self._found.items() if Path(name).is_relative_to(ROOT)}
        with contextlib.suppress(OSError), scratch_beside(_kept_at(), Path.touch) as scratch:
            scratch.write_text(json.dumps(ours))
            scratch.replace(_kept_at())


_modules = _Modules()


@functools.cache
def _kept_at() -> Path:
    """Return the place of the cache, another for each checkout, Python and form of the cache."""
    key = f"{ROOT} {sys.version_info[:2]} {_identity(Path(__file__))}"
    name = f"modules-{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
    return platformdirs.user_cache_path("ros2-behaviour-oracle") / name


def _identity(file: Path) -> _Identity:
    about = file.stat()
    return [about.st_mtime_ns, about.st_ctime_ns, about.st_size, about.st_ino]


def _absolute(name: str, package: str) -> str:
    levels = len(name) - len(name.lstrip("."))
    if not levels:
        return name
    parts = package.split(".")
    return ".".join([*parts[: len(parts) - levels + 1], *filter(None, [name[levels:]])])


def _above(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:n]) for n in range(1, len(parts))]


@functools.cache
def _file(name: str, root: Path) -> Path | None:
    """Return the file of a module, if it is one of ours."""
    place = root.joinpath(*name.split("."))
    candidates = (place / _PACKAGE, place.with_name(f"{place.name}.py"))
    return next((file for file in candidates if file.is_file()), None)


def _files(folder: Path, *, is_package: bool = False) -> Iterator[Path]:
    """Yield the files in and below a folder; of a package, those that are no modules."""
    for entry in folder.iterdir() if folder.is_dir() else ():
        if entry.is_dir():
            if entry.name != "__pycache__" and not (is_package and (entry / _PACKAGE).exists()):
                yield from _files(entry, is_package=is_package)
        elif not (is_package and entry.suffix == ".py"):
            yield entry
