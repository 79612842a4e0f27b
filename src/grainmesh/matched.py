"""Discs in an image: candidates by a matched filter, then all of them fitted at once.

With Φ the normal distribution, the image around disc i is

    I(x) = b_i + sum_j a_j Φ((r_j - s²/2r_j - |x - c_j|) / s),                                (1)

discs of contrast a, blurred by s, on a ground b that may differ from place to place; s²/2r is by
how much blur draws a curved edge inwards. Centres, radii, contrasts and grounds, and one s, are
found by Gauss-Newton steps, each disc with its neighbours as they stood before: so touching discs
are told apart, and one that the edge of the image cuts is fitted to what can be seen of it. What
the discs do not explain is searched once more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from grainmesh.errors import InputError

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]

ROOT_TAU = sqrt(2.0 * pi)
#: Ratio of the radii tried, and score of the filter from which a disc is tried.
STEP, LIKELY = 1.15, 0.4
#: Gauss-Newton steps of a fit, share of each that is gone, searches, pixels worked on at a time.
STEPS, EASE, SEARCHES, CHUNK = 12, 0.8, 3, 100_000
#: Steps at which the blur is found, and motion [pixel] at which a disc has come to rest.
BLURS, CLOSE = (3, 4, 5), 0.02
#: A score must be beyond chance by so many standard deviations, were the pixels all noise.
SURE = 8.0
#: Discs are dropped whose contrast is below this share of the median, of which less is seen, which
#: overlap a better one by more smaller radii, or whose radius leaves the range by these factors.
FAINT, SEEN, OVERLAP, SLACK = 0.5, 0.25, 0.3, (0.95, 1.05)
#: Half the side of the part of an image that tells bright from dark discs, in largest radii.
TRIAL = 25
#: Discs from which the ground of the whole image can be told.
FEW = 12


@dataclass(frozen=True)
class Discs:
    """Discs of Eq. (1), centres c (n, 2) as row and column from the first pixel's centre."""

    c: Float
    r: Float
    a: Float
    b: Float
    s: float

    def select(self, keep: NDArray[Any]) -> Discs:
        return Discs(self.c[keep], self.r[keep], self.a[keep], self.b[keep], self.s)

    def join(self, other: Discs) -> Discs:
        c, r, a, b = (
            np.concatenate([getattr(self, name), getattr(other, name)]) for name in "crab"
        )
        return Discs(c, r, a, b, self.s)


