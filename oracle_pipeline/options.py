"""Options that several commands of ``oracle`` share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from oracle_pipeline.bags.remote import fetched, place_at

Command = TypeVar("Command", bound=Callable[..., Any])


class _Recording(click.Path):
    """A path; what is in an object store is copied to this machine until the command ends."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path on this machine."""
        if ctx is None or "://" not in str(value):
            return super().convert(value, param, ctx)
        try:
            place = place_at(value)
            if place.exists():
                return ctx.with_resource(fetched(place))
            reason = "does not exist"
        except ImportError as error:
            reason = f"needs pip install 'ros2-behaviour-oracle[s3]': {error}"
        except Exception as error:  # clients of object stores raise various exceptions
            reason = f"cannot be read: {error}"
        raise click.BadParameter(f"{value} {reason}", ctx, param)


def _each_recording(_: Any, __: Any, paths: tuple[Path, ...]) -> tuple[Path, ...]:
    from oracle_pipeline.logs.formats import recordings_at

    return tuple(recordings_at(paths))


RECORDING = _Recording(path_type=Path)  # or what is read as one, as an episode of a data set
recordings_argument = click.argument(
    "recordings", metavar="RUN_OR_BAG...", nargs=-1, required=True,
    type=RECORDING, callback=_each_recording,
)  # fmt: skip

plugins_option = click.option(
    "--plugins", type=click.Path(path_type=Path), envvar="ORACLE_PLUGINS",
    help="Folder of feature plugins.  [default: $ORACLE_PLUGINS, if set]")  # fmt: skip

detector_option = click.option(
    "--detector", default="", metavar="NAME",
    help="Detector of plain statistics of all signals that scores in place of ours, such as pca, "
    "isolation_forest or one of an installed package.")  # fmt: skip


def format_option(*formats: str, text: str) -> Callable[[Command], Command]:
    """Return the option for the output format; the first is the default."""
    return click.option(
        "--format", "file_format", type=click.Choice(formats), default=formats[0],
        show_default=True, help=text,
    )  # fmt: skip


def output_option(name: str, text: str, *, required: bool = False) -> Callable[[Command], Command]:
    """Return an option for a file to write."""
    return click.option(
        name, type=click.Path(path_type=Path, dir_okay=False), help=text, required=required
    )


def rate_option(name: str, text: str) -> Callable[[Command], Command]:
    """Return an option for a rate between 0 and 1, by default 0.05."""
    return click.option(
        name, default=0.05, show_default=True, help=text,
        type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    )  # fmt: skip
