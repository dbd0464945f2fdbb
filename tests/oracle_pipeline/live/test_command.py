"""`oracle watch` reports missing requirements and how to install them."""

import subprocess
import sys

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main
from oracle_pipeline.live.events import ContractAlarm, Note, WindowAlarm, WindowVerdict
from oracle_pipeline.live.recorder import Recorder
from oracle_pipeline.live.split_bag import Split
from oracle_pipeline.live.watch_command import lines_of
from oracle_pipeline.scoring.card import ReferenceCard
from oracle_pipeline.scoring.contract import Breach
from oracle_pipeline.scoring.verdict import Evidence
from sim.middleware.qos import DEFAULT
from tests.oracle_pipeline.live.robots import STRING, TEXT

WITHOUT = "import sys; sys.modules['cyclonedds'] = None; from {module} import main; main({words})"


def without_dds(module, *words):
    code = WITHOUT.format(module=module, words=list(words))
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_without_dds_the_command_that_installs_it_is_named():
    for module, *words in (("oracle_pipeline.cli", "watch"), ("assets.oracle_sim", "serve")):
        done = without_dds(module, *words)
        assert done.returncode != 0
        assert "pip install" in done.stderr
        assert "[live]" in done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_without_dds_help_and_other_commands_work():
    assert without_dds("oracle_pipeline.cli", "watch", "--help").returncode == 0


def test_a_missing_card_ends_with_2(tmp_path):
    done = CliRunner().invoke(main, ["watch", "--reference", str(tmp_path / "none.card")])
    assert done.exit_code == 2
    assert "oracle learn" in done.output


def test_a_name_with_a_newline_forges_no_line():
    name = "/a\nALARM in the window"
    alarm = ContractAlarm(1.0, (Breach(name, f"Topic {name} is new."),))
    evidence = Evidence("f", 9.0, False, 1.0, "m", 0.0, 0.1, name, 1.0)
    window = WindowAlarm(WindowVerdict(0.0, 5.0, 9.0, 0.1, False, True, (evidence,)))
    for event in (Note(name), alarm, window):
        lines = list(lines_of(event, None, "text"))
        assert lines
        assert not any("\n" in line for line in lines)


def test_watch_learns_a_card_from_all_pieces_of_its_folder_that_are_long_enough(domain, tmp_path):
    for number, seconds in enumerate((100, 100, 100, 20)):
        piece = Recorder(tmp_path / "good" / str(number), {"recording_s": seconds}, Split(), 0)
        piece.add_topic("/words", STRING, [DEFAULT])
        for tick in range(10 * seconds):
            piece.write("/words", 10**12 + (10**8 + 10**5 * number) * tick, TEXT)
        piece.close()
    card = tmp_path / "robot.card"
    options = ["--domain", str(domain), "--out", str(tmp_path / "good"), "--duration", "0.1"]
    done = CliRunner().invoke(main, ["watch", "--learn", str(card), *options])
    assert done.exit_code == 0, done.output
    assert len(ReferenceCard.load(card).runs) == 3
