"""The order in which effects act on an input.

    u ← min(f * u, high)        a lag, then a limit             u ← f * min(u, high)        the other way round

f: impulse response of the lag, *: convolution. The catalogue has one order. Another one matters for an offset and a
dead zone, and for a lag and any effect that bends.
"""

from collections.abc import Sequence

from pgrssnn_jax.discovery.flexible import families
from pgrssnn_jax.discovery.judged import Judged
from pgrssnn_jax.discovery.search import Named
from pgrssnn_jax.discovery.settings import Criteria
from pgrssnn_jax.effects.base import Effect


def reversed_on_inputs(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The catalogue with the effects of inputs in the opposite order."""
    turned = (effect for effect in reversed(effects) if effect.acts_on == "input")
    return tuple(next(turned) if effect.acts_on == "input" else effect for effect in effects)


def order_may_matter(named: Named, judged: Judged, criteria: Criteria) -> bool:
    """Does a curve of an input show more than what was named, or a memory beside an effect of an input, or do two such
    effects leave errors above the noise?"""
    problem, selection, unnamed = named.problem, named.selection, judged.judgement.unnamed
    if named.how.segmented:  # of an arm, whose torques nothing bends
        return False
    acting = sum(problem.effect(name).acts_on == "input" for name in selection.final.estimate.active)
    if unnamed is not None:
        kind = families(problem.physics)[unnamed[1].name].kind
        return kind == "input" or (kind == "history" and acting > 0)
    return acting > 1 and selection.last.rms() > criteria.above * selection.floor
