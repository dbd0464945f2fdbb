"""The section on searches: counted findings, and errors for unreadable files."""

from pathlib import Path

import pytest

from oracle_pipeline.bags.errors import OracleError
from oracle_pipeline.reporting.searched import searched
from tests.oracle_pipeline.reporting.pages import searches_of_two


def test_a_miss_is_a_run_with_an_effect_above_the_false_positive_rate() -> None:
    section = searches_of_two()
    rows = [[cell.text for cell in row] for row in section.table.rows]
    titles = [column.title for column in section.table.columns]
    found = [dict(zip(titles, row, strict=True)) for row in rows]
    assert [each["scenario"] for each in found] == ["drift", "drop"]
    assert [each["of these missed by the oracle"] for each in found] == ["1", "0"]
    assert [each["run in closed loop"] for each in found] == ["2", "1"]
    assert [picture.caption for picture in section.fronts] == ["drift", "drop"]


def test_without_searches_there_is_no_section(tmp_path: Path) -> None:
    assert searched(tmp_path) is None


@pytest.mark.parametrize("content", ["{", '{"findings": [], "impacts": [1]}'])
def test_unreadable_findings_are_an_error_with_the_path(content: str, tmp_path: Path) -> None:
    file = tmp_path / "searches" / "drift" / "findings.json"
    file.parent.mkdir(parents=True)
    file.write_text(content)
    with pytest.raises(OracleError, match="findings.json cannot be read"):
        searched(tmp_path)
