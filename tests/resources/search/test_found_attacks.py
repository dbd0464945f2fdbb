"""What the search of the guide found, and the repository keeps: modes of the next campaign."""

from pathlib import Path

import pytest

from sim.modes import modes

FOUND = Path(__file__).parents[3] / "examples" / "found_attacks"


def test_what_a_search_found_is_an_attack_in_place_without_which_runs_are_normal(
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
