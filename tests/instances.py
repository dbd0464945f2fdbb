"""Dagster instances as ``.dagster_home/dagster.yaml`` configures them, in other folders."""

import os
import shutil
from pathlib import Path
from unittest import mock

import dagster as dg

SETTINGS = Path(__file__).parent.parent / ".dagster_home" / "dagster.yaml"


def make_home(home: Path) -> Path:
    """Make a folder the home of an instance."""
    home.mkdir(exist_ok=True)
    shutil.copy(SETTINGS, home)
    return home


def instance_of(home: Path) -> dg.DagsterInstance:
    """The instance of a home, opened as by a program that was started with this DAGSTER_HOME."""
    with mock.patch.dict(os.environ, DAGSTER_HOME=str(home)):
        return dg.DagsterInstance.from_config(str(home))
