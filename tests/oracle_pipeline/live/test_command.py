"""`oracle watch` reports missing requirements and how to install them."""

import subprocess
import sys

import pytest
from click.testing import CliRunner

from oracle_pipeline.cli import main

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
