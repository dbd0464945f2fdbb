"""Output to a terminal, with control characters escaped.

Names and strings of a bag, a manifest or a scenario file may contain control sequences, which could
set a terminal's title, move its cursor, or hide and forge lines. Everything that our commands print
and that Dagster logs passes through this module.
"""

import atexit
import contextlib
import gc
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TextIO, TypeVar, cast

import click

if TYPE_CHECKING:
    from tqdm import tqdm

T = TypeVar("T")

version_option = click.version_option(package_name="ros2-behaviour-oracle")


class _Printable(dict[int, str | int]):
    """Translate each character that is no part of plain text into its Python escape."""

    def __missing__(self, code: int) -> str | int:
        character = chr(code)
        plain = character.isprintable() or character in "\n\t"
        self[code] = code if plain else ascii(character)[1:-1]
        return self[code]


_PRINTABLE = _Printable()
_LISTED = 5  # words
_RESET = "\x1b[0m"  # of a terminal's colours


def printable(text: str) -> str:
    """Return text with control, format and lone surrogate characters escaped."""
    return text if text.isprintable() else text.translate(_PRINTABLE)


def count_of(number: int, noun: str) -> str:
    """Return a number of things in words: ``1 run``, ``2 runs``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def join_first(words: Sequence[str]) -> str:
    """Return the first five words in a list, and how many more there are.

    Examples
    --------
    >>> join_first(["/a", "/b"]), join_first([f"/{n}" for n in range(8)])
    ('/a, /b', '/0, /1, /2, /3, /4 and 3 more')
    """
    more = f" and {len(words) - _LISTED} more" if len(words) > _LISTED else ""
    return f"{', '.join(words[:_LISTED])}{more}"


def aligned_lines(rows: Sequence[Sequence[str]], *, indent: str = "") -> Iterator[str]:
    """Yield the rows of a table as lines whose columns begin below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        padded = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield f"{indent}{'  '.join(padded)}".rstrip()


class _Stream:
    """A text stream that takes no control characters."""

    def __init__(self, stream: TextIO) -> None:
        self._wrapped = stream  # tqdm finds the wrapped stream by this name

    def write(self, text: str) -> int:
        if text == _RESET:  # colorama, which Numba uses, ends every process with it
            return len(text)
        return self._wrapped.write(printable(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wrapped, name)


class PlainTextGroup(click.Group):
    """A group of commands that can send only plain text to a terminal, and may be cut short."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, and end quietly where the reader of its output does."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:  # the reader has seen enough, as `head` has
            os._exit(141)  # 128 + SIGPIPE, as of other programs

    def main(self, *arguments: Any, **settings: Any) -> Any:
        """Run a command, with its errors, on streams that take no control characters."""
        atexit.register(gc.freeze)  # else the end of the process searches all modules for garbage
        with (
            contextlib.redirect_stdout(cast(TextIO, _Stream(sys.stdout))),
            contextlib.redirect_stderr(cast(TextIO, _Stream(sys.stderr))),
        ):
            return super().main(*arguments, **settings)


def progress_bar(
    items: Iterable[T], *, unit: str, total: int | None = None, desc: str = "", leave: bool = True
) -> "tqdm[T]":
    """Return items with a bar on the terminal, which it may control; silent where there is none.

    Parameters
    ----------
    items
        Items to count; empty if the caller counts.
    unit
        Name of one item.
    total
        Number of items, if they have no length.
    desc
        Text before the bar.
    leave
        Whether the bar stays after the last item.
    """
    from tqdm import tqdm  # not every command has a bar

    class Bar(tqdm):  # type: ignore[type-arg]
        monitor_interval = 0  # no thread, so that this process can be forked

    return Bar(
        items, desc=printable(desc), total=total, leave=leave, unit=unit, dynamic_ncols=True,
        file=getattr(sys.stderr, "_wrapped", sys.stderr), disable=None,
    )  # fmt: skip


def escape_logs() -> None:
    """Escape the control characters of every message that this process logs from now on."""
    make = logging.getLogRecordFactory()
    if getattr(make, "escapes", False):
        return

    def escaped(*arguments: Any, **settings: Any) -> logging.LogRecord:
        record = make(*arguments, **settings)
        if isinstance(record.msg, str):
            with contextlib.suppress(TypeError, ValueError):  # arguments that do not fit
                record.msg, record.args = printable(record.getMessage()), ()
        if record.exc_info:
            record.exc_text = printable(logging.Formatter().formatException(record.exc_info))
        return record

    escaped.escapes = True  # type: ignore[attr-defined]
    logging.setLogRecordFactory(escaped)
