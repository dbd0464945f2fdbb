"""Whether the streams that measure the robot's motion agree: odometry, IMU, wheels, scans.

All sources measure the same motion, so they must agree. Each source is compared with every other
source of the same quantity: the ratio of their gains (the scale), the delay (the lag), the
unexplained remainder (the residual), and its mean (the drift). Sources of the direction of travel
are compared in it, too (the bearing). No stream is trusted. If one is
altered, it disagrees with all others; if several are altered together, they disagree with the
unaltered ones.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.engine import plugin as fp
from oracle_pipeline.features.geometry.scan_matching import Steps
from oracle_pipeline.features.geometry.scanner_setup import scanner_setup
from oracle_pipeline.features.geometry.scans import Bools, Floats, Points
from oracle_pipeline.features.motion import ego_motion as ego
from oracle_pipeline.features.statistics.reduction import (
    MAD_TO_DEVIATION,
    largest,
    quantile,
    within,
)
from oracle_pipeline.features.statistics.times import even_spans


class Pair(NamedTuple):
    """Two kinds of sources that measure one quantity."""

    quantity: str
    first: str
    second: str

    def column(self, statistic: str) -> str:
        """Return the name of one of the pair's features."""
        return f"{self.quantity}_{statistic}_{self.first}_{self.second}"

    @property
    def is_directed(self) -> bool:
        """Whether both sources measure the direction of travel."""
        return self in _DIRECTED

    @property
    def statistics(self) -> tuple[str, ...]:
        """The names of the pair's statistics, the first of `Fit`."""
        return Fit._fields if self.is_directed else Fit._fields[:-1]


class Fit(NamedTuple):
    """Agreement of the second source with the first; NaN where unknown."""

    scale: float = math.nan  # logarithm of the ratio
    lag: float = math.nan  # [s]
    residual: float = math.nan  # root mean square of the remainder [unit/s]
    drift: float = math.nan  # mean of the remainder [unit/s]
    bearing: float = math.nan  # direction of travel of the second in that of the first [rad]


#: From the more exact source to the other: the second is explained by the first.
PAIRS = (
    Pair(ego.TURN, ego.POSE, ego.TWIST),
    Pair(ego.TURN, ego.POSE, ego.GYRO),
    Pair(ego.TURN, ego.POSE, ego.ORIENTATION),
    Pair(ego.TURN, ego.GYRO, ego.ORIENTATION),
    Pair(ego.TURN, ego.POSE, ego.JOINTS),
    Pair(ego.TURN, ego.GYRO, ego.JOINTS),
    Pair(ego.TURN, ego.POSE, ego.SCAN),
    Pair(ego.TURN, ego.GYRO, ego.SCAN),
    Pair(ego.TURN, ego.PLACE, ego.POSE),
    Pair(ego.TURN, ego.COMMAND, ego.POSE),
    Pair(ego.TURN, ego.COMMAND, ego.GYRO),
    Pair(ego.TRAVEL, ego.POSE, ego.TWIST),
    Pair(ego.TRAVEL, ego.POSE, ego.JOINTS),
    Pair(ego.TRAVEL, ego.POSE, ego.SCAN),
    Pair(ego.TRAVEL, ego.JOINTS, ego.SCAN),
    Pair(ego.TRAVEL, ego.PLACE, ego.POSE),
    Pair(ego.TRAVEL, ego.COMMAND, ego.POSE),
    Pair(ego.SPIN, ego.ANGLES, ego.RATES),
)

_DIRECTED = {Pair(ego.TRAVEL, ego.POSE, ego.TWIST), Pair(ego.TRAVEL, ego.POSE, ego.SCAN)}
_UNITS = {ego.TURN: "rad/s", ego.TRAVEL: "m/s", ego.SPIN: "rad/s"}
_FEWEST = 8  # spans of a comparison
_LEAST = {ego.TURN: 0.5, ego.TRAVEL: 0.3, ego.SPIN: 3.0}  # total gain needed to estimate a scale
_OBEYED = 1.5  # times the least residual: limit for a command that the robot may obey
_EXACT = 5e-3  # residual below which commands cannot be distinguished [unit/s]
_NO_SCALE = 1e-3  # of a second source that does not follow the first
_OUTLYING = 4.0  # robust deviations; spans beyond are left out of the fit of scale and lag


