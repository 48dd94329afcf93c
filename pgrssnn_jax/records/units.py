"""Conversion between the units of a record and those of a physics.

    value [to] = factor · value [from]           mbar -> bar, deg -> rad, mNm -> Nm, cm/s -> m/s

A unit is a product of symbols with powers: `m`, `rad/s`, `kg m^2`, `Nm`, `sqrt(V)/s`. Offsets (°C to K) are no factor
and are refused. Source of the symbols and prefixes: The International System of Units (SI), 9th edition, 2019.
"""

import math
import re
from fractions import Fraction

_PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "h": 1e2, "k": 1e3, "M": 1e6,
             "G": 1e9}  # fmt: skip
# symbol: factor, and the base units that it is made of
_SYMBOLS: dict[str, tuple[float, dict[str, int]]] = {
    "m": (1.0, {"m": 1}), "g": (1e-3, {"kg": 1}), "s": (1.0, {"s": 1}), "A": (1.0, {"A": 1}), "K": (1.0, {"K": 1}),
    "°C": (1.0, {"°C": 1}), "mol": (1.0, {"mol": 1}), "rad": (1.0, {"rad": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}), "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}), "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}), "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}), "Hz": (1.0, {"s": -1}),
    "L": (1e-3, {"m": 3}), "l": (1e-3, {"m": 3}),
}  # fmt: skip
_WHOLE = {
    "deg": (math.pi / 180.0, {"rad": 1}), "°": (math.pi / 180.0, {"rad": 1}), "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}), "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}), "rev": (2.0 * math.pi, {"rad": 1}),
    "%": (1e-2, {}), "1": (1.0, {}), "Nm": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "mNm": (1e-3, {"kg": 1, "m": 2, "s": -2}), "kNm": (1e3, {"kg": 1, "m": 2, "s": -2}),
}  # fmt: skip
_TOKEN = re.compile(r"\s*(?P<root>sqrt\()?(?P<symbol>[A-Za-zµμ°%]+|1)\)?(?:(?:\^|\*\*)?(?P<power>-?\d+))?\s*")


def with_unit(name: str, unit: str | None) -> str:
    """`name (unit)`, with a dash where there is no unit."""
    return f"{name} ({unit or '–'})"


def conversion(found: str, wanted: str) -> float | None:
    """The factor from one unit to another, None where there is none or a unit is not known."""
    if found == wanted:
        return 1.0
    one, other = _parsed(found), _parsed(wanted)
    if one is None or other is None or one[1] != other[1]:
        return None
    return one[0] / other[0]


def _parsed(unit: str) -> tuple[float, dict[str, Fraction]] | None:
    """The factor to base units, and their powers."""
    factor, powers = 1.0, dict[str, Fraction]()
    for position, part in enumerate(unit.split("/")):
        sign = 1 if position == 0 else -1
        for word in re.split(r"(?:\s|·|(?<!\*)\*(?!\*))+", part.strip()):
            match = _TOKEN.fullmatch(word)
            known = match and _symbol(match["symbol"])
            if not match or not known:
                return None
            power = Fraction(sign * int(match["power"] or 1), 2 if match["root"] else 1)
            factor *= known[0] ** float(power)
            for base, own in known[1].items():
                powers[base] = powers.get(base, Fraction(0)) + own * power
    return factor, {base: power for base, power in powers.items() if power}


def _symbol(text: str) -> tuple[float, dict[str, int]] | None:
    if known := _WHOLE.get(text) or _SYMBOLS.get(text):
        return known
    prefix, rest = _PREFIXES.get(text[:1]), _SYMBOLS.get(text[1:])
    return None if prefix is None or rest is None else (prefix * rest[0], rest[1])
