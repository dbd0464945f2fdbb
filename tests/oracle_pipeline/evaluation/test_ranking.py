import numpy as np
import pandas as pd
from hypothesis import given
from hypothesis import strategies as st

from oracle_pipeline.evaluation.ranking import Ranking, standing

scores = st.lists(
    st.tuples(st.booleans(), st.one_of(st.just(np.nan), st.integers(-3, 3).map(float))), min_size=1
)


def table(rows):
    return pd.DataFrame(
        {
            "mode": ["fake_object" if attacked else "lidar_passthrough" for attacked, _ in rows],
            "label": ["malicious" if attacked else "normal" for attacked, _ in rows],
            "score": [score for _, score in rows],
            "p": [0.01 if attacked else np.nan for attacked, _ in rows],
        }
    )


@given(scores)
def test_attacked_runs_on_top_are_among_the_n_highest_scores(rows):
    ranking = Ranking.of(table(rows))
    attacked = sorted((s for a, s in rows if a and not np.isnan(s)), reverse=True)
    normal = sorted((s for a, s in rows if not a and not np.isnan(s)), reverse=True)
    assert (ranking.attacked, ranking.normal) == (len(attacked), len(normal))
    places = [n + 1 + sum(other >= score for other in normal) for n, score in enumerate(attacked)]
    assert ranking.on_top == sum(place <= len(attacked) for place in places)


@given(scores)
def test_every_mode_has_one_row_attacked_modes_first(rows):
    found = standing(table(rows))
    assert found["runs"].sum() == len(rows)
    assert list(found["label"]) == sorted(found["label"])
    assert (found["called"] <= found["judged"]).all()
