"""Attacks that the search of the guide found, kept in the repository: modes of a campaign."""

from pathlib import Path

import pytest

from sim.modes import modes

FOUND = Path(__file__).parents[3] / "examples" / "found_attacks"


def test_found_attacks_alter_topics_in_place_and_have_a_normal_control(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = {path.stem for path in FOUND.glob("*.yaml")}
    assert len(names) >= 4
    assert not names & set(modes())
    monkeypatch.setenv("ORACLE_SCENARIOS", str(FOUND))
    monkeypatch.setenv("ORACLE_ALLOW_ACTUATION", "1")
    found = {name: modes()[name] for name in names}
    normal = found.pop("unaltered")
    assert normal.label == "normal"
    assert all(mode.scenario.is_in_place for mode in found.values())
    assert {mode.label for mode in found.values()} == {"malicious"}