def _floors(pair: Pair) -> tuple[float, float, float, float]:
    """Return the resolutions of scale, lag, residual and drift.

    A real robot obeys its commands within some per cent: it accelerates, and stops for people.
    """
    if ego.COMMAND in pair:
        return 0.05, 0.02, 0.05, 0.02
    if ego.PLACE in pair:
        return 5e-3, 0.02, 0.02, 5e-3
    if pair.quantity == ego.SPIN:
        return 2e-3, 0.02, 0.02, 5e-3
    return (5e-3, 0.02, 2e-3, 5e-3) if ego.SCAN in pair else (2e-3, 0.02, 2e-3, 1e-3)


def _features() -> Iterator[fp.Feature]:
    furthest, most = "value furthest from 0 over the topics", "maximum over the topics"
    left = "the residual, after scale and lag,"
    for pair in PAIRS:
        scale, lag, residual, drift = _floors(pair)
        what = f"{pair.quantity} from {pair.second} relative to {pair.first}"
        rate = _UNITS[pair.quantity]
        columns = {
            "scale": ("1", scale, f"ln of the scale of {what}; {furthest}"),
            "lag": ("s", lag, f"delay of {what}; {furthest}"),
            "residual": (rate, residual, f"root mean square of {left} of {what}; {most}"),
            "drift": (rate, drift, f"mean of {left} of {what}; {furthest}"),
            "bearing": ("rad", 5e-3, f"direction of {what}; {furthest}"),
        }
        for statistic in pair.statistics:
            timing = statistic in ("lag", "residual", "drift")
            yield fp.Feature(pair.column(statistic), *columns[statistic], "domain", timing=timing)
    yield fp.Feature(
        "gravity", "m/s^2", 0.02, "median magnitude of an IMU's linear acceleration; maximum over "
        "the topics", "domain",
    )  # fmt: skip
    yield fp.Feature(
        "gravity_residual", "m/s^2", 0.02, "magnitude of an IMU's mean linear acceleration minus "
        "gravity, with the vertical from its orientation; maximum over the topics", "domain",
    )  # fmt: skip


FEATURES = tuple(_features())


@dataclass(frozen=True, slots=True)
class _PairedGains:
    """The gains of two sources, span by span; shape (n,) each."""

    times_s: Floats  # ends of the spans in the recording
    lengths_s: Floats
    first: Points
    first_slope: Points  # derivative of the first's gains by the time of the spans [1/s]
    second: Points
    unit: float  # of the first's gains in one of the second's: 1 m, or the radius of a wheel


@dataclass(frozen=True, slots=True)
class _Prepared:
    """All comparisons of a recording."""

    pairs: Mapping[Pair, Mapping[str, _PairedGains]]  # by place: the two topics
    gravity: Mapping[str, fp.Series]
    unexplained: Mapping[str, fp.Series]


def prepare(window: fp.Window) -> _Prepared | fp.Missing:
    """Compare every source with every other source of its quantity."""
    found = ego.sources(window.topics, scanner_setup(window))
    pairs = {pair: dict(_compared(found, pair)) for pair in PAIRS}
    if not any(pairs.values()) and not found.gravity:
        return fp.Missing("fewer than two sources measure the robot's motion")
    return _Prepared(pairs, found.gravity, found.unexplained)


