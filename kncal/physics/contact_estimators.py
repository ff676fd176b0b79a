"""The estimators of one contact from frames: start and end between frames, maximum and mean of the overlap.

A contact is the time during which the overlap is positive. It starts and ends on the ballistic path of the free
frame beside it, not at a multiple of the time step; within it the overlap is the cubic Hermite interpolant of overlap
and rate (fourth order).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kncal.core.checks import Array
from kncal.core.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ContactMeasure:
    """One contact as measured from frames; every field is a float array of the batch's shape (or 0-d).

    Attributes
    ----------
    t_start : first touch [s] (first frame if the contact was there already)
    t_c : duration [s] (up to the last frame if the contact does not end)
    delta_max, delta_mean : maximum and time mean of the overlap [m]
    v_in, v_out : closing speed at the start, leaving speed at the end [m/s]; v_out is NaN without an end
    started, ended : whether the start and the end lie within the frames
    """

    t_start: Array
    t_c: Array
    delta_max: Array
    delta_mean: Array
    v_in: Array
    v_out: Array
    started: NDArray[np.bool_]
    ended: NDArray[np.bool_]


def measure_contact(
    t: ArrayLike,
    delta: ArrayLike,
    delta_dot: ArrayLike,
    *,
    pull_in: ArrayLike = 0.0,
    pull_out: ArrayLike = 0.0,
) -> ContactMeasure:
    """Measure the first contact in a series of frames; batches stand side by side.

    Parameters
    ----------
    t : (..., frames) increasing times [s]; broadcast against ``delta``
    delta, delta_dot : (..., frames) overlap (negative: a gap) and its rate [m], [m/s]
    pull_in, pull_out : (...) second derivative of the overlap in free flight, at the frame before and the
        frame after the contact [m/s²]: gravity towards the wall is positive

    Raises
    ------
    InputError
        If one of the series has no frame in contact, or fewer than two frames.
    """
    given = np.broadcast_arrays(np.asarray(t, dtype=np.float64), delta, delta_dot)
    if given[0].ndim == 0 or given[0].shape[-1] < 2:
        raise InputError("delta: expected a series of at least two frames")
    *batch, frames = given[0].shape
    t, delta, rate = (np.array(a, dtype=np.float64).reshape(-1, frames) for a in given)
    inside = delta > 0.0
    if not inside.any(axis=-1).all():
        raise InputError("delta: expected a frame in contact (delta > 0) in every series")
    index = np.arange(delta.shape[-1])
    first = np.argmax(inside, axis=-1)
    after = ~inside & (index > first[..., None])
    started, ended = first > 0, after.any(axis=-1)
    before, end = np.maximum(first - 1, 0), np.where(ended, np.argmax(after, axis=-1), index[-1])

    gap, speed, t_0 = -_at(delta, before), _at(rate, before), _at(t, before)
    pull = np.broadcast_to(np.asarray(pull_in, dtype=np.float64), batch).ravel()
    lapse = _fall(np.maximum(gap, 0.0), speed, pull, _at(t, before + started) - t_0)
    t_start = np.where(started, t_0 + lapse, t_0)
    v_in = np.where(started, speed + pull * lapse, speed) + 0.0  # no -0.0

    gap, speed, t_1 = -_at(delta, end), -_at(rate, end), _at(t, end)
    pull = np.broadcast_to(np.asarray(pull_out, dtype=np.float64), batch).ravel()
    lapse = _fall(np.maximum(gap, 0.0), speed, pull, t_1 - _at(t, end - ended))
    t_end = np.where(ended, t_1 - lapse, t_1)
    v_out = np.where(ended, speed + pull * lapse, np.nan)

    _put(t, before, started, t_start)
    _put(delta, before, started, np.zeros_like(t_start))
    _put(rate, before, started, v_in)
    _put(t, end, ended, t_end)
    _put(delta, end, ended, np.zeros_like(t_end))
    _put(rate, end, ended, -v_out)
    used = (index[:-1] >= before[..., None]) & (index[:-1] < end[..., None])
    area, peak = _hermite(t, delta, rate)
    t_c = t_end - t_start
    nodes = np.where((index >= before[..., None]) & (index <= end[..., None]), delta, -np.inf).max(axis=-1)
    total = np.where(used, area, 0.0).sum(axis=-1)
    # a contact seen in one frame only has no duration yet
    mean = np.divide(total, t_c, out=_at(delta, end), where=t_c > 0.0)
    return ContactMeasure(
        t_start=t_start.reshape(batch),
        t_c=t_c.reshape(batch),
        delta_max=np.maximum(nodes, np.where(used, peak, -np.inf).max(axis=-1)).reshape(batch),
        delta_mean=mean.reshape(batch),
        v_in=v_in.reshape(batch),
        v_out=v_out.reshape(batch),
        started=started.reshape(batch),
        ended=ended.reshape(batch),
    )


def _at(values: Array, index: NDArray[np.int64]) -> Array:
    picked: Array = np.take_along_axis(values, index[..., None], axis=-1)[..., 0]
    return picked


def _put(values: Array, index: NDArray[np.int64], where: NDArray[np.bool_], new: Array) -> None:
    kept = _at(values, index)
    np.put_along_axis(values, index[..., None], np.where(where, new, kept)[..., None], axis=-1)


def _fall(gap: Array, speed: Array, pull: Array, longest: Array) -> Array:
    """Time to cover ``gap`` from ``speed`` under ``pull``; at most ``longest``, the frames bracket the touch."""
    sink = speed + np.sqrt(np.maximum(speed**2 + 2.0 * pull * gap, 0.0))
    time = np.divide(2.0 * gap, sink, out=longest.copy(), where=sink > 0.0)
    return np.minimum(time, longest)


def _hermite(t: Array, x: Array, v: Array) -> tuple[Array, Array]:
    """Integral and inner maximum (-inf without one) of the cubic Hermite interpolant on every interval."""
    h = np.diff(t, axis=-1)
    x_0, x_1, m_0, m_1 = x[..., :-1], x[..., 1:], h * v[..., :-1], h * v[..., 1:]
    area = h * (0.5 * (x_0 + x_1) + (m_0 - m_1) / 12.0)
    # the slope m_0 + b u + a u² falls through zero at u
    rise = x_1 - x_0
    a, b = 3.0 * (m_0 + m_1 - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * m_0 - m_1)
    turns = (m_0 > 0.0) & (m_1 <= 0.0)
    u = np.divide(2.0 * m_0, np.sqrt(np.maximum(b * b - 4.0 * a * m_0, 0.0)) - b, out=np.zeros_like(h), where=turns)
    return area, np.where(turns, x_0 + u * (m_0 + u * (0.5 * b + u * a / 3.0)), -np.inf)
