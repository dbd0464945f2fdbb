"""A program that materializes a range of partitions and prints what it left, as JSON.

The number of runs in a partition is read when the code location loads, so a test cannot change it
in its own process. Arguments: a folder, the first partition and the last one.
"""

import json
import sys
from pathlib import Path

from resources.campaign import CampaignSettings
from sim.campaigns import Campaign
from tests.assets.laboratory import PER_RUN, Laboratory, dagster_home


class ShortRuns(CampaignSettings):
    def campaign(self) -> Campaign:
        return Campaign(timeout_s=20.0)


def main(folder: Path, first: str, last: str) -> None:
    with dagster_home(folder / "home") as instance:
        laboratory = Laboratory(folder / "data", instance)
        result = laboratory.materialize(
            [*PER_RUN, "feature_dataset"], first, last, campaign=ShortRuns()
        )
        keys = sorted(laboratory.materialized("run_features"))
        figures = {key: {of: shown(laboratory, of, key) for of in PER_RUN} for key in keys}
        checks = [
            (check.partition, check.check_name, check.passed)
            for check in result.get_asset_check_evaluations()
        ]
        version = (laboratory.latest("feature_dataset").tags or {}) if result.success else {}
        left = {
            "success": result.success,
            "figures": figures,
            "checks": checks,
            "dataset": version.get("dagster/data_version"),
        }
        sys.stdout.write(json.dumps(left) + "\n")


def shown(laboratory: Laboratory, asset: str, key: str) -> dict[str, int | float | str]:
    figures = laboratory.figures(asset, key)
    return {name: of for name, of in figures.items() if isinstance(of, int | float | str)}


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
