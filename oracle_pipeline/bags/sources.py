"""Hashes of source code: the files of our own that a result depends on, by their imports.

The imports are read from the text of the modules, those inside functions too, and followed through
the four packages of the distribution. Nothing is imported and nothing is compiled for it. A process
reads the imports of a module once, since it has many hashes over the same modules.
"""

import functools
import hashlib
import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

PACKAGES = ("assets", "oracle_pipeline", "resources", "sim")
ROOT = Path(__file__).parents[2]  # of the packages

_TYPES_ONLY = re.compile(r"^if TYPE_CHECKING:\n(?:[ \t].*\n|\n)+", re.MULTILINE)
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|.+)|import[ \t]+(.+))$",
    re.MULTILINE,
)
_COMMENT = re.compile(r"#.*")
_PACKAGE = "__init__.py"


def code_hash(
    modules: Iterable[str],
    *others: str,
    folders: Iterable[Path] = (),
    within: Collection[str] = PACKAGES,
    root: Path = ROOT,
) -> str:
    """Return a hash over the files that modules depend on, and over additional content.

    Parameters
    ----------
    modules
        Dotted names of our modules.
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
        16 hexadecimal digits: of the names and contents of the files, not of their place.
    """
    digest = hashlib.sha256()
    named = [(root, file) for file in dependencies(modules, within=within, root=root)]
    named += [(folder, file) for folder in folders for file in sorted(_files(folder))]
    for base, file in named:
        content = file.read_bytes()
        name = file.relative_to(base).as_posix().encode()
        digest.update(b"%s\0%d\0%s" % (name, len(content), content))
    for text in others:
        digest.update(text.encode() + b"\0")
    return digest.hexdigest()[:16]


def dependencies(
    modules: Iterable[str], *, within: Collection[str] = PACKAGES, root: Path = ROOT
) -> list[Path]:
    """Return the files that modules depend on, in order: modules, and the data of their packages.

    Importing a module runs the ``__init__`` of each package above it, so these count as well. Data
    are all other files in a package's folder and in those of its folders that are no packages.

    Raises
    ------
    LookupError
        If there is no such module.
    """
    waiting, files = list(modules), dict[str, Path]()
    for name in waiting:
        if _file(name, root) is None:
            raise LookupError(f"There is no module {name} in {root}.")
    while waiting:
        name = waiting.pop()
        if name in files or (file := _file(name, root)) is None:
            continue
        files[name] = file
        waiting += [name for name in _imports_of(name, file) if _is_within(name, within)]
        waiting += _above(name)
    packages = [file.parent for file in files.values() if file.name == _PACKAGE]
    data = (file for package in packages for file in _files(package, is_package=True))
    return sorted({*files.values(), *data})


@functools.cache
def _imports_of(name: str, file: Path) -> set[str]:
    package = name if file.name == _PACKAGE else name.rpartition(".")[0]
    return imports(file.read_text(encoding="utf-8"), package)


def imports(source: str, package: str) -> set[str]:
    """Return the dotted names that a module may import, but for type checking only.

    Of ``from a import b`` both ``a`` and ``a.b`` are returned, as ``b`` may be a module.

    Parameters
    ----------
    source
        Text of the module.
    package
        The package that it is in, or is.
    """
    names = set()
    for origin, objects, direct in _IMPORT.findall(_TYPES_ONLY.sub("", source)):
        listed = _COMMENT.sub("", direct or objects).strip("() \t\n").split(",")
        bare = [words[0] for item in listed if (words := item.split())]
        if direct:
            names.update(bare)
            continue
        base = _absolute(origin, package)
        names.update([base, *(f"{base}.{name}" for name in bare)])
    return names


def _absolute(name: str, package: str) -> str:
    levels = len(name) - len(name.lstrip("."))
    if not levels:
        return name
    parts = package.split(".")
    return ".".join([*parts[: len(parts) - levels + 1], *filter(None, [name[levels:]])])


def _above(name: str) -> list[str]:
    parts = name.split(".")
    return [".".join(parts[:n]) for n in range(1, len(parts))]


def _is_within(name: str, packages: Collection[str]) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


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
