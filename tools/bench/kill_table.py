"""The kill matrix of mutants of the program, as Markdown: which oracles notice which mutants.

``program_mutants`` makes the runs. Each row is a run: ``mutant`` (`UNMUTATED` for none),
``operator``, ``block``, ``state``, ``what`` (the effect or the error), and for each oracle whether
it called the run, or NaN if it did not judge it.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from oracle_pipeline.evaluation.metrics import share
from tools.bench.mutations import OPERATORS

UNMUTATED = "unmutated"
#: What a mutant does to a run: it leaves no recording, no, another or a task done otherwise.
NONE, EQUAL, CHANGED, EFFECT = "no recording", "equal", "other messages", "effect on the task"
DIFFERS = (CHANGED, EFFECT)  # states of runs that an oracle could notice
CARD = "card"
ORACLES = ("implicit", "specified", "invariants", "metamorphic", "human", CARD)

_SEED = 0  # of the intervals


def kill_table(runs: pd.DataFrame) -> Iterator[str]:
    """Yield a row for each operator, then those of all mutants, and of none.

    Rates are shares of the runs whose messages differ from those without the mutant. Their
    intervals respect that the runs of one mutant resemble each other. Without a mutant, they are
    those of the runs that all oracles judged.
    """
    yield f"| mutants | number | no recording | equivalent | runs | {' | '.join(ORACLES)} |"
    yield "| --- " * (5 + len(ORACLES)) + "|"
    mutated = runs[runs["mutant"] != UNMUTATED]
    for operator in OPERATORS:
        yield _row(operator, mutated[mutated["operator"] == operator])
    yield _row("all", mutated)
    yield _row(f"all, runs with an {EFFECT}", mutated[mutated["state"] == EFFECT])
    plain = runs[(runs["mutant"] == UNMUTATED) & runs[CARD].notna()]
    yield f"| none | | | | {len(plain)} | {_rates(plain, plain['block'])} |"


def named(runs: pd.DataFrame) -> Iterator[str]:
    """Yield which mutants are equivalent, leave no recording, or have a missed effect."""
    mutated = runs[runs["mutant"] != UNMUTATED]
    effect = mutated[mutated["state"] == EFFECT]
    missed = effect.groupby("mutant", sort=False).filter(lambda of: not of[CARD].any())
    yield f"Equivalent on these runs: {_listed(_of_state(mutated, EQUAL))}."
    yield f"Without a recording: {_listed(_of_state(mutated, NONE))}."
    yield f"With an {EFFECT} that the card missed: {_listed(missed)}."


def _row(name: str, mutated: pd.DataFrame) -> str:
    differs = mutated[mutated["state"].isin(DIFFERS)]
    groups = (mutated, *(_of_state(mutated, state) for state in (NONE, EQUAL)))
    counts = " | ".join(str(group["mutant"].nunique()) for group in groups)
    return f"| {name} | {counts} | {len(differs)} | {_rates(differs, differs['mutant'])} |"


def _of_state(mutated: pd.DataFrame, state: str) -> pd.DataFrame:
    """Return the mutants all of whose runs have a state."""
    return mutated.groupby("mutant", sort=False).filter(lambda of: (of["state"] == state).all())


def _rates(runs: pd.DataFrame, cluster: "pd.Series[str]") -> str:
    """Return the share of runs that each oracle called, with intervals over clusters."""
    number = np.unique(cluster, return_inverse=True)[1]
    rates = []
    for oracle in ORACLES:
        known = runs[oracle].notna().to_numpy()
        called = runs[oracle].to_numpy(dtype=np.float64)[known] > 0.0
        rates.append(str(share(called, number[known], np.random.default_rng(_SEED))))
    return " | ".join(rates)


def _listed(runs: pd.DataFrame) -> str:
    """Return the names of mutants, with the first that is known of each."""
    about = runs.groupby("mutant", sort=False)["what"].first()
    names = (
        f"`{name}`" + (f" ({of})" if isinstance(of, str) else "") for name, of in about.items()
    )
    return ", ".join(names) or "none"
