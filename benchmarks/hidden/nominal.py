"""The physics that discovery is given: the nominal one, integrated finely enough not to be in the way; an arm is what
users have."""

from pgrssnn_jax.physics.arms.build import arm
from pgrssnn_jax.physics.base import Physics
from pgrssnn_jax.physics.linear import lgssm
from pgrssnn_jax.physics.tanks import cascaded_tanks

from . import chain, circuit, drive, duffing, hysteretic, pendulum, reactor, servo, units
from .case import Case
from .rig import REFERENCE_LEVEL

# True numbers by the names that the nominal physics has for them; a linear system's depend on its coordinates.
_NAMES = {"pendulum": {"l": "length", "d": "damping"}}
_NOT_COMPARED = ("lgssm", "arm")
USERS = {"pendulum": pendulum.pendulum} | {
    module.PLANT.name: module.PLANT.physics for module in (servo, duffing, chain, hysteretic, drive, circuit, reactor)
}


def nominal(case: Case) -> Physics:
    physics = _in_own_units(case)
    return physics if case.units == (1.0, 1.0) else units.physics_in(physics, case.system, case.units)


def _in_own_units(case: Case) -> Physics:
    if case.system == "tanks":
        return cascaded_tanks(**case.physics, integrator="rk4")
    if case.system == "lgssm":
        return lgssm(**case.physics)
    if case.system in USERS:
        return USERS[case.system](**case.physics)
    return arm(**case.physics)


def true_parameters(case: Case) -> dict[str, float]:
    """Numbers of the plant by the names of the nominal physics."""
    if case.system in _NOT_COMPARED:
        return {}
    known = dict(case.magnitudes["parameters"])
    if "exponent" in case.magnitudes:  # the plant's outlet keeps its flow at REFERENCE_LEVEL, the effect its k4
        known["k4"] *= REFERENCE_LEVEL ** (0.5 - case.magnitudes["exponent"])
    names = _NAMES.get(case.system, {name: name for name in known})
    factors = {name: units.parameter_factor(case.system, name, case.units) for name in names}
    return {name: float(known[there]) * factors[name] for name, there in names.items()}
