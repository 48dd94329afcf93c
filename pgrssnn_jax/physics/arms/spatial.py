"""Spatial vectors in components: a vector is a list of arrays `[n, batch]`, one per component, links stacked.

Motions are (angular, linear), forces are (moment, force), all about the world's origin in world axes, so that vectors
of different links add without a change of frame. Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 2.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax

Vector = list[jax.Array]


class Inertias(NamedTuple):
    """mass `[n, 1]`; first moment of mass m c, 3 components; second moment about the origin: xx, yy, zz, xy, xz, yz."""

    mass: jax.Array
    first: Vector
    second: Vector


def cross(a: Sequence[jax.Array], b: Sequence[jax.Array]) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Sequence[jax.Array], b: Sequence[jax.Array]) -> jax.Array:
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), a[0] * b[0])


def plus(first: Vector, *others: Vector) -> Vector:
    total = first
    for other in others:
        total = [x + y for x, y in zip(total, other, strict=True)]
    return total


def minus(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def scale(s: jax.Array, v: Sequence[jax.Array]) -> Vector:
    return [s * x for x in v]


def motion_cross(a: Vector, b: Vector) -> Vector:
    """a × b of two motions."""
    return cross(a[:3], b[:3]) + plus(cross(a[:3], b[3:]), cross(a[3:], b[:3]))


def force_cross(a: Vector, f: Vector) -> Vector:
    """a ×* f of a motion and a force; (a × b)ᵀ f = -bᵀ (a ×* f)."""
    return plus(cross(a[:3], f[:3]), cross(a[3:], f[3:])) + cross(a[:3], f[3:])


def symmetric(second: Vector, a: Vector) -> Vector:
    """A second moment times the angular part of a motion."""
    (xx, yy, zz, xy, xz, yz), (x, y, z) = second, a[:3]
    return [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]


def momentum(inertias: Inertias, a: Vector) -> Vector:
    """I a, a force from a motion."""
    mass, first, second = inertias
    return plus(symmetric(second, a), cross(first, a[3:])) + plus(scale(mass, a[3:]), cross(a[:3], first))