def compute(window: fp.Window) -> fp.Values:
    """Fit scale and lag to the window's spans."""
    prepared: _Prepared = window.prepared
    values: dict[str, float | fp.Located | fp.Missing] = {}
    for pair, places in prepared.pairs.items():
        fits = {place: _fitted(pair, each, window) for place, each in places.items()}
        if not places:
            why = fp.Missing(f"no {pair.quantity} from both {pair.first} and {pair.second}")
            values |= {pair.column(statistic): why for statistic in pair.statistics}
            continue
        if ego.COMMAND in pair or ego.PLACE in pair:
            fits = _obeyed(fits)
        still = f"too little {pair.quantity} was measured in this window"
        for number, statistic in enumerate(pair.statistics):
            reduced = largest if statistic == "residual" else _furthest
            values[pair.column(statistic)] = reduced(
                {place: fit[number] for place, fit in fits.items()}, still
            )
    lengths = {topic: quantile(series, window, 0.5) for topic, series in prepared.gravity.items()}
    values["gravity"] = largest(lengths, "no IMU")
    values["gravity_residual"] = largest(
        {
            topic: float(np.linalg.norm(series.values[part].mean(axis=0)))
            for topic, series in prepared.unexplained.items()
            if (part := within(series.times_s, window)).stop > part.start
        },
        "no IMU with orientation and a known mount",
    )
    return values


@jit
def fit(first: Points, slope: Points, second: Points) -> tuple[float, float, Bools]:
    """Fit ``second = scale * (first - lag * slope)`` by least squares without outliers.

    How far an outlier is follows from the spans in which the robot moves. A robot that stands most
    of the time fits there exactly, whatever the scale.

    Returns
    -------
    scale, lag : float
        NaN if nothing can be fitted.
    kept : ndarray of bool, shape (n,)
        The spans that are not outliers.
    """
    kept = np.ones(len(first), np.bool_)
    moves = np.abs(first) >= np.abs(first).mean() / 2.0
    scale, lag = math.nan, math.nan
    for _ in range(3):
        bb = bd = dd = ba = da = 0.0
        for i in range(len(first)):
            if kept[i]:
                b, d, a = first[i], slope[i], second[i]
                bb += b.real * b.real + b.imag * b.imag
                dd += d.real * d.real + d.imag * d.imag
                bd += b.real * d.real + b.imag * d.imag
                ba += b.real * a.real + b.imag * a.imag
                da += d.real * a.real + d.imag * a.imag
        determinant = bb * dd - bd * bd
        if bb <= 0.0:
            break
        if determinant > 1e-9 * bb * bb:
            scale, g = (ba * dd - da * bd) / determinant, (bb * da - bd * ba) / determinant
            lag = -g / scale if scale != 0.0 else math.nan
        else:
            scale, g, lag = ba / bb, 0.0, math.nan
        left = np.abs(second - scale * first - g * slope)
        limit = max(_OUTLYING * MAD_TO_DEVIATION * np.median(left[moves]), 1e-9)
        kept = left <= limit
    return scale, lag, kept


@jit
def agreement(
    first: Points, slope: Points, second: Points, lengths_s: Floats, least: float
) -> tuple[float, float, float, float, float]:
    """Return the values of a `Fit` for some spans.

    Parameters
    ----------
    first, slope, second, lengths_s : ndarray of shape (n,)
        As in `_PairedGains`.
    least : float
        Gain in total that a scale needs.
    """
    scale, lag, kept = fit(first, slope, second)
    if math.isnan(scale):
        return math.nan, math.nan, math.nan, math.nan, math.nan
    delay_s = 0.0 if math.isnan(lag) else lag
    squares = left_over = length_s = gained = 0.0
    direction = 0j
    for i in range(len(first)):
        left = second[i] - scale * (first[i] - delay_s * slope[i])
        squares += abs(left / lengths_s[i]) ** 2
        left_over += left.real
        length_s += lengths_s[i]
        if kept[i]:
            gained += abs(first[i])
            direction += second[i] * first[i].conjugate()
    residual, drift = math.sqrt(squares / len(first)), left_over / length_s
    if gained < least or scale <= 0.0:
        return math.nan, math.nan, residual, drift, math.nan
    # The lag is a first-order approximation, invalid beyond the length of a span.
    lag = lag if abs(lag) < ego.SPAN_S else math.nan
    return math.log(scale), lag, residual, drift, math.atan2(direction.imag, direction.real)


