"""No text in a bag, a scenario file or a name controls the terminal that shows it."""

import contextlib
import io
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from oracle_pipeline.bags.terminal import PlainTextGroup, printable

pytestmark = pytest.mark.slow

TITLE = "\x1b]0;owned\x07"  # sets the title of a terminal
UP = "\x1b[1A\x1b[2K\r\x9b31m\u202e"  # overwrites the line above, turns red, turns text around
BAD = f"{TITLE}{UP}name"
BIN = Path(sys.executable).parent
CONTROLS = {chr(code) for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) not in "\r\n\t"}
DAGSTER = """
import sys
import dagster as dg
import oracle_pipeline.definitions

BAD = {bad!r}

@dg.op
def fails(context):
    context.log.warning("topic " + BAD)
    raise dg.Failure("no topic " + BAD)

@dg.op
def is_defect():
    dg.get_dagster_logger().warning("topic %s", BAD)
    raise ValueError("not even topic " + BAD)

@dg.job(executor_def=dg.in_process_executor)
def reads():
    fails()
    is_defect()
"""


def on_a_terminal(*command: str, cwd: Path) -> str:
    """Return all that a command sends to the terminal that it is started on."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    environment |= {"DAGSTER_HOME": str(cwd), "TERM": "xterm"}
    with subprocess.Popen(
        command, cwd=cwd, env=environment, stdin=theirs, stdout=theirs, stderr=theirs
    ):
        os.close(theirs)
        shown = b"".join(parts_of(ours))
    os.close(ours)
    return shown.decode("utf-8", "replace")


def parts_of(terminal: int) -> Iterator[bytes]:
    try:
        while part := os.read(terminal, 65536):
            yield part
    except OSError:  # the other end is closed
        return


def assert_harmless(shown: str) -> None:
    assert "owned" in shown  # the name is shown, and so is what was in it
    assert r"\x1b]0;owned\x07" in shown
    for control in (TITLE, "\x1b]", "\x1b[1A", "\x1b[2K", "\x9b", "\u202e", "\r\\x9b"):
        assert control not in shown


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag whose topic, and whose strings, are hostile."""
    store, place = get_typestore(Stores.ROS2_HUMBLE), tmp_path / f"bag{BAD}"
    text = store.types["std_msgs/msg/String"]
    with Writer(place, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection(f"/{BAD}", text.__msgtype__, typestore=store)
        for stamp in np.arange(3) * 10**9:
            message = store.serialize_cdr(text(data=BAD), text.__msgtype__)
            writer.write(topic, int(stamp), message)
    return place


def test_features_of_a_hostile_bag(bag: Path, tmp_path: Path) -> None:
    shown = on_a_terminal("oracle", "features", str(bag), cwd=tmp_path)
    for control in CONTROLS:
        assert control not in shown


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    assert_harmless(on_a_terminal("oracle", "features", f"no{BAD}", cwd=tmp_path))


def test_a_scenario_file_that_is_refused_is_named(tmp_path: Path) -> None:
    (tmp_path / f"{BAD}.yaml").write_text("nothing: 1")
    assert_harmless(on_a_terminal("oracle-sim", "scenario", "check", f"{BAD}.yaml", cwd=tmp_path))


def test_control_characters_in_dagsters_log_are_escaped(tmp_path: Path) -> None:
    (tmp_path / "job.py").write_text(DAGSTER.format(bad=BAD))
    shown = on_a_terminal("dagster", "job", "execute", "-f", "job.py", "-j", "reads", cwd=tmp_path)
    assert_harmless(shown)
    for text in ("no topic", "not even topic"):  # of a failure and of an exception
        assert f"{text} {printable(BAD)}" in shown


@given(st.text())
def test_printable_text_holds_text_only_and_plain_text_stays(text: str) -> None:
    made = printable(text)
    assert all(character.isprintable() or character in "\n\t" for character in made)
    made.encode()  # raises if a surrogate stands alone
    assert printable(made) == made
    if all(character.isprintable() or character in "\n\t" for character in text):
        assert made == text


class _Ends(click.Command):
    """Prints a line, and then what resets the colours of a terminal, as colorama does."""

    def invoke(self, _context: click.Context) -> None:
        click.echo("done")
        sys.stdout.write("\x1b[0m")


def test_the_end_of_colours_that_a_library_writes_is_not_shown_as_text() -> None:
    with contextlib.redirect_stdout(io.StringIO()) as sink:
        PlainTextGroup("group", commands=[_Ends("ends")]).main(["ends"], standalone_mode=False)
    assert sink.getvalue() == "done\n"
