"""Where the discs are: lattices, random arrays, and lists of centres from a file.

Lattices are given by porosity ε and diameter d; the box is a whole number of unit cells, so the
solid fraction of the tile is exact,

    (1 - ε) A₁ = π d²/4                                                                         (1)

with A₁ the area of one disc's share: a² for the square lattice of pitch a; for staggered rows of
pitch a, shifted by a/2, with the angle θ between a bond to the next row and the x axis,

    A₁ = a h,   h = (a/2) tan θ                                                                 (2)

(θ = 60°: hexagonal, 45°: a square lattice turned by 45°). The nearest neighbours are at the
smallest of a (same row), a/(2 cos θ) (next row) and 2h (next row but one).
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from math import cos, isfinite, pi, radians, sqrt, tan
from operator import index
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from grainmesh.domain import Box
from grainmesh.errors import InputError
from grainmesh.packing import pack
from grainmesh.particles import Particles, close_pairs, touches

#: Largest solid fraction, of discs with their share of the gap, asked of the random generator.
REACH = 0.80

#: Column names that give the size of a disc, and the factor that makes it a diameter.
SIZES = {"d": 1.0, "diameter": 1.0, "r": 2.0, "radius": 2.0}

Float = NDArray[np.float64]


def square(
    nx: int, ny: int, *, porosity: float, diameter: float, periodic: bool = True
) -> tuple[Box, Particles]:
    """Square lattice, half a pitch away from the edges.

    Parameters
    ----------
    nx, ny : int
        Discs along x and y.
    porosity : float
        Area fraction outside the discs, at least 1 - π/4 = 0.2146 (discs touch).
    diameter : float
        Diameter [m].
    periodic : bool
        Periodic box, else a box with walls.

    Returns
    -------
    box : Box
        The exact tile, Eq. (1).
    particles : Particles
        nx ny discs, row by row from the bottom.

    Raises
    ------
    InputError
        Porosity below the touching limit, or an argument that is not a positive number.
    """
    nx, ny, d = _count("nx", nx), _count("ny", ny), _positive("diameter", diameter)
    _solid(porosity, limit=pi / 4)
    a = d * sqrt(pi / 4 / (1 - porosity))  # Eq. (1)
    i, j = np.meshgrid(np.arange(nx), np.arange(ny))
    x = np.stack([(i + 0.5) * a, (j + 0.5) * a], axis=-1).reshape(-1, 2)
    return Box(nx * a, ny * a, periodic), Particles(x, d)


def hexagonal(
    nx: int, ny: int, *, porosity: float, diameter: float, periodic: bool = True
) -> tuple[Box, Particles]:
    """Hexagonal lattice with rows along x: `staggered` by 60 degrees, porosity at least 0.0931."""
    return staggered(nx, ny, angle=60, porosity=porosity, diameter=diameter, periodic=periodic)


def staggered(
    nx: int, ny: int, *, angle: float, porosity: float, diameter: float, periodic: bool = True
) -> tuple[Box, Particles]:
    """Rows along x, every other one shifted by half a pitch.

    Parameters
    ----------
    nx, ny : int
        Discs in a row, and rows.
    angle : float
        Angle between a bond to the next row and the x axis [degrees], between 0 and 90.
    porosity : float
        Area fraction outside the discs of the tile.
    diameter : float
        Diameter [m].
    periodic : bool
        Periodic box (`ny` must be even), else a box with walls.

    Returns
    -------
    box : Box
        The exact tile, Eqs. (1) and (2).
    particles : Particles
        Row by row from the bottom. Periodic: nx ny discs, rows start at a quarter and at three
        quarters of the pitch. With walls: rows of nx discs, from half a pitch on, and of nx + 1,
        whose first and last are halved by the walls, so that these are planes of symmetry.

    Raises
    ------
    InputError
        Porosity below the touching limit, an odd number of rows in a periodic box, or an argument
        out of its range.
    """
    nx, ny, d = _count("nx", nx), _count("ny", ny), _positive("diameter", diameter)
    if not 0 < angle < 90:
        raise InputError(f"angle {angle:g} must lie between 0 and 90 degrees")
    if periodic and ny % 2:
        raise InputError(f"{ny} staggered rows are not periodic: take an even ny")
    t = tan(radians(angle))
    nearest = min(1.0, 0.5 / cos(radians(angle)), t)
    _solid(porosity, limit=pi / 4 * nearest**2 / (0.5 * t))
    a = d * sqrt(pi / 4 / (1 - porosity) / (0.5 * t))  # Eqs. (1), (2)
    h = 0.5 * a * t  # Eq. (2)
    i, j = np.meshgrid(np.arange(nx + 1), np.arange(ny))
    along = i + 0.25 + 0.5 * (j % 2) if periodic else i + 0.5 - 0.5 * (j % 2)
    x = np.stack([along * a, (j + 0.5) * h], axis=-1)
    here = (i < nx) if periodic else (i < nx) | (j % 2 == 1)
    return Box(nx * a, ny * h, periodic), Particles(x[here], d)


def random(
    n: int,
    *,
    porosity: float,
    diameter: ArrayLike,
    min_gap: float = 0.0,
    seed: int = 0,
    periodic: bool = True,
    aspect: float = 1.0,
) -> tuple[Box, Particles]:
    """Equilibrated hard discs at random, see `grainmesh.packing`.

    Up to a solid fraction of 0.70, discs with their gap, the result is a fluid that has forgotten
    how it was made. Denser discs freeze: many of them end as crystal grains, which would go on
    growing with more sweeps.

    Parameters
    ----------
    n : int
        Number of discs.
    porosity : float
        Area fraction outside the discs.
    diameter : array_like, shape () or (n,)
        Diameters [m].
    min_gap : float
        Least distance of two surfaces over the mean diameter. Walls are kept at half of it, as if
        they were planes of symmetry.
    seed : int
        The same seed gives the same discs.
    periodic : bool
        Periodic box, else the discs lie wholly inside a box with walls.
    aspect : float
        Width of the box over its height.

    Returns
    -------
    box : Box
    particles : Particles

    Raises
    ------
    InputError
        An argument out of its range, or a porosity out of reach for the generator.
    """
    n, aspect = _count("n", n), _positive("aspect", aspect)
    d = Particles(np.zeros((n, 2)), diameter).diameter
    if not (isfinite(min_gap) and min_gap >= 0):
        raise InputError(f"min_gap {min_gap:g} must not be negative")
    solid = _solid(porosity)
    # In a unit that makes equal discs exactly 1, whatever their diameter.
    unit = float(d.max())
    scaled = d / unit
    gap = min_gap * float(scaled.mean())
    # Each disc carries half of the gap; a trace more keeps round-off out of the promise.
    radius = 0.5 * (scaled + gap) * (1 + 1e-10)
    size = sqrt((pi / 4 * scaled**2).sum() / solid) * np.array([aspect**0.5, aspect**-0.5])
    full = pi * (radius**2).sum() / size.prod()
    fault = ""
    if full > REACH:
        fault = f"at most {REACH:g} is possible"
    elif 2 * radius.max() > size.min():
        fault = "the largest disc does not fit into the box"
    else:
        x, reached = pack(radius, size, periodic, np.random.default_rng(seed))
        if (reached < radius).any():
            fault = f"discs jam at {pi * (reached**2).sum() / size.prod():.4g} in this box"
    if fault:
        raise InputError(
            f"porosity {porosity:g} is out of reach for the generator: the solid fraction of {n} "
            f"discs with min_gap {min_gap:g} is {full:.4g}, {fault}; raise porosity, reduce min_gap"
        )
    width, height = size * unit
    box, particles = Box(width, height, periodic), Particles(x * unit, d)
    near = close_pairs(box, particles, gap * unit)
    edge = np.minimum(particles.x, box.size - particles.x).min(axis=1)
    if len(near) or not (periodic or (edge >= 0.5 * (d + gap * unit)).all()):
        raise RuntimeError("the random generator broke its promise of a minimum gap: report this")
    return box, particles


def loose(
    box: Box,
    n: int,
    *,
    diameter: ArrayLike,
    density: float = 2500.0,
    gap: float = 0.1,
    seed: int = 0,
) -> Particles:
    """Discs on a loose square lattice in a box with walls, row upon row from its floor, to fall.

    Parameters
    ----------
    box : Box
    n : int
        Number of discs.
    diameter : float, (float, float) or array_like (n,)
        Diameter [m]: of all, bounds of a uniform distribution, or of each.
    density : float
        [kg/m3].
    gap : float
        Mean gap between discs, in largest diameters; each disc is moved at random by less than
        half of it.
    seed : int
        Of the random numbers.

    Returns
    -------
    Particles

    Raises
    ------
    InputError
        If the discs do not fit into the box, or a value is not positive.
    """
    n = _count("n", n)
    if box.periodic:
        raise InputError("loose discs need a box with walls, use arrange.random for a periodic one")
    rng = np.random.default_rng(seed)
    d = np.asarray(diameter, dtype=float)
    if d.shape == (2,) and n != 2 and np.isfinite(d).all():
        if d[0] > d[1]:
            raise InputError(
                f"diameter {d[0]:g} to {d[1]:g} m: the first must not be above the second"
            )
        d = rng.uniform(d[0], d[1], n)
    d = Particles(np.zeros((n, 2)), d).diameter  # checks shape and sign
    largest, gap = float(d.max()), _positive("gap", gap)
    pitch = (1.0 + gap) * largest
    columns = int(box.width / pitch)
    if columns == 0 or -(-n // columns) * pitch > box.height:
        room = columns * int(box.height / pitch)
        raise InputError(
            f"{n} discs of up to {largest:g} m do not fit loosely into the box {box.width:g} m x "
            f"{box.height:g} m, which has room for {room}: enlarge it or reduce n, diameter or gap"
        )
    row, column = np.divmod(np.arange(n), columns)
    x = np.stack([(column + 0.5) * box.width / columns, (row + 0.5) * pitch], axis=1)
    return Particles(x + rng.uniform(-0.49, 0.49, (n, 2)) * gap * largest, d, density)


def from_csv(
    path: str | PathLike[str],
    *,
    unit: float = 1.0,
    diameter: float | None = None,
    width: float | None = None,
    height: float | None = None,
    window: tuple[float, float, float, float] | None = None,
    periodic: bool = False,
    crop: bool = False,
) -> tuple[Box, Particles]:
    """Discs listed in a text file, one a row.

    The first line that is not blank and not a ``#`` comment names the columns: ``x``, ``y`` and
    one of ``d``, ``diameter``, ``r``, ``radius``, in any case and order; others are ignored. They
    are separated by commas, semicolons, tabs or blanks. UTF-8.

    Parameters
    ----------
    path : path-like
        The file.
    unit : float
        Metres per unit of the file, for all its columns.
    diameter : float, optional
        One diameter [m] for all discs, in place of the column.
    width, height : float, optional
        Box [0, width] x [0, height] [m]; by default the bounding box of the discs, which are
        shifted to its corner.
    window : (x0, y0, x1, y1), optional
        Cut this rectangle [m] out: it becomes the box, (x0, y0) the origin, and `crop` is implied.
    periodic : bool
        Periodic box; needs `width` and `height`, or `window`.
    crop : bool
        Drop discs wholly outside the box; of a periodic box, discs whose centre is outside.

    Returns
    -------
    box : Box
    particles : Particles
        In the order of the file.

    Raises
    ------
    InputError
        With file and row (line number) where there is one.
    """
    unit = _positive("unit", unit)
    if (width is None) != (height is None):
        raise InputError("a box needs both width and height: give both, or none")
    if window is not None:
        if width is not None:
            raise InputError("window and width, height exclude each other: give one of them")
        if not (np.isfinite(window).all() and window[2] > window[0] and window[3] > window[1]):
            raise InputError(f"window {window} must be x0, y0, x1, y1 with x1 > x0 and y1 > y0")
        width, height = window[2] - window[0], window[3] - window[1]
    if periodic and width is None:
        raise InputError("a periodic box needs width and height: a bounding box is not a period")
    if diameter is not None:
        diameter = _positive("diameter", diameter)
    x, d = _read(path, unit, diameter)
    if window is not None:
        x = x - np.array(window[:2])
    if width is None or height is None:
        low, high = (x - 0.5 * d[:, None]).min(axis=0), (x + 0.5 * d[:, None]).max(axis=0)
        return Box(*(high - low)), Particles(x - low, d)
    box, particles = Box(width, height, periodic), Particles(x, d)
    if crop or window is not None:
        within = (x >= 0) & (x < box.size)
        keep = within[:, 0] & within[:, 1] if periodic else touches(box, particles)
        if not keep.any():
            raise InputError(f"{path}: no disc lies in the box; check unit, width, height, window")
        particles = particles.select(keep)
    return box, particles


def _read(path: str | PathLike[str], unit: float, diameter: float | None) -> tuple[Float, Float]:
    """Centres (n, 2) and diameters (n,) in metres."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            lines = file.read().split("\n")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    used = [line for line in lines if (s := line.strip()) and s[0] != "#"]
    if not used:
        raise InputError(f"{path}: empty file; it needs a header x, y, d and one row a disc")

    def row(k: int) -> str:
        """File and line number of data row `k`, counted only once something is wrong."""
        at = [i for i, line in enumerate(lines, 1) if (s := line.strip()) and s[0] != "#"]
        return f"{path}, row {at[k + 1]}"

    header, rows = used[0].split("#")[0], used[1:]
    delimiter = next((c for c in ",;\t" if c in header), None)
    fields = next(csv.reader([header], delimiter=delimiter)) if delimiter else header.split()
    names = [name.strip(' \t"').lower() for name in fields]
    sizes = [name for name in names if name in SIZES and diameter is None]
    wanted = ["x", "y", *sizes]
    if all(_is_number(name) for name in names):
        raise InputError(f"{path}: no header; the first row must name the columns, as x, y, d")
    missing = [name for name in "xy" if name not in names]
    if not sizes and diameter is None:
        missing.append("d or r")
    if missing:
        raise InputError(
            f"{path}: column {' and '.join(missing)} missing among: {', '.join(names)}; rename the "
            "columns to x, y and d or r" + (", or give a diameter" if "d or r" in missing else "")
        )
    for name in wanted:
        if names.count(name) > 1:
            raise InputError(f"{path}: {names.count(name)} columns named {name}; keep one")
    if not rows:
        raise InputError(f"{path}: no row after the header; it needs one row a disc")

    columns = [names.index(name) for name in wanted]

    def parse(some: list[str]) -> Float:
        return np.loadtxt(
            some, delimiter=delimiter, usecols=columns, comments="#", quotechar='"', ndmin=2
        )

    try:
        values = parse(rows)
    except ValueError:
        k = _first_bad(rows, parse)
        text = rows[k].strip()[:60]
        raise InputError(f"{row(k)}: no numbers for {', '.join(wanted)} in '{text}'") from None
    if len(values) != len(rows):
        raise InputError(f"{path}: a quoted text runs over several lines; put each row on one line")

    with np.errstate(over="ignore"):
        values = values * unit
    _every(np.isfinite(values), row, "a value is not finite")
    x, d = values[:, :2], np.full(len(values), diameter or 0.0)
    if sizes:
        given = values[:, 2:] * [SIZES[name] for name in sizes]
        d = given[:, 0]
        _every(given > 0, row, f"{' or '.join(sizes)} must be positive")
        same = np.isclose(given, given[:, :1], rtol=1e-6, atol=0)
        _every(same, row, f"{' and '.join(sizes)} disagree; keep one of these columns")
    return x, d


