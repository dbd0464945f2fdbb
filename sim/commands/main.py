"""``oracle-sim``: the group of all commands that record or inspect runs."""

import pkgutil
from typing import Any

import click

from oracle_pipeline.bags.terminal import PlainTextGroup, version_option


class _LazyGroup(PlainTextGroup):
    """Commands whose modules are imported only when needed, so that each starts quickly.

    Attributes
    ----------
    places : dict of str to str
        Location of each command, by its name: ``module:attribute``.
    """

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.places: dict[str, str] = {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *self.places})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.places:
            return super().get_command(ctx, cmd_name)
        command: click.Command = pkgutil.resolve_name(self.places[cmd_name])
        return command


@click.group(cls=_LazyGroup)
@version_option
def main() -> None:
    """Record robot experiments in the simulated testbeds, as rosbag2, and alter recordings.

    \b
    Examples:
        oracle-sim record -m lidar_passthrough -n 5 --goals 1 --out lab
        oracle-sim scenario show random_noise > my_attack.yaml
        oracle-sim mutate my_robot_bag/ attacked_bag/ my_attack.yaml --at 12
    """  # noqa: D301 -- click reads the control character


main.places |= {
    "grid": "sim.commands.grid:grid",
    "mutate": "sim.commands.mutate:mutate",
    "record": "sim.commands.record:record",
    "scenario": "sim.commands.scenario:scenario",
    "serve": "sim.commands.serve:serve",
}
