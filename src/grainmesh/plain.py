"""Results as plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Numbers, texts, lists and dicts that JSON can hold; what is not finite becomes None.

    Parameters
    ----------
    value : object
        Of arrays, numbers, texts, and sequences and mappings of these.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def spread(values: Any, unit: str) -> str:
    """Mean of positive values in words, with least and largest where they differ."""
    low, mean, high = float(values.min()), float(values.mean()), float(values.max())
    if high - low <= 1e-9 * high:
        return f"{mean:.4g} {unit}"
    return f"{mean:.4g} {unit} ({low:.3g} to {high:.3g})"


__all__ = ["plain", "spread"]
