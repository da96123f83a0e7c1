"""Conversion of stamps between decimal text and int64 nanoseconds, exact where a float64 would round."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

SHIFTS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Unit of a stamp -> power of ten that converts it to nanoseconds."""

MIN_NANOSECONDS = 1e17
"""A stamp above this is in nanoseconds: as microseconds it would be 3000 years after the epoch."""

INT64_DIGITS = 19
"""A number with this many digits fits an int64 if its first digit is at most 8; one with fewer always does."""

ROUNDING_NS = 1_000
"""Tolerance, ns, beyond the largest gap: seconds since 1970 in float64, or with six decimals, are that exact."""


def seconds_to_ns(text: str) -> int:
    """Nanoseconds from seconds as text, exact where a float64 would round ("1403636580.838555648").

    Decimals past the ninth are rounded, not cut: numpy writes 0.15 as "1.499999999999999944e-01".
    """
    return scaled_integer(text, SHIFTS["s"])


def ns_to_seconds(stamp_ns: int) -> str:
    """Seconds as `%d.%09d`, exact."""
    sign = "-" if stamp_ns < 0 else ""
    whole, nanoseconds = divmod(abs(int(stamp_ns)), 1_000_000_000)
    return f"{sign}{whole}.{nanoseconds:09d}"


def too_wide(gaps_ns: NDArray[np.int64], max_gap_s: float) -> NDArray[np.bool_]:
    """Which gaps (N,), ns, between two stamps exceed max_gap_s, which may be infinite, by more than the rounding of the
    stamps."""
    return np.asarray(gaps_ns > np.rint(max_gap_s * 1e9) + ROUNDING_NS)


def scaled_integer(text: str, shift: int) -> int:
    """The decimal number `text` times 10**shift, rounded. Raises ValueError where it is not a finite number."""
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        raise ValueError(f"not a number: {text!r}") from None
    if not value.is_finite() or value.adjusted() > 30:
        raise ValueError(f"not a time: {text!r}")
    return int(value.scaleb(shift).to_integral_value())


def scaled_integers(texts: Sequence[str] | NDArray[np.bytes_], shift: int) -> NDArray[np.int64]:
    """The decimal numbers `texts` (N,), ASCII, times 10**shift, rounded: (N,) int64.

    Texts of the same shape (length, position of the point) are converted together; those that are not plain digits, or
    have more digits than fit, one by one. Raises ValueError for what is not a finite number, OverflowError beyond
    int64.
    """
    padded = np.array(texts, dtype=np.bytes_)
    width = padded.dtype.itemsize
    characters = padded.view(np.uint8).reshape(len(texts), width)
    lengths = np.count_nonzero(characters, axis=1)
    dots = characters == ord(".")
    points = np.where(dots.any(axis=1), dots.argmax(axis=1), lengths)
    shapes, members = np.unique(lengths * (width + 1) + points, return_inverse=True)
    values = np.empty(len(texts), dtype=np.int64)
    plain = np.zeros(len(texts), dtype=bool)
    for group, shape in enumerate(shapes):
        length, point = divmod(int(shape), width + 1)
        decimals = max(length - point - 1, 0)
        if not length - (point < length) > 0 or decimals > shift or point + shift > INT64_DIGITS:
            continue
        rows = np.flatnonzero(members == group) if len(shapes) > 1 else slice(None)
        digits = np.delete(characters[rows, :length], point, axis=1) if point < length else characters[rows, :length]
        powers = 10 ** np.arange(digits.shape[1] - 1 + shift - decimals, shift - decimals - 1, -1, dtype=np.int64)
        digits = digits - np.uint8(ord("0"))  # anything but a digit wraps to more than 9
        values[rows] = digits.astype(np.int64) @ powers
        fits = digits[:, 0] <= 8 if point + shift == INT64_DIGITS else True
        plain[rows] = (digits <= 9).all(axis=1) & fits
    for i in np.flatnonzero(~plain).tolist():
        values[i] = scaled_integer(padded[i].decode(), shift)
    return values
