"""Estimates the motion of a robot between two of its laser scans, from the scans alone.

Point-to-line registration of a scan against an earlier one of the same scanner, after Censi's
PL-ICP, with the association along bearings. The turn to begin with comes from sliding one range
profile along the other, so that no odometry is needed and none is believed.
"""

import math
from typing import NamedTuple

import numpy as np

from oracle_pipeline.bags.jit import jit
from oracle_pipeline.features.geometry.planar_pose import PlanarPose
from oracle_pipeline.features.geometry.polar import rays
from oracle_pipeline.features.geometry.scans import (
    Floats,
    Ints,
    Points,
    RecordedScans,
    Scans,
    in_blocks,
)
from oracle_pipeline.features.geometry.transform_tree import SensorMount

_SPACING_S = 0.35  # least time between two matched scans
_LONGEST_S = 1.0  # most time between them

_STEEPEST_RAD = 0.7  # largest turn between two scans
_PROFILE = 60  # approximate number of rays compared to find the turn
_SAMPLE = 180  # approximate number of matched rays
_REACH = 2  # rays on each side of a point's own that may have its counterpart
_SURFACE = 3  # rays on each side of a return, from which its surface's direction is estimated
_ITERATIONS = 12
_SETTLED = 1e-4  # change of the estimate [m, rad] at which it has converged
_WEIGHT_M = 0.03  # distance from the surface at which a point counts half
_RIDGE = 1e-3  # for corridors, along which the motion cannot be determined
_FEWEST = 20  # points that must match a surface
_LEAST_SHARE = 0.3  # of the points, which must match a surface


class Steps(NamedTuple):
    """The motion of the robot's base from a scanner's scans; a row for each pair of scans."""

    from_s: Floats  # stamps of the earlier scan [s]
    to_s: Floats  # and of the later one [s]
    travelled: Points  # along and across the robot [m]; NaN without a match
    turned: Floats  # [rad]


def steps(scans: RecordedScans | Scans, mount: SensorMount) -> Steps:
    """Match each scan with the one at least `_SPACING_S` before it.

    Parameters
    ----------
    scans : RecordedScans or Scans
        Of one topic.
    mount : SensorMount
        Of the scanner on the robot; without a pose there is no plane to match in.
    """
    before, after = _pairs(scans.stamps_s)
    shift, turn = np.full(len(after), np.nan + 0j), np.full(len(after), np.nan)
    if len(after) and mount.pose is not None:
        (found,) = in_blocks(
            len(after),
            scans.rays,
            lambda part: (_matched(scans.rows(before[part]), scans.rows(after[part])),),
        )
        seen = PlanarPose(found[:, 0] + 1j * found[:, 1], np.exp(1j * found[:, 2]))
        moved = mount.pose.compose(seen).compose(mount.pose.inverse())
        turn = np.angle(moved.rotation)
        shift = moved.translation * along_arc(turn)
    return Steps(scans.stamps_s[before], scans.stamps_s[after], shift, turn)


def along_arc(turn: Floats) -> Points:
    """Return the factor from the chord of an arc to the path along it, in the robot's frame."""
    half = turn / 2.0
    with np.errstate(invalid="ignore"):  # of scans that did not match
        way: Points = np.exp(-1j * half) / np.sinc(half / np.pi)
    return way


def _pairs(stamps_s: Floats) -> tuple[Ints, Ints]:
    """Return the indices of scans, and those of the scans that they are matched with."""
    before: list[int] = []
    after: list[int] = []
    last = 0
    for i in range(1, len(stamps_s)):
        passed_s = stamps_s[i] - stamps_s[last]
        if passed_s >= _SPACING_S or passed_s < 0.0:
            if 0.0 <= passed_s <= _LONGEST_S:
                before.append(last)
                after.append(i)
            last = i
    return np.array(before, dtype=np.int64), np.array(after, dtype=np.int64)


def _matched(before: Scans, now: Scans) -> Floats:
    """Return x, y [m] and yaw [rad] of each later scan in its earlier one."""
    same = (before.angle_increment == now.angle_increment) & (now.angle_increment != 0.0)
    return _match_all(
        before.ranges, now.ranges, before.angle_min.ravel(), now.angle_min.ravel(),
        np.where(same, now.angle_increment, np.nan).ravel(),
    )  # fmt: skip