def is_bright(image: Float, low: float, high: float, least: float) -> bool:
    """Whether bright discs explain more of the middle of an image than dark ones do, or of all."""
    half = ceil(TRIAL * high)
    rows, columns = (slice(max(n // 2 - half, 0), n // 2 + half) for n in image.shape)
    for part in (image[rows, columns], image):
        tries = [search(sign * part, low, high, least, 1)[0] for sign in (1, -1)]
        light, dark = (float((state.a**2 * state.r**2).sum()) for state in tries)
        if light != dark:
            break
    return light >= dark


def search(
    image: Float, low: float, high: float, least: float, searches: int
) -> tuple[Discs, Float]:
    """Bright discs of an image, and their scores.

    Parameters
    ----------
    image : (height, width)
        Grey values, of mean 0.
    low, high : float
        Least and largest radius [pixel].
    least : float
        Discs of a lower score are dropped: the correlation of image and disc, 1 at best.
    searches : int
        How often what is not explained is searched.
    """
    none = np.zeros(0)
    state, score = Discs(np.zeros((0, 2)), none, none, none, 0.15 * low + 0.3), none
    for _ in range(searches):
        new = _candidates(image - drawn(image.shape, state), low, high, state)
        if len(new.r) == 0:
            break
        known = len(state.r)
        state = state.join(new)
        for _ in range(2):  # once more without the wrong ones
            if len(state.r):
                state = _fitted(image, state, low, high)
                score = _scores(image, state)
                kept = _plausible(image, state, score, low, high, least)
                state, score = state.select(kept), score[kept]
                image, state = _levelled(image, state)
        if len(state.r) <= known:
            break
    return state, score


def _levelled(image: Float, state: Discs) -> tuple[Float, Discs]:
    """Image and discs less a quadratic surface through the grounds: its slope would draw discs."""
    if len(state.r) < FEW:
        return image, state
    half = 0.5 * np.array(image.shape)

    def powers(y: Float, x: Float) -> Float:
        y, x = np.broadcast_arrays(y / half[0] - 1.0, x / half[1] - 1.0)
        return np.stack([y**0, y, x, y * y, y * x, x * x], axis=-1)

    weights = np.linalg.lstsq(powers(*state.c.T), state.b, rcond=None)[0]
    rows, columns = (np.arange(n, dtype=float) for n in image.shape)
    ground = powers(rows[:, None], columns) @ weights
    return image - ground, replace(state, b=state.b - powers(*state.c.T) @ weights)


def _plausible(
    image: Float, state: Discs, score: Float, low: float, high: float, least: float
) -> Int:
    """Numbers of the discs that fit, have contrast, can be seen and overlap no better one."""
    chance = SURE / np.sqrt(SURE**2 + np.pi * (state.r + 1.5) ** 2)
    fits = (score >= np.maximum(least, chance)) & (state.a >= FAINT * np.median(state.a))
    fits &= (state.r >= SLACK[0] * low) & (state.r <= SLACK[1] * high)
    fits &= _seen(image, state) >= SEEN
    k = np.flatnonzero(fits)
    return k[_apart(state.c[k], state.r[k], score[k], OVERLAP)]


def _candidates(image: Float, low: float, high: float, known: Discs) -> Discs:
    """Where the image looks like a bright disc that is none of those known."""
    try:
        from skimage.feature import match_template, peak_local_max
    except ImportError:
        raise InputError(
            "finding fibres needs scikit-image: in a clone, pip install -e '.[images]' brings it"
        ) from None
    places, radii, scores = [known.c], [known.r], [np.full(len(known.r), np.inf)]
    count = 1 + ceil(np.log(high / low) / np.log(STEP)) if high > low else 1
    for r in np.geomspace(low, high, count):
        half = ceil(1.25 * r)
        if 2 * half + 1 > min(image.shape):
            continue
        y, x = np.mgrid[-half : half + 1, -half : half + 1]
        disc = 1.0 / (1.0 + np.exp(4.0 * (np.hypot(y, x) - r)))
        likeness = match_template(image, disc, pad_input=True, mode="symmetric")
        peaks = peak_local_max(
            likeness, min_distance=max(1, int(0.5 * r)), threshold_abs=LIKELY, exclude_border=False
        )
        places.append(peaks.astype(float))
        radii.append(np.full(len(peaks), r))
        scores.append(likeness[tuple(peaks.T)])
    c, r, score = np.concatenate(places), np.concatenate(radii), np.concatenate(scores)
    kept = _apart(c, r, score, 0.6)
    new = kept[kept >= len(known.r)]
    zeros = np.zeros(len(new))
    return Discs(c[new], r[new], zeros, zeros, known.s)


def _apart(c: Float, r: Float, score: Float, most: float) -> Int:
    """Numbers of discs that overlap none of higher score by more than `most` smaller radii."""
    from scipy.spatial import cKDTree

    if len(r) == 0:
        return np.zeros(0, np.int64)
    pairs = cKDTree(c).query_pairs(2.0 * r.max(), output_type="ndarray")
    i, j = pairs.T
    overlap = r[i] + r[j] - np.linalg.norm(c[i] - c[j], axis=1)
    i, j = pairs[overlap > most * np.minimum(r[i], r[j])].T
    rank = np.empty(len(r), np.int64)
    rank[np.argsort(-score, kind="stable")] = np.arange(len(r))
    worse, better = np.where(rank[i] > rank[j], (i, j), (j, i))
    keep = np.ones(len(r), bool)
    for k in np.argsort(rank[better], kind="stable"):  # a disc that has gone takes no other along
        if keep[better[k]]:
            keep[worse[k]] = False
    return np.flatnonzero(keep)


def _fitted(image: Float, state: Discs, low: float, high: float) -> Discs:
    """Eq. (1) by Gauss-Newton steps."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(state.c).query_pairs(2.5 * state.r.max(), output_type="ndarray")
    rest = image - drawn(image.shape, state)
    active = np.arange(len(state.r))
    for step in range(STEPS):
        # Contrast and ground first: without a contrast nothing can move.
        free = 2 if step < 2 else 5
        old = state.select(active)
        delta, wide = np.zeros((len(active), free)), np.zeros(2)
        for k, at, patch in _patches(image.shape, old):
            slope = patch.edge(old.s) * old.a[k, None].astype(np.float32)
            columns = (patch.inside, patch.shape, slope * patch.y, slope * patch.x, slope)
            J = np.stack(columns[:free], axis=2)
            e = patch.inside * (rest.ravel()[at] - old.b[k, None])
            A, f = J.transpose(0, 2, 1) @ J, (J * e[:, :, None]).sum(axis=1)
            size = A[:, range(free), range(free)]
            A[:, range(free), range(free)] += 1e-3 * size + 1e-6 * size.sum(axis=1)[:, None] + 1e-9
            delta[k] = np.linalg.solve(A, f[:, :, None])[:, :, 0]
            e -= (J @ delta[k][:, :, None].astype(e.dtype))[:, :, 0]
            deep = slope * patch.depth  # -dI/ds
            wide += -float((deep * e).sum()), float((deep**2).sum())
        c, r, a, b = (getattr(state, name).copy() for name in "crab")
        b[active] += EASE * delta[:, 0]
        a[active] = np.maximum(a[active] + EASE * delta[:, 1], 0.0)
        s, moved = state.s, np.asarray(np.ones(len(active), bool))
        if free > 2:
            most = 0.2 * old.r[:, None]
            move = np.clip(EASE * delta[:, 2:], -most, most)
            c[active] += move[:, :2]
            r[active] = np.clip(r[active] + move[:, 2], 0.8 * low, 1.25 * high)
            moved = np.asarray((np.abs(move) > CLOSE).any(axis=1))
        if step in BLURS:
            s = float(np.clip(s + wide[0] / wide[1], max(0.7 * s, 0.25), min(1.4 * s, 0.5 * low)))
        state = Discs(c, r, a, b, s)
        if s != old.s:
            rest = image - drawn(image.shape, state)
        else:
            rest += drawn(image.shape, old) - drawn(image.shape, state.select(active))
        if step <= BLURS[-1]:
            continue
        if not moved.any():
            break
        near = np.zeros(len(r), bool)  # those that have moved, and their neighbours
        near[active[moved]] = True
        first, second = near[pairs.T]
        near[pairs[first, 1]] = near[pairs[second, 0]] = True
        active = np.flatnonzero(near)
    return state


def _scores(image: Float, state: Discs) -> Float:
    """Correlation of the image, less its other discs, with each disc."""
    rest, score = image - drawn(image.shape, state), np.zeros(len(state.r))
    for k, at, patch in _patches(image.shape, state):
        w = patch.inside / np.maximum(patch.inside.sum(axis=1, keepdims=True), 1.0)
        own = rest.ravel()[at] + state.a[k, None] * patch.shape
        own = own - (w * own).sum(axis=1, keepdims=True)
        shape = patch.shape - (w * patch.shape).sum(axis=1, keepdims=True)
        both = (w * own * shape).sum(axis=1)
        score[k] = both / np.sqrt((w * own**2).sum(axis=1) * (w * shape**2).sum(axis=1) + 1e-12)
    return score


def _seen(image: Float, state: Discs) -> Float:
    """Share of each disc that lies in the image."""
    share = np.zeros(len(state.r))
    for k, _, patch in _patches(image.shape, state):
        share[k] = patch.shape.sum(axis=1) / (np.pi * state.r[k] ** 2)
    return share


@dataclass(frozen=True)
class _Patch:
    """Pixels (m, p) around m discs."""

    inside: Single  # 1 near the disc and in the image, else 0
    shape: Single  # Φ there, else 0
    depth: Single  # its argument
    y: Single  # away from the centre, of length 1
    x: Single

    def edge(self, s: float) -> Single:
        """dΦ/dr."""
        edge: Single = self.inside * np.exp(-0.5 * self.depth**2) / np.float32(ROOT_TAU * s)
        return edge


def _patches(size: tuple[int, ...], state: Discs) -> Iterator[tuple[Int, Int, _Patch]]:
    """Numbers of discs, the pixels around them, and Eq. (1) there; some discs at a time."""
    from scipy.special import ndtr

    order = np.argsort(state.r, kind="stable")
    margin = max(1.5, 2.0 * state.s)
    while len(order):
        # As many of the largest as fit: their patches are about equally large.
        half = ceil(state.r[order[-1]] + margin)
        many = max(1, CHUNK // (2 * half + 1) ** 2)
        k, order = order[-many:], order[:-many]
        around = np.arange(-half, half + 1)
        row, column = (np.rint(state.c[k, i]).astype(np.int64)[:, None] + around for i in (0, 1))
        y = (row - state.c[k, 0, None]).astype(np.float32)[:, :, None]
        x = (column - state.c[k, 1, None]).astype(np.float32)[:, None, :]
        distance = np.sqrt(y**2 + x**2) + np.float32(1e-9)
        reach = (state.r[k] + margin)[:, None, None]
        seen = (distance < reach) & ((row >= 0) & (row < size[0]))[:, :, None]
        seen &= ((column >= 0) & (column < size[1]))[:, None, :]
        at = np.clip(row, 0, size[0] - 1)[:, :, None] * size[1]
        at = at + np.clip(column, 0, size[1] - 1)[:, None, :]
        front = (state.r[k] - 0.5 * state.s**2 / state.r[k])[:, None, None].astype(np.float32)
        depth = (front - distance) / np.float32(state.s)
        flat = (len(k), -1)
        inside = seen.astype(np.float32)
        parts = (inside, inside * ndtr(depth), depth, y / distance, x / distance)
        yield k, at.reshape(flat), _Patch(*(part.reshape(flat) for part in parts))


def drawn(size: tuple[int, ...], state: Discs) -> Float:
    """The sum over discs in Eq. (1)."""
    total = np.zeros(size[0] * size[1])
    for k, at, patch in _patches(size, state):
        np.add.at(total, at.ravel(), (state.a[k, None] * patch.shape).ravel().astype(float))
    return total.reshape(size)


__all__ = ["SEARCHES", "Discs", "drawn", "is_bright", "search"]
