"""``oracle-sim serve``: a testbed on a DDS domain, in real time.

It uses the wall clock, which else only ``sim.outside`` does, to slow the run down to real time. It
changes nothing in the run, unless another program publishes to it.
"""

import contextlib
import queue
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.bags.run_directory import RunDirectory
from sim.campaigns import Campaign, Options, Wiring
from sim.commands.batch import mode_option, seed_option, short_errors
from sim.experiments import recipe_for, record_run
from sim.middleware.executor import SECOND
from sim.modes import find_mode

if TYPE_CHECKING:
    from sim.testbed_run import TestbedRun

DEFAULT_MODE = "lidar_passthrough_odom"  # its node can be switched to every built-in attack
_TIMEOUT_S = 120.0  # of simulated time, for each goal
_HEAD_START_S = 4.0  # time for other programs to discover the nodes before the first message
_LEAD_S = 0.002  # by which simulated time may be ahead; shorter sleeps are not worth their cost
_HELP = "Type `attack NAME` (a mode or a scenario file), `attack off`, or Ctrl-C."


@click.command()
@mode_option(DEFAULT_MODE)
@click.option(
    "--speed", default=1.0, show_default=True, type=click.FloatRange(0.0, min_open=True),
    help="Real-time factor, limited by the speed of the machine.")  # fmt: skip
@click.option(
    "--domain", type=click.IntRange(0, 232),
    help="DDS domain.  [default: $ROS_DOMAIN_ID, else 0]")  # fmt: skip
@click.option("--run", default=0, show_default=True, type=click.IntRange(min=0),
              help="Which run of the campaign: its start, goals and nuisance.")  # fmt: skip
@click.option("--goals", default=20, show_default=True, type=click.IntRange(min=1),
              help="Goals of the patrol; it ends after the last.")  # fmt: skip
@click.option(
    "--without-node", is_flag=True,
    help="Leave out the mode's node, for another program to take its place.")  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Root to store the run in, as `oracle-sim record` does.  [default: it is not kept]",
)  # fmt: skip
@seed_option
def serve(
    mode: str, speed: float, domain: int | None, run: int, goals: int, without_node: bool,
    out: Path | None, seed: int,
) -> None:  # fmt: skip
    """Run a testbed on a real DDS domain, in real time.

    All topics have their ROS names and QoS profiles, including `/clock`, and `ros_discovery_info`
    lists the nodes. So `oracle watch` and ROS 2 tools can observe it. Its nodes also receive what
    other programs publish, unless the run is kept. There are no services.

    While it runs, a line on standard input switches an attack on or off:

    \b
        attack random_noise
        attack off

    \b
    Examples:
        oracle-sim serve
        oracle-sim serve -m random_noise --speed 2 --domain 7
    """  # noqa: D301 -- click reads the control character
    with short_errors():
        wiring: Wiring = "absent" if without_node else "additive"
        campaign = Campaign(
            seed, goals, timeout_s=_TIMEOUT_S * goals, options=Options(wiring=wiring)
        )
        _serve(mode, speed, domain, run, campaign, out)


def _serve(
    mode: str, speed: float, domain: int | None, run: int, campaign: Campaign, out: Path | None
) -> None:
    from oracle_pipeline.bags.dds_names import default_domain

    recipe = recipe_for(mode, run, campaign)
    number = default_domain() if domain is None else domain
    with contextlib.ExitStack() as stack:
        root = out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        directory = RunDirectory(root, mode, run)
        if directory.is_complete():
            raise click.ClickException(f"{directory.path} exists already; choose another --out.")
        try:
            record_run(
                recipe,
                directory,
                accompany=lambda started: _Session(
                    started, speed, number, mode, run, campaign, is_kept=out is not None
                ),
            )
        except KeyboardInterrupt:
            click.echo("Ended; the run is not kept.", err=True)
        else:
            click.echo(f"The patrol is over.{f' Run: {directory.path}' if out else ''}", err=True)


class _Session:
    """Accompanies a run: paces it, serves its domain, and executes typed commands."""

    def __init__(
        self, run: "TestbedRun", speed: float, number: int, mode: str, block: int,
        campaign: Campaign, *, is_kept: bool,
    ) -> None:  # fmt: skip
        from sim.serving import ServedDomain

        if not hasattr(run, "domain"):
            raise click.ClickException(f"{mode} is on DDS by itself: `oracle-sim record` runs it.")
        self._run, self._speed, self._mode, self._is_kept = run, speed, mode, is_kept
        self._block, self._campaign = block, campaign
        self._typed: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._served = ServedDomain(run.domain, number, receives=not is_kept)
        self._served.look(run.domain.executor.now_ns)
        time.sleep(_HEAD_START_S)
        self._started = time.monotonic()
        run.domain.executor.accompany(self._advance)
        threading.Thread(target=self._read, name="stdin", daemon=True).start()
        click.echo(f"Serving {mode} on domain {number}. {_HELP}", err=True)

    def _read(self) -> None:
        for line in sys.stdin:
            self._typed.put(line)

    def _advance(self, now_ns: int) -> None:
        """Wait until wall time has reached the time of the simulation."""
        self._served.look(now_ns)
        self._served.listen()
        while not self._typed.empty():
            self._do(self._typed.get(), now_ns)
        ahead_s = now_ns / SECOND / self._speed - (time.monotonic() - self._started)
        if ahead_s > _LEAD_S:
            time.sleep(ahead_s)

    def _do(self, line: str, now_ns: int) -> None:
        from sim.serving import switch

        words = line.split()
        if not words:
            return
        if len(words) != 2 or words[0] != "attack":
            click.echo(_HELP, err=True)
            return
        if self._is_kept:
            click.echo("A run that is kept must follow its recipe; serve without --out.", err=True)
            return
        name = self._mode if words[1] == "off" else words[1]
        try:
            switch(self._run, recipe_for(find_mode(name), self._block, self._campaign))
        except OracleError as error:
            click.echo(str(error), err=True)
        else:
            click.echo(f"At {now_ns / SECOND:.3f} s the node runs {name}.", err=True)
