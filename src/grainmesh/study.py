"""Many runs as one table.

>>> def sample(porosity, seed):
...     box, discs = gm.arrange.random(100, porosity=porosity, diameter=7e-6, seed=seed)
...     return gm.permeability(box, discs, "microstructure")
>>> table = gm.sweep(sample, porosity=[0.5, 0.6, 0.7], seed=range(5))
>>> table.normalised.mean("seed")
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from grainmesh.errors import InputError

if TYPE_CHECKING:
    import xarray

#: Unit and meaning of the numbers of a `Permeability`; those of other results have none here.
MEANING = {
    "porosity": ("1", "fluid share of the box"),
    "n": ("1", "number of discs"),
    "diameter": ("m", "mean diameter d"),
    "gap": ("1", "mean gap γ over d"),
    "normalised": ("1", "tr K / 2d²"),
    "Kxx": ("m2", "permeability, xx"),
    "Kxy": ("m2", "permeability, xy"),
    "Kyx": ("m2", "permeability, yx"),
    "Kyy": ("m2", "permeability, yy"),
    "dofs": ("1", "unknowns"),
    "seconds": ("s", "wall time"),
    "error": ("1", "estimated relative error"),
}


def sweep(run: Callable[..., Any], **axes: Iterable[Any]) -> xarray.Dataset:
    """Call a function with every combination of values, and gather the numbers it returns.

    Parameters
    ----------
    run : callable
        Takes one value of each axis by name; returns a result with `to_dict`, or a mapping. What
        in it are numbers is kept, and of a permeability the four entries of the tensor.
    **axes : iterables
        Values of each parameter, which become the dimensions.

    Returns
    -------
    xarray.Dataset
        One variable for each number, with ``units`` and ``long_name`` where they are known. A
        result named like an axis is left out, as it would hide the axis.

    Raises
    ------
    InputError
        If there are no values; or that of `run`, with the point it arose at.
    """
    import xarray

    values = {name: list(some) for name, some in axes.items()}
    for name, some in values.items():
        if not some:
            raise InputError(f"sweep: no values of {name}")
    if not values:
        raise InputError("sweep: name at least one parameter, as porosity=[0.5, 0.6]")
    rows = []
    for point in product(*values.values()):
        given = dict(zip(values, point, strict=True))
        try:
            rows.append(_numbers(run(**given)))
        except InputError as fault:
            where = ", ".join(f"{name}={value}" for name, value in given.items())
            raise InputError(f"sweep at {where}: {fault}") from None
    shape = tuple(len(some) for some in values.values())
    names = dict.fromkeys(name for row in rows for name in row if name not in values)
    found = {}
    for name in names:
        column = np.array([row.get(name, np.nan) for row in rows]).reshape(shape)
        unit, meaning = MEANING.get(name, ("", ""))
        about = {"units": unit, "long_name": meaning} if unit else {}
        found[name] = (tuple(values), column, about)
    return xarray.Dataset(found, coords=values)


def _numbers(result: Any) -> dict[str, float]:
    """The numbers of a result, nan where there is none."""
    table: Mapping[str, Any] = result if isinstance(result, Mapping) else result.to_dict()
    found: dict[str, float] = {}
    for name, value in table.items():
        if value is None:
            found[name] = np.nan
        elif isinstance(value, Real) and not isinstance(value, bool):
            found[name] = float(value)
        elif name == "tensor":
            entries = np.array(value, dtype=float).ravel().tolist()
            found |= dict(zip(("Kxx", "Kxy", "Kyx", "Kyy"), entries, strict=True))
    return found


__all__ = ["sweep"]
