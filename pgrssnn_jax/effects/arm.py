"""The effects that a model of a robot arm may lack, in the order in which they are added to it: torques, masses, what
happens to the joints once a step is done, and how they are read. Joints in rad, rad/s and Nm."""

import numpy as np

from pgrssnn_jax.effects import arm_joints as joints
from pgrssnn_jax.effects import arm_masses as masses
from pgrssnn_jax.effects import arm_torques as torques
from pgrssnn_jax.effects.base import Effect, own_of
from pgrssnn_jax.physics.base import Physics

_KNOWN = {"S": "velocity_disturbance", "theta": "torque_bias"}


def arm_effects(physics: Physics) -> tuple[Effect, ...]:
    """The effects of an arm of any number of joints, but for those whose numbers the physics already knows: S and θ."""
    own, n = own_of(physics.params), len(physics.inputs)
    gear = np.abs(np.asarray(own["G"], np.float64))
    found = (
        torques.torque_gain(n),
        *((torques.wrist_coupling(),) if n == torques.WRIST else ()),
        torques.torque_bias(n),
        torques.gravity_counterbalance(n, gear),
        torques.viscous_friction(n),
        torques.coulomb_friction(n),
        torques.stribeck_friction(n),
        masses.payload(),
        masses.rotor_inertia(n),
        masses.gravity_direction(),
        joints.joint_limit(n),
        joints.stiction(n),
        joints.velocity_disturbance(n),
        joints.home_offset(n),
    )
    left_out = {name for symbol, name in _KNOWN.items() if symbol in own}
    return tuple(effect for effect in found if effect.name not in left_out)