@fp.hookimpl
def register_features() -> list[fp.FeaturePlugin]:
    """Offer the features of sources of motion."""
    return [
        fp.FeaturePlugin(
            "kinematics", "kinematics", FEATURES, compute, ego.MOTION_TOPICS, prepare=prepare
        )
    ]


def _compared(found: ego.MotionSources, pair: Pair) -> Iterator[tuple[str, _PairedGains]]:
    """Yield the gains of each two topics of a pair of kinds, by place."""
    for first in found.tracks[pair.first]:
        if pair.quantity not in first.gained:
            continue
        if pair.second == ego.SCAN:
            seconds: Mapping[str, ego.Motion | Steps] = found.steps
        else:
            seconds = {track.topic: track for track in found.tracks[pair.second]}
        for topic, second in seconds.items():
            if pair.quantity == ego.SPIN and topic != first.topic:  # other joints
                continue
            compared = _comparison(pair, first, second)
            if compared is not None and len(compared.times_s) >= _FEWEST:
                place = topic if first.topic == topic else f"{first.topic} against {topic}"
                yield place, compared


def _comparison(pair: Pair, first: ego.Motion, second: ego.Motion | Steps) -> _PairedGains | None:
    quantity = pair.quantity
    if isinstance(second, Steps):
        from_s, to_s = second.from_s, second.to_s
        turned = np.asarray(second.turned, dtype=np.complex128)
        gained = turned if quantity == ego.TURN else second.travelled
    elif quantity not in second.gained:
        return None
    else:
        # Spans are independent of the start of the recording.
        begin = math.ceil(max(first.stamps_s[0], second.stamps_s[0]) / ego.SPAN_S) * ego.SPAN_S
        end_s = min(first.stamps_s[-1], second.stamps_s[-1])
        from_s, to_s = even_spans(begin, end_s, ego.SPAN_S, first.stamps_s, second.stamps_s)
        gained = ego.gain(second, quantity, from_s, to_s)
    ours = ego.gain(first, quantity, from_s, to_s)
    slopes = ego.slope(first, quantity, from_s, to_s)
    known = np.isfinite(ours) & np.isfinite(gained) & np.isfinite(slopes)
    times_s = np.interp(to_s, first.stamps_s, first.times_s)
    ours, slopes, gained = ours[known], slopes[known], gained[known]
    scale = fit(ours, slopes, gained)[0] if pair.second == ego.JOINTS else 1.0
    unit = 1.0 / abs(scale) if abs(scale) > _NO_SCALE else 1.0
    return _PairedGains(times_s[known], (to_s - from_s)[known], ours, slopes, gained, unit)


def _fitted(pair: Pair, compared: _PairedGains, window: fp.Window) -> Fit:
    """Return the agreement of a pair in a window."""
    part = within(compared.times_s, window)
    first, slopes, second = compared.first[part], compared.first_slope[part], compared.second[part]
    if len(first) < _FEWEST:
        return Fit()
    lengths_s, least = compared.lengths_s[part], _LEAST[pair.quantity]
    found = Fit(*agreement(first, slopes, second, lengths_s, least))
    unit = compared.unit
    return found._replace(residual=found.residual * unit, drift=found.drift * unit)


def _obeyed(fits: Mapping[str, Fit]) -> dict[str, Fit]:
    """Return the commands that the robot may obey: those with about the smallest residual.

    Of a chain of commands, the last one is obeyed. An altered copy explains the same motion with
    another scale, so no single command is chosen.
    """
    residuals = [each.residual for each in fits.values() if not math.isnan(each.residual)]
    limit = max(_OBEYED * min(residuals, default=math.inf), _EXACT)
    return {place: each for place, each in fits.items() if not each.residual > limit}


def _furthest(by_place: Mapping[str, float], reason: str) -> fp.Located | fp.Missing:
    """Return the number that is furthest from 0, and its place."""
    places = {place: value for place, value in by_place.items() if not math.isnan(value)}
    if not places:
        return fp.Missing(reason)
    where = max(places, key=lambda place: abs(places[place]))
    return fp.Located(places[where], where)