@jit
def _match_all(
    before: Floats, now: Floats, before_start: Floats, now_start: Floats, increment: Floats
) -> Floats:
    moved = np.full((len(now), 3), np.nan)
    rays_before = rays_now = np.empty(0), np.empty(0)
    stride = max(1, now.shape[1] // _SAMPLE)
    for k in range(len(now)):
        if math.isnan(increment[k]):
            continue
        if k == 0 or increment[k] != increment[k - 1] or before_start[k] != before_start[k - 1]:
            rays_before = _directions(before.shape[1], 1, before_start[k], increment[k])
        if k == 0 or increment[k] != increment[k - 1] or now_start[k] != now_start[k - 1]:
            rays_now = _directions(now.shape[1], stride, now_start[k], increment[k])
        surfaces = _surfaces(before[k], *rays_before, increment[k])
        ends = now[k, ::stride] * rays_now[0], now[k, ::stride] * rays_now[1]
        guess = _turn(before[k], now[k], increment[k])
        x, y, yaw = _match(surfaces, ends, before_start[k], increment[k], guess)
        moved[k, 0], moved[k, 1], moved[k, 2] = x, y, yaw
    return moved


@jit
def _directions(rays: int, stride: int, start: float, increment: float) -> tuple[Floats, Floats]:
    """Return the unit vectors along every so many rays of a scan."""
    bearings = start + increment * np.arange(0, rays, stride)
    return np.cos(bearings), np.sin(bearings)


@jit
def _turn(before: Floats, now: Floats, increment: float) -> float:
    """Return the turn by which two range profiles resemble each other most [rad]."""
    n = len(now)
    circle = round(2.0 * math.pi / abs(increment))
    stride, furthest = max(1, n // _PROFILE), int(_STEEPEST_RAD / abs(increment))
    step = max(1, furthest // 40)
    shifts = 2 * furthest // step + 1
    most = (n + stride - 1) // stride
    best, least = 0, math.inf
    for turn in range(shifts):
        # From the middle outwards, as most turns are small: what is worse shows early.
        away = (turn + 1) // 2
        shift = step * (shifts // 2 + (away if turn % 2 else -away)) - furthest
        total, count, limit = 0.0, 0, 1.000001 * least * most
        for j in range(0, n, stride):
            other = j + shift
            if other < 0 or other >= circle:
                other %= circle
            if other < n and math.isfinite(now[j]) and math.isfinite(before[other]):
                total += min(abs(now[j] - before[other]), 0.5)
                count += 1
                if total > limit:
                    break
        else:
            if count * stride > n // 10:
                mean = total / count
                if mean < least or (mean == least and shift < best):
                    best, least = shift, mean
    return best * increment


@jit
def _match(
    surfaces: tuple[Floats, Floats, Floats, Floats],
    ends: tuple[Floats, Floats],
    start: float,
    increment: float,
    guess: float,
) -> tuple[float, float, float]:
    """Return x, y [m] and yaw [rad] of the later scan's sensor in the earlier one's frame.

    Parameters
    ----------
    surfaces : tuple of ndarray, shape (n,) each
        Of the earlier scan, from `_surfaces`.
    ends : tuple of ndarray, shape (m,) each
        Coordinates of some of the later scan's returns [m].
    start, increment : float
        Bearing of the earlier scan's first ray, and from one to the next [rad].
    guess : float
        The turn to begin with [rad].
    """
    nowhere = math.nan, math.nan, math.nan
    (qx, qy, nx, ny), (ends_x, ends_y) = surfaces, ends
    circle = max(1, round(2.0 * math.pi / abs(increment)))
    x, y, yaw = 0.0, 0.0, guess
    own = np.empty(len(ends_x), np.int64)
    for iteration in range(_ITERATIONS):
        gate = 0.3 if iteration < 3 else 0.12
        # The normal equations: a symmetric matrix by its upper half, and the right-hand side.
        xx, xy, xt, yy, yt, tt = _RIDGE, 0.0, 0.0, _RIDGE, 0.0, 0.0
        vx = vy = vt = 0.0
        c, s = math.cos(yaw), math.sin(yaw)
        met, valid = 0, 0
        moved_x, moved_y = c * ends_x - s * ends_y + x, s * ends_x + c * ends_y + y
        rays(moved_x, moved_y, start, increment, own)
        for j in range(len(ends_x)):
            if not math.isfinite(ends_x[j]):
                continue
            valid += 1
            px, py = moved_x[j], moved_y[j]
            nearest, distance = -1, 0.09
            after = own[j] - _REACH
            if not 0 <= after < circle:
                after %= circle
            for _ in range(2 * _REACH + 1):
                ray = after
                after = ray + 1 if ray + 1 < circle else 0
                if ray < len(nx) and not math.isnan(nx[ray]):
                    apart = (px - qx[ray]) ** 2 + (py - qy[ray]) ** 2
                    if apart < distance:
                        nearest, distance = ray, apart
            if nearest < 0:
                continue
            error = nx[nearest] * (px - qx[nearest]) + ny[nearest] * (py - qy[nearest])
            if abs(error) > gate:
                continue
            met += 1
            weight = 1.0 / (1.0 + (error / _WEIGHT_M) ** 2)
            sx, sy = nx[nearest], ny[nearest]
            st = sy * (c * ends_x[j] - s * ends_y[j]) - sx * (s * ends_x[j] + c * ends_y[j])
            wx, wy, wt = weight * sx, weight * sy, weight * st
            vx, vy, vt = vx - wx * error, vy - wy * error, vt - wt * error
            xx, xy, xt = xx + wx * sx, xy + wx * sy, xt + wx * st
            yy, yt, tt = yy + wy * sy, yt + wy * st, tt + wt * st
        if met < _FEWEST or met < _LEAST_SHARE * valid:
            return nowhere
        # By elimination; the ridge keeps the first two pivots above zero.
        fy, ft = xy / xx, xt / xx
        yy, yt, tt = yy - fy * xy, yt - fy * xt, tt - ft * xt
        vy, vt = vy - fy * vx, vt - ft * vx
        ft = yt / yy
        tt, vt = tt - ft * yt, vt - ft * vy
        if tt <= 0.0:
            return nowhere
        turned = vt / tt
        ahead_y = (vy - yt * turned) / yy
        ahead_x = (vx - xy * ahead_y - xt * turned) / xx
        x, y, yaw = x + ahead_x, y + ahead_y, yaw + turned
        if max(abs(ahead_x), abs(ahead_y), abs(turned)) < _SETTLED:
            break
    return x, y, yaw


@jit
def _surfaces(
    ranges: Floats, cosines: Floats, sines: Floats, increment: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return points on the surfaces in a scan, and their normals; NaN where there is none."""
    n = len(ranges)
    x, y = np.full(n, np.nan), np.full(n, np.nan)
    for i in range(n):
        if math.isfinite(ranges[i]):
            x[i] = ranges[i] * cosines[i]
            y[i] = ranges[i] * sines[i]
    qx, qy, nx, ny = x.copy(), y.copy(), np.full(n, np.nan), np.full(n, np.nan)
    for i in range(n):
        if math.isnan(x[i]):
            continue
        near = 0.1 + 2.0 * _SURFACE * abs(increment) * ranges[i]
        sx = sy = sxx = syy = sxy = 0.0
        count = 0
        for k in range(max(0, i - _SURFACE), min(n, i + _SURFACE + 1)):
            if not math.isnan(x[k]) and abs(ranges[k] - ranges[i]) < near:
                dx, dy = x[k] - x[i], y[k] - y[i]
                sx, sy, count = sx + dx, sy + dy, count + 1
                sxx, syy, sxy = sxx + dx * dx, syy + dy * dy, sxy + dx * dy
        if count < _SURFACE + 1:
            continue
        mx, my = sx / count, sy / count
        # The surface's direction is half the angle whose sine and cosine these are, times a size.
        b = 2.0 * (sxy / count - mx * my)
        a = (sxx / count - mx * mx) - (syy / count - my * my)
        size = math.sqrt(a * a + b * b)
        along_x = math.sqrt(0.5 * (1.0 + abs(a) / size)) if size > 0.0 else 1.0
        along_y = 0.5 * abs(b) / (size * along_x) if size > 0.0 else 0.0
        if a < 0.0:
            along_x, along_y = along_y, along_x
        qx[i], qy[i] = x[i] + mx, y[i] + my
        nx[i], ny[i] = -math.copysign(along_y, b), along_x
    return qx, qy, nx, ny
