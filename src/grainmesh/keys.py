"""What may stand for a key of a case file: quantities, counts, names, and tables of keys.

Every quantity is a number in the SI unit of its description, or text with a unit ("2 mm",
`grainmesh.units`). Unknown and missing keys of a table are found here.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from grainmesh.domain import SIDES
from grainmesh.errors import InputError
from grainmesh.units import shown, si

#: Most discs of one arrangement, and of one at random.
MANY, MANY_AT_RANDOM = 1_000_000, 50_000


def nearest(word: str, names: Iterable[str]) -> str:
    """The name most like a word."""
    return get_close_matches(word, list(names), n=1, cutoff=0.0)[0]


def quantity(unit: str) -> BeforeValidator:
    return BeforeValidator(lambda value: si(value, unit), json_schema_input_type=float | str)


def one_of(names: Iterable[str], what: str) -> BeforeValidator:
    known = list(names)

    def check(value: object) -> object:
        if value not in known:
            near = nearest(str(value), known)
            raise InputError(f"{what} {shown(value)} unknown, did you mean '{near}'?")
        return value

    return BeforeValidator(check, json_schema_input_type=Literal[tuple(known)])


def _one_or_two(what: str) -> PlainValidator:
    """A length, or two that ascend; `what` says what they are."""

    def check(value: object) -> float | tuple[float, float]:
        if not isinstance(value, (list, tuple)):
            return _positive(si(value, "m"))
        if len(value) != 2:
            raise InputError(f"expected {what}")
        low, high = (_positive(si(part, "m")) for part in value)
        if low > high:
            raise InputError("the first must not be above the second")
        return low, high

    kind = float | str | tuple[float | str, float | str]
    return PlainValidator(check, json_schema_input_type=kind)


def _positive(value: float) -> float:
    if value <= 0.0:
        raise InputError(f"{value:g} must be positive")
    return value


def _whole(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError(f"{shown(value)} must be a whole number")
    return value


def _yes_or_no(value: object) -> object:
    if not isinstance(value, bool):
        raise InputError(f"{shown(value)} must be true or false")
    return value


Pure = Annotated[float, quantity("1")]
Length = Annotated[float, quantity("m")]
Time = Annotated[float, quantity("s")]
Speed = Annotated[float, quantity("m/s")]
Rate = Annotated[float, quantity("1/s")]
Acceleration = Annotated[float, quantity("m/s2")]
Density = Annotated[float, quantity("kg/m3"), Field(gt=0)]
Stiffness = Annotated[float, quantity("N/m2"), Field(gt=0)]
Viscosity = Annotated[float, quantity("Pa s"), Field(gt=0)]
Pressure = Annotated[float, quantity("Pa")]
Slope = Annotated[float, quantity("Pa/m")]
Size = Annotated[Length, Field(gt=0)]
Span = Annotated[Time, Field(gt=0)]
Share = Annotated[Pure, Field(gt=0, lt=1)]
NotNegative = Annotated[Pure, Field(ge=0)]
Whole = Annotated[int, BeforeValidator(_whole, json_schema_input_type=int)]
Count = Annotated[Whole, Field(ge=1, le=MANY)]
Seed = Annotated[Whole, Field(ge=0, lt=2**63)]
Flag = Annotated[bool, BeforeValidator(_yes_or_no, json_schema_input_type=bool)]
Text = Annotated[str, Field(strict=True)]
Place = tuple[Length, Length]
Velocity = tuple[Speed, Speed]
Region = tuple[Length, Length, Length, Length]
Diameters = Annotated[
    float | tuple[float, float],
    _one_or_two("one diameter, or two as bounds: [least, largest]"),
]
Spacing = Annotated[
    float | tuple[float, float],
    _one_or_two("one distance, or two: [beside particles, far from them]"),
]
SideName = Annotated[str, one_of(SIDES, "side")]
#: Words for what pydantic says of a value.
WORDS = {
    "missing": "has too few values",
    "too_short": "has too few values",
    "too_long": "has too many values",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "model_type": "must be a table of keys",
    "model_attributes_type": "must be a table of keys",
    "string_type": "must be text",
}


class Section(BaseModel):
    """Keys that are known, and no others."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any) -> Any:
        """Name the first key that is unknown or missing: one line, however many follow from it."""
        if not isinstance(data, dict):
            return data
        for key in data:
            if key not in cls.model_fields:
                near = nearest(str(key), cls.model_fields)
                raise PydanticCustomError("key", "unknown key", {"key": key, "near": near})
        for key, item in cls.model_fields.items():
            if item.is_required() and key not in data:
                about = item.description or ""
                raise PydanticCustomError("lack", "missing", {"key": key, "about": about})
        return data


