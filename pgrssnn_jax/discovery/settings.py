"""What discovery searches, and when an effect counts: every setting with its default, unit and source."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

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


class Criteria(NamedTuple):
    """When an effect counts, and what is said of it: every number that decides. The gap is the RMS error of the
    recalibrated physics above that of white noise; standard errors are those of predictive log-likelihoods."""

    p_value: float = 0.01  # of the gain of log-likelihood under the null, over the whole catalogue
    further: float = 0.05  # sum of the p-values of all effects that are named beside one that reaches it
    share: float = 0.02  # least part of the gap that an effect closes: below, it is not worth a name
    rest: float = 0.5  # or of the part that others leave, where it is `certain`
    exact: float = 0.002  # but at least this part of the gap: the laws of effects hold no better between two samples.
    # By as much a correction that takes the place of names predicts the test record better
    standard_errors: float = 1.0  # by which an effect predicts left-out blocks better
    certain: float = 3.0  # the same for less than `share` and for elaborate effects; and by which runs over whole
    # sequences come nearer by effects and corrections, where fits see segments
    nameless: float = 0.25  # part of the gap that such a correction closes beside named effects to be missed
    tied: float = 1.28  # standard errors by which a tenth of equals predict worse: within them effects are ambiguous
    alike: float = 1.0  # log-likelihood by which two effects are no less likely, and by which more effects must be
    # likelier than fewer: a ratio of e is no evidence (Jeffreys)
    most: int = 4  # effects
    finalists: int = 12  # effects of a screening that are compared after more steps
    hopeless: float = 0.2  # p-value after a few steps of a fit: if all are above and errors not clear, none is
    draws: int = 1000  # of the null
    block: int = 32  # samples that count as one in standard errors
    beam: int = 2  # other first effects that are tried where errors stay above the noise by the factor `above`
    above: float = 1.1
    shifted: float = 1.05  # ratio of the errors, nominal to recalibrated, above which parameters were wrong
    clear: float = 2.0  # ratio of the errors to white noise above which something is missing or the noise has a colour
    follows: float = 0.1  # share of the error energy that the signals explain where the equations are wrong


@dataclass(frozen=True)
class DiscoverySettings:
    """The defaults of `pg.discover`, of `discover.py` and of its benchmark."""

    replace: Mapping[str, Any] = field(default_factory=lambda: dict(_REPLACED))
    fixed: list[str] = field(default_factory=lambda: list(_FIXED))  # parameters that no fit moves, NAME or PHYSICS.NAME
    tolerance: float | None = 0.5  # prior: relative standard deviation of the other parameters; None: no prior
    evidence: Literal["auto", "inverse_dynamics", "free_run"] = "auto"  # of an arm
    stretches: Any = "auto"  # samples of simulated stretches: in a search, then for its numbers; []: whole records
    without: list[str] = field(default_factory=list)  # names of effects that are no candidates
    effects: list[str] = field(default_factory=list)  # your own effects: MODULE.NAME of an Effect or of a function
    starts: int = 4  # starting values of the recalibration
    folds: int = 5  # of the cross-validation
    block: int = 32  # samples at most, fewer in records below 640; blocks take turns: every fold sees all parts
    n_init: int = 50  # samples of the test record, at least, from which its start is fitted, where it shares none
    steps: int = 30  # of Levenberg-Marquardt, at most
    p_value: float = 0.01  # of the gain of an effect under the null (nothing missing, noise of the colour seen)
    share: float = 0.02  # least part of the recalibrated gap (RMS error above the noise) that an effect closes
    most: int = 4  # effects that may be found
    draws: int = 1000  # of the null, at most; long records get fewer, but enough for p_value
    seed: int = 0  # of its random numbers
    network_epochs: int = 200  # of the PG-RSSNN that is trained on the old and the new physics; 0: none
    accelerate: bool = True  # False: without the speed-ups of `pgrssnn_jax.acceleration`, slower, equal results

    def __post_init__(self) -> None:
        checks = {"starts": 1, "folds": 2, "block": 2, "n_init": 1, "steps": 1, "most": 1, "draws": 99, "seed": 0}
        for name, least in {**checks, "network_epochs": 0}.items():
            if (value := getattr(self, name)) < least:
                raise ValueError(f"discovery.{name}: expected at least {least}, found {value}")
        if self.evidence not in ("auto", "inverse_dynamics", "free_run"):
            expected = "auto, inverse_dynamics or free_run"
            raise ValueError(f"discovery.evidence: expected {expected}, found {self.evidence!r}")
        for name, value in (("p_value", self.p_value), ("share", self.share)):
            if not 0.0 < value < 1.0:
                raise ValueError(f"discovery.{name}: expected a number between 0 and 1, found {value:g}")
        if self.tolerance is not None and not self.tolerance > 0.0:
            raise ValueError(f"discovery.tolerance: expected null or a number above 0, found {self.tolerance:g}")

    @property
    def criteria(self) -> Criteria:
        return Criteria(
            p_value=self.p_value, share=self.share, most=self.most, draws=self.draws, block=max(self.block, 2)
        )
