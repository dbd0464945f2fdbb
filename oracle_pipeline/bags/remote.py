"""Folders below a root in an object store: copied here for reading, and published as a whole.

A root is a folder of this machine (``pathlib.Path``) or of an object store (``upath.UPath``, such
as ``s3://bucket/prefix``). Single files, manifests and tables, are read and written alike in both.
Bags are read and written by libraries that need local files, and an object store cannot rename a
finished folder. This module handles both. For a local root it does nothing.
"""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast


def place_at(text: str) -> Path:
    """Return the absolute path of a folder or file, or a ``UPath``, which acts like one, of a URL.

    Raises
    ------
    ImportError
        The library for this kind of object store is not installed.
    """
    if "://" not in text:
        return Path(text).expanduser().resolve()
    from upath import UPath

    # Other processes write to the store, so listings must not be cached.
    return cast(Path, UPath(text, use_listings_cache=False))


def is_local(place: Path) -> bool:
    """Return whether a place is on this machine, or mounted on it."""
    return isinstance(place, Path)  # a UPath of an object store is none, though it acts like one


@contextlib.contextmanager
def fetched(folder: Path) -> Iterator[Path]:
    """Give a folder or file to read on this machine: itself, or a copy until the block ends."""
    if is_local(folder):
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as scratch:
        store, prefix = _objects_of(folder)
        local = Path(scratch, *prefix.strip("/").split("/"))  # so that messages name the place
        objects = [name for name in store.find(prefix) if ".." not in name.split("/")]
        store.get(objects, [str(local / object_[len(prefix) + 1 :]) for object_ in objects])
        yield local


@contextlib.contextmanager
def published(folder: Path, last: str) -> Iterator[Path]:
    """Give a folder to write on this machine: itself, or one that is put there after the block.

    Parameters
    ----------
    folder
        Where it belongs; the block makes the folder that it is given.
    last
        Name of the file whose presence marks the folder as complete.
    """
    if is_local(folder):
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="oracle-") as scratch:
        local = Path(scratch, folder.name)
        yield local
        publish(local, folder, last)


def publish(local: Path, folder: Path, last: str) -> None:
    """Put a folder of this machine in the place of one in an object store.

    ``last`` is removed first and written last, so that an incomplete folder never looks complete.
    An interrupted copy is repeated by the next one.
    """
    store, prefix = _objects_of(folder)
    (folder / last).unlink(missing_ok=True)
    objects = {
        f"{prefix}/{file.relative_to(local).as_posix()}": str(file)
        for file in sorted(local.rglob("*"))
        if file.is_file()
    }
    whole = f"{prefix}/{last}"
    body = [object_ for object_ in objects if object_ != whole]
    if body:
        store.put([objects[object_] for object_ in body], body)
    if former := [object_ for object_ in store.find(prefix) if object_ not in objects]:
        store.rm(former)
    store.put_file(objects[whole], whole)


def _objects_of(folder: Path) -> tuple[Any, str]:
    """Return the file system of a folder in an object store, and the folder's name there."""
    remote: Any = folder
    return remote.fs, remote.path.rstrip("/")
