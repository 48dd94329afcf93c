"""What discovery searches, and when an effect counts: every setting with its default, unit and source."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

# Settings of a physics that discovery chooses itself, where the physics has them (a mapping replaces the values that it
# names).
_REPLACED: Mapping[str, Any] = {
    "integrator": {"euler": "rk4"},  # the error of an integrator is no missing effect
    "clamp": False,  # limits of the levels are what is to be found
    "velocity_disturbance": None,  # the arm without the effects that its published variants contain
    "torque_bias": None,
    "derivatives": "forward",  # the arm, so that it can be fitted
    "physics_gradient": "full",
    "backend": "jax",  # the other one takes no payload and no gravity of its own
}
_FIXED = (
    "arm.B",  # the known friction of an arm, whose change is in the catalogue
    "arm.Tc",
    "lgssm.B",  # which coordinates a state is written in is free: T A T⁻¹, T B, C T⁻¹ say the same
)


class Rules(NamedTuple):
    """When an effect counts.

    p_value: of its gain under the null; share: least part of the recalibrated gap (RMS error above that of the noise)
    that it closes; least: least relative fall of the error energy; rest, visible: the same for an effect that closes at
    least `rest` of the remaining gap; finalists: candidates that are cross-validated; most: largest number of effects;
    draws: of the null. beam: how many other beginnings are tried, where more than `open` of the gap or more than
    `above` times the energy of the noise is left; far: times that energy where errors are surely no noise.
    """

    p_value: float = 0.01
    share: float = 0.02
    least: float = 0.02
    rest: float = 0.5
    visible: float = 0.1
    finalists: int = 6
    most: int = 4
    draws: int = 2000
    open: float = 0.05
    above: float = 1.25
    beam: int = 3
    far: float = 2.0


@dataclass(frozen=True)
class DiscoverySettings:
    """The defaults of `pg.discover`, of `discover.py` and of its benchmark."""

    replace: Mapping[str, Any] = field(default_factory=lambda: dict(_REPLACED))
    fixed: list[str] = field(default_factory=lambda: list(_FIXED))  # parameters that no fit moves, NAME or PHYSICS.NAME
    tolerance: float | None = 0.5  # prior: relative standard deviation of the other parameters; None: no prior
    stretches: Any = "auto"  # samples of simulated stretches, one length after the other; []: whole records
    without: list[str] = field(default_factory=list)  # names of effects that the catalogue is to do without
    effects: list[str] = field(default_factory=list)  # effects of one's own: MODULE.NAME of an Effect or of a function
    starts: int = 4  # starting values of the recalibration
    folds: int = 5  # of the cross-validation
    block: int = 32  # samples at most, fewer in records below 640; blocks take turns: every fold sees all parts
    n_init: int = 50  # samples of the test record from which its start is fitted, where it shares none
    steps: int = 30  # of Levenberg-Marquardt, at most
    p_value: float = 0.01  # of the gain of an effect under the null (nothing missing, errors of the spectrum seen)
    share: float = 0.02  # least part of the recalibrated gap (RMS error above the noise) that an effect closes
    most: int = 4  # effects that may be found
    draws: int = 2000  # of the null: with 400 a p-value of 0.0035 came out as 0.0125, beyond the limit
    seed: int = 0  # of its random numbers
    network_epochs: int = 200  # of the PG-RSSNN that is trained on the old and the new physics; 0: none
    accelerate: bool = True  # False: without the tricks of `pgrssnn_jax.acceleration`, slower, equal results

    def __post_init__(self) -> None:
        checks = {"starts": 1, "folds": 2, "block": 2, "n_init": 1, "steps": 1, "most": 1, "draws": 99, "seed": 0}
        for name, least in {**checks, "network_epochs": 0}.items():
            if (value := getattr(self, name)) < least:
                raise ValueError(f"discovery.{name}: expected at least {least}, found {value}")
        for name, value in (("p_value", self.p_value), ("share", self.share)):
            if not 0.0 < value < 1.0:
                raise ValueError(f"discovery.{name}: expected a number between 0 and 1, found {value:g}")
        if self.tolerance is not None and not self.tolerance > 0.0:
            raise ValueError(f"discovery.tolerance: expected null or a number above 0, found {self.tolerance:g}")

    @property
    def rules(self) -> Rules:
        return Rules(p_value=self.p_value, share=self.share, most=self.most, draws=self.draws)