def _every(good: NDArray[np.bool_], row: Callable[[int], str], fault: str) -> None:
    """Refuse the first row of `good`, shape (n, m), that does not hold in all columns."""
    if not good.all():
        raise InputError(f"{row(int(np.nonzero(~good)[0][0]))}: {fault}")


def _first_bad(rows: list[str], parse: Callable[[list[str]], Float]) -> int:
    """The first row that `parse` refuses, by bisection: reads the rows about twice."""
    low, high = 0, len(rows)
    while high - low > 1:
        middle = (low + high) // 2
        try:
            parse(rows[low:middle])
            low = middle
        except ValueError:
            high = middle
    return low


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _count(name: str, value: int) -> int:
    try:
        value = index(value)
    except TypeError:
        raise InputError(f"{name} {value!r} must be a whole number") from None
    if value < 1:
        raise InputError(f"{name} {value} must be at least 1")
    return value


def _positive(name: str, value: float) -> float:
    if not (isfinite(value) and value > 0):
        raise InputError(f"{name} {value:g} must be a positive number")
    return float(value)


def _solid(porosity: float, limit: float = 1.0) -> float:
    """The solid fraction, if it is possible; `limit`: that of touching discs."""
    if not 0 < porosity < 1:
        raise InputError(f"porosity {porosity:g} must lie between 0 and 1")
    if 1 - porosity > limit + 1e-12:
        raise InputError(
            f"porosity {porosity:g} is below {1 - limit:.4f}, where the discs of this lattice "
            "touch: raise it"
        )
    return 1 - porosity


__all__ = ["from_csv", "hexagonal", "loose", "random", "square", "staggered"]
