"""How often ``oracle score`` exits 1 where a recording has another length than the card's.

Cards of normal recordings of 1, 2, 4 and 8 goals judge others of each length, normal and attacked.
``ORACLE_BENCH_RUNS`` names a folder to keep recordings in.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from oracle_pipeline import learn, score
from oracle_pipeline.scoring.output import exit_code
from tools.bench.figures import Row
from tools.bench.harmless import CARD_SEED, MODE, NORMAL, SEED, record

LENGTHS = (1, 2, 4, 8)  # goals of a recording
JUDGED = {MODE: 11, "fake_object": 5}  # recordings of each length
FAR = 0.05


def rows() -> Iterator[Row]:
    """Yield the share of recordings with exit code 1, for each card, length and mode."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(os.environ.get("ORACLE_BENCH_RUNS", folder))
        for taught in LENGTHS:
            place = root / f"card{taught}"
            card = learn([record(place, CARD_SEED, n, taught).path for n in range(NORMAL)])
            for goals in LENGTHS:
                for mode, number in JUDGED.items():
                    place = root / f"judged{goals}"
                    runs = [record(place, SEED, n, goals, mode).path for n in range(number)]
                    exits = sum(exit_code([each]) == 1 for each in score(runs, card).verdicts)
                    yield Row(
                        f"card of {taught}, {mode} of {goals} goals", exits / number,
                        goal=FAR if mode == MODE else 0.95, at_most=mode == MODE,
                        remark=f"({exits} of {number})",
                    )  # fmt: skip
