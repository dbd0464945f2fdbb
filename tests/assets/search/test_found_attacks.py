"""Attacks that searches found, kept in the repository: modes of a campaign."""

from pathlib import Path

import pytest

from sim.modes import modes
from tools.scripts.found_attacks import CAUGHT, FOUND, place_of


@pytest.mark.parametrize("folder", [FOUND, CAUGHT])
def test_found_attacks_alter_topics_in_place_and_name_their_block(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    attacks = {path.stem for path in folder.glob("*.yaml") if place_of(path) is not None}
    assert not attacks & set(modes())
    monkeypatch.setenv("ORACLE_SCENARIOS", str(folder))
    monkeypatch.setenv("ORACLE_ALLOW_ACTUATION", "1")
    found = {mode.id: mode for mode in modes().values() if mode.id in attacks}
    assert found.keys() == attacks
    assert all(mode.scenario.is_in_place and mode.label == "malicious" for mode in found.values())


def test_a_normal_mode_has_the_same_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORACLE_SCENARIOS", str(FOUND))
    assert modes()["unaltered"].label == "normal"


def test_a_caught_attack_says_which_revision_caught_it() -> None:
    for file in CAUGHT.glob("*.yaml"):
        assert file.read_text("utf-8").splitlines()[-1].startswith("# Caught at revision ")
