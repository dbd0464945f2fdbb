"""The base classes of all errors that this distribution raises itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_LFS_POINTER = b"version https://git-lfs"  # begins the text that stands for a file


class OracleError(Exception):
    """Root of the tree; its message states what is wrong, where, and what to do next."""


class BagError(OracleError):
    """A bag cannot be written, opened, read or decoded."""


class ManifestError(OracleError):
    """A ``manifest.json`` is missing, unreadable or not valid by its schema."""


class RunDirectoryError(OracleError):
    """A run directory has a bad name, or is not complete."""


class GraphError(OracleError):
    """A GEXF or GraphML file is unreadable or not one of ours."""


class DdsError(OracleError):
    """A DDS domain cannot be joined, or a topic there cannot be read or published."""


def one_line(error: Exception) -> str:
    """Return what an error of other software says, short and without a full stop."""
    return " ".join(str(error).split())[:200].rstrip(".") or type(error).__name__


def refuse_pointer(file: Path) -> None:
    """Raise a `BagError` if a file is only a Git LFS pointer, as in a clone without large files."""
    with file.open("rb") as source:
        if source.read(len(_LFS_POINTER)) == _LFS_POINTER:
            raise BagError(
                f"{file} is only a Git LFS pointer; get the file itself with `git lfs pull`."
            )


@contextmanager
def as_bag_error(path: Path, file: Path) -> Iterator[None]:
    """Turn any error while opening or reading a foreign file into a `BagError`.

    Parameters
    ----------
    path : Path
        The recording.
    file : Path
        Its file that is read; the error names it.
    """
    try:
        yield
    except BagError as error:
        if str(path) in str(error):
            raise
        raise BagError(f"{file}: {error}.") from error
    except MemoryError as error:
        raise BagError(f"{file} needs more memory than is free; split it.") from error
    except Exception as error:  # parsers of corrupt files raise anything
        raise BagError(
            f"{file} is corrupt: {one_line(error)}. Copy it again, or record it again."
        ) from error
