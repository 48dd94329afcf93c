"""A budget: the most that a run may take, as caps on the composed configuration.

    value -> min(value, cap);  null, which stands for all there is, -> cap

Caps are a tree of the same shape as the configuration. A cap on what this configuration does not have says nothing, so
one file serves every data set; what one data set alone needs stands under its name.
"""

from collections.abc import Mapping
from typing import Any


def capped(config: Mapping[str, Any], budget: Mapping[str, Any]) -> dict[str, Any]:
    """config with no number above its cap. budget: `{"any": caps, "data": {name: caps}}`, either may be missing.

    Values that are no numbers stay as they are: whoever reads them says what is wrong with them. Raises `ValueError`
    for a budget of another form.
    """
    unknown = sorted(budget.keys() - {"any", "data"})
    if unknown:
        raise ValueError(f"budget: expected the keys any and data, found {unknown[0]!r}")
    own = budget.get("data", {}).get(config["data"]["name"], {}) if "data" in config else {}
    return _capped(_capped(config, budget.get("any", {}), "budget.any"), own, "budget.data")


def _capped(value: Any, cap: Any, where: str) -> Any:
    if isinstance(cap, Mapping):
        if not isinstance(value, Mapping):
            raise ValueError(f"{where}: expected a number as the configuration has there, found a group")
        return {
            name: _capped(part, cap[name], f"{where}.{name}") if name in cap else part for name, part in value.items()
        }
    if isinstance(value, Mapping):
        raise ValueError(f"{where}: expected a group as the configuration has there, found {cap!r}")
    if type(cap) not in (int, float):
        raise ValueError(f"{where}: expected a number, found {cap!r}")
    if value is None:
        return cap
    return min(value, cap) if type(value) in (int, float) else value