def first_mistake(fault: ValidationError, data: dict[str, Any]) -> str:
    """The first mistake in one line: where, what, and what to do."""
    errors = fault.errors(include_url=False)
    error = next((e for e in errors if e["type"] == "key"), errors[0])
    kind, about, given = error["type"], error.get("ctx", {}), error.get("input")
    where = _where(error["loc"], data)
    dot = f"{where}." if where else ""
    if kind == "key":
        return f"{dot}{about['key']}: unknown key, did you mean {about['near']}?"
    if kind == "lack":
        return f"{dot}{about['key']}: missing; {about['about']}"
    if kind == "union_tag_not_found":
        tag = about["discriminator"].strip("'")
        typed = get_close_matches(tag, given if isinstance(given, dict) else (), 1)
        if typed:
            return f"{dot}{typed[0]}: unknown key, did you mean {tag}?"
        return f"{dot}{tag}: missing; it says which kind this is"
    if kind == "union_tag_invalid":
        names = [name.strip("' ") for name in about["expected_tags"].split(",")]
        tag = about["discriminator"].strip("'")
        near = nearest(about["tag"], names)
        return f"{dot}{tag}: {shown(about['tag'])} unknown, did you mean '{near}'?"
    if kind == "literal_error":
        names = [name.strip("' ") for name in about["expected"].replace(" or ", ",").split(",")]
        return f"{where}: {shown(given)} unknown, did you mean '{nearest(str(given), names)}'?"
    if kind == "value_error":
        said = str(about["error"])
        return f"{dot[:-1]}: {said}" if where and not said.startswith(f"{where}:") else said
    said = WORDS.get(kind) or error["msg"].replace("Input should", "must")
    plain = not isinstance(given, (dict, list, tuple))
    return f"{where}: {shown(given)} {said}" if plain else f"{where}: {said}"


def _where(loc: tuple[int | str, ...], data: Any) -> str:
    """The path of a key, without the names of variants that pydantic puts in between."""
    path, entered = "", True
    for part in loc:
        inside = isinstance(data, dict) and part in data
        if entered and isinstance(data, dict) and part in (data.get("arrange"), data.get("kind")):
            entered = False  # a variant, though a key may have its name: arrange = "file"
            continue
        if isinstance(data, list) and isinstance(part, int) and part < len(data):
            path, inside = f"{path}[{part}]", True
        elif inside:
            path = f"{path}.{part}" if path else str(part)
        if inside:
            data, entered = data[part], True
    return path


__all__ = [
    "MANY",
    "MANY_AT_RANDOM",
    "Acceleration",
    "Count",
    "Density",
    "Diameters",
    "Flag",
    "Length",
    "NotNegative",
    "Place",
    "Pressure",
    "Pure",
    "Rate",
    "Region",
    "Section",
    "Seed",
    "Share",
    "SideName",
    "Size",
    "Slope",
    "Spacing",
    "Span",
    "Speed",
    "Stiffness",
    "Text",
    "Time",
    "Velocity",
    "Viscosity",
    "Whole",
    "first_mistake",
    "nearest",
    "one_of",
    "quantity",
]
