"""An MkDocs hook that puts the help of every command into the page of commands.

The page holds a line ``<!-- commands: oracle_pipeline.cli:main oracle -->`` for each program.
"""

import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import click

MARK = re.compile(r"^<!-- commands: ([\w.]+):(\w+) ([\w-]+) -->$", re.M)
WIDTH = 90


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace each mark by the commands of its program."""
    return MARK.sub(lambda found: "\n".join(commands(*found.groups())), markdown)


def commands(module: str, name: str, program: str) -> Iterator[str]:
    """Yield the headings and help texts of a program and of all its commands."""
    group: click.Group = getattr(import_module(module), name)
    context = click.Context(group, info_name=program, max_content_width=WIDTH, terminal_width=WIDTH)
    yield f"## {program}\n"
    yield from described(group, context, depth=2)


def described(command: click.Command, context: click.Context, depth: int) -> Iterator[str]:
    """Yield the help of a command, then its subcommands."""
    text = command.get_help(context)
    # The choice of modes would fill half a page; reference/modes.md lists them.
    text = re.sub(r"\[lidar_passthrough\|[^\]]+\]", "MODE", text)
    yield f"```text\n{text}\n```\n"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            if (found := command.get_command(context, name)) is None:
                raise LookupError(f"{context.command_path} lists {name} but does not have it.")
            yield f"{'#' * (depth + 1)} {context.command_path} {name}\n"
            yield from described(found, click.Context(found, context, name), depth + 1)
