"""Effects about which the data can say nothing, and why.

At its starting values an effect moves the free run by Δy. What is left of Δy once the parameters that are free anyway
have taken up what they can is what the data could see; where that is no more than noise, the effect is untestable.
"""

from typing import Any

import numpy as np

from pgrssnn_jax.discovery.candidates import Screening
from pgrssnn_jax.discovery.discover import Discovery

_VISIBLE = 10.0  # variances of the noise: energy of Δy that could be seen


def untestable(found: Discovery) -> list[dict[str, Any]]:
    return [
        {"name": name, "reason": reason}
        for name, reason in _reasons(found.selection.first, found.selection.noise).items()
        if name not in found.selection.final.estimate.active
    ]


def _reasons(screening: Screening, noise: float) -> dict[str, str]:
    said = {}
    for name, (moved, left) in screening.visible.items():
        least = _VISIBLE * max(noise, 1e-12)
        if not np.isfinite(moved) or moved < least:
            said[name] = "the data never reach it: it would not change the simulation by more than the noise"
        elif left < least:
            said[name] = "the parameters of the physics take it up: they would be fitted to other values instead"
    return said
