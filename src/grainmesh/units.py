"""Quantities as text: "2 mm", "1.2 g/cm3", "1 cP", as numbers in SI units.

A unit is a product of powers: ``kg/m3``, ``mPa s``, ``N/m2``, ``m s^-1``. Every factor is a name
of `NAMES`, or one of `PREFIXES` and a name; what follows the first slash divides.
"""

from __future__ import annotations

import re
from decimal import Decimal
from math import isfinite, pi

from grainmesh.errors import InputError

#: Value in SI units, and powers of kg, m and s. Decimal, so that "20 um" is 20e-6 to the last bit.
Unit = tuple[Decimal, tuple[int, int, int]]

NAMES: dict[str, Unit] = {
    "m": (Decimal("1.0"), (0, 1, 0)),
    "g": (Decimal("1e-3"), (1, 0, 0)),
    "s": (Decimal("1.0"), (0, 0, 1)),
    "N": (Decimal("1.0"), (1, 1, -2)),
    "Pa": (Decimal("1.0"), (1, -1, -2)),
    "bar": (Decimal("1e5"), (1, -1, -2)),
    "P": (Decimal("0.1"), (1, -1, -1)),
    "L": (Decimal("1e-3"), (0, 3, 0)),
    "t": (Decimal("1e3"), (1, 0, 0)),
    "Hz": (Decimal("1.0"), (0, 0, -1)),
}
#: Names that take no prefix.
ALONE: dict[str, Unit] = {
    "1": (Decimal("1.0"), (0, 0, 0)),
    "%": (Decimal("0.01"), (0, 0, 0)),
    "min": (Decimal("60.0"), (0, 0, 1)),
    "h": (Decimal("3600.0"), (0, 0, 1)),
    "in": (Decimal("0.0254"), (0, 1, 0)),
    "rad": (Decimal("1.0"), (0, 0, 0)),
    "rpm": (Decimal(2.0 * pi / 60.0), (0, 0, -1)),
}
PREFIXES = {
    name: Decimal(value)
    for names, value in (("n", "1e-9"), ("uµμ", "1e-6"), ("m", "1e-3"), ("c", "1e-2"),
                         ("k", "1e3"), ("M", "1e6"))
    for name in names
}  # fmt: skip

QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.{0,60}?)\s*", re.A)
FACTOR = re.compile(r"(1|%|[A-Za-zµμ]+)(?:(?:\^|\*\*)?([+-]?\d))?")
#: No quantity of a case is as large in SI units, nor as small as one over it.
EXTREME = 1e30
#: What a user may write for a unit of ours.
EXAMPLES = {
    "m": '"2 mm"',
    "s": '"20 ms"',
    "m/s": '"5 cm/s"',
    "m/s2": '"9.81 m/s2"',
    "1/s": '"10 rpm"',
    "kg/m3": '"1.2 g/cm3"',
    "Pa s": '"1 cP"',
    "Pa": '"2 kPa"',
    "Pa/m": '"5 Pa/m"',
    "N/m2": '"2e4 N/m2"',
    "1": "0.3",
}


def si(value: object, unit: str) -> float:
    """A quantity in an SI unit.

    Parameters
    ----------
    value : float, int or str
        A number is in this unit already; text is a number with a unit of the same kind.
    unit : str
        "kg/m3", say; "1" for pure numbers.

    Returns
    -------
    float

    Raises
    ------
    InputError
        No number, an unknown unit, or one of another kind.
    """
    wanted = f"a {'number' if unit == '1' else f'number [{unit}]'} or text as {EXAMPLES[unit]}"
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            found = float(value)
        except OverflowError:
            found = float("inf")
    elif isinstance(value, str):
        match = QUANTITY.fullmatch(value)
        if match is None:
            raise InputError(f"{shown(value)} is no quantity: expected {wanted}")
        number, text = match.groups()
        if not text and unit != "1":
            raise InputError(f"{shown(value)} has no unit: expected {wanted}")
        scale, kind = parsed(text or "1", wanted)
        if kind != parsed(unit, "")[1]:
            raise InputError(f"{shown(value)} is of the wrong kind: expected {wanted}")
        found = float(Decimal(number) * scale)
    else:
        raise InputError(f"{shown(value)} is no quantity: expected {wanted}")
    if not isfinite(found):
        raise InputError(f"{shown(value)} is not finite: expected {wanted}")
    if found != 0.0 and not 1.0 / EXTREME < abs(found) < EXTREME:
        raise InputError(f"{shown(value)} is out of all range: expected {wanted}")
    return found


def parsed(text: str, wanted: str) -> Unit:
    """A unit from its text: value in SI units and powers of kg, m, s."""
    scale, kind, sign = Decimal(1), [0, 0, 0], 1
    for number, part in enumerate(text.split("/")):
        if number:
            sign = -1
        for word in re.split(r"[\s*·]+", part.strip().replace("**", "^")):
            match = FACTOR.fullmatch(word.replace("²", "2").replace("³", "3"))
            found = match and _named(match.group(1))
            if not found or not match:
                raise InputError(f"unit {shown(text)} unknown: expected {wanted}")
            power = sign * int(match.group(2) or 1)
            scale *= found[0] ** power
            kind = [k + power * d for k, d in zip(kind, found[1], strict=True)]
    return scale, (kind[0], kind[1], kind[2])


def _named(word: str) -> Unit | None:
    """A unit with or without a prefix."""
    whole = NAMES.get(word) or ALONE.get(word)
    if whole:
        return whole
    prefix, base = PREFIXES.get(word[:1]), NAMES.get(word[1:])
    return (prefix * base[0], base[1]) if prefix and base else None


def shown(value: object) -> str:
    """A value of a user, short enough for a message."""
    text = repr(value)
    return text if len(text) <= 50 else text[:47] + "..."


__all__ = ["si"]
