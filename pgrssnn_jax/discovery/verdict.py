"""What may be said, and with what right.

no_discrepancy   the nominal physics is as good as the refitted one, and nothing of the catalogue is missing
miscalibrated    only parameters were wrong
effect_found     named effects close the gap
ambiguous        named effects close it, but others do as well on these data
unknown_effect   what is missing is in no catalogue, or what was found leaves a part that follows the signals
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from pgrssnn_jax.discovery.beyond import Beyond
from pgrssnn_jax.discovery.estimate import Validated, block_sums
from pgrssnn_jax.discovery.look import Candidate, Rules, Stage
from pgrssnn_jax.discovery.problem import Problem
from pgrssnn_jax.discovery.search import Found

_RESAMPLED = 500
_SIMILAR = 0.05  # part of an effect's own gain by which another may fall short and still be as good
_CHANCE = 0.1  # probability that the other is the better one, above which the data do not decide
_SHIFTED = 1.05  # ratio of the errors nominal and refitted, above which parameters were wrong
_BESIDE = 0.15  # part of the gap that a correction without a name must close beside the named effects to be missed
_AS_WELL = (0.05, -0.1)  # the same beside them, where one alone does nearly as well as all named effects together
_INSTEAD = 0.015  # the same for one in their place: what is truly there is never beaten by it but by chance
_REST = 0.5  # or: part of what the named effects leave above the noise, with a fall of the error energy of at least
_VISIBLE_INSTEAD, _VISIBLE_BESIDE = 0.03, 0.15
_WEAK_PROOF = 0.05  # p-value that is enough for a large correction, or far above the noise
_CERTAIN = 0.98  # probability that it is the better one
_LARGE, _NEARLY_CERTAIN = 0.25, 0.9  # fall of the error energy, and the probability that then is enough
_BEYOND_LUCK = 1.25  # times the largest gain by luck: what names leave near the noise is then no noise
_EXPLAINED = 0.5  # part of the gap that names must close to be more than a help where errors stay far above the noise
_NAMELESS = 0.05  # part of the gap that counts where names close little of it though errors are far above the noise
_FOLLOWS = 0.1  # share of the error energy that the signals must explain for the equations to be wrong
_LIKELY = 0.75  # probability that is enough there, if its gain is not luck


class Verdict(StrEnum):
    NO_DISCREPANCY = "no_discrepancy"
    MISCALIBRATED = "miscalibrated"
    EFFECT_FOUND = "effect_found"
    AMBIGUOUS = "ambiguous"
    UNKNOWN_EFFECT = "unknown_effect"


class Judged(NamedTuple):
    """unexplained: the stage and candidate of the correction that no name covers; alternatives: per effect, candidates
    that do as well."""

    verdict: Verdict
    unexplained: tuple[Stage, Candidate] | None
    alternatives: dict[str, tuple[Candidate, ...]]


def judge(problem: Problem, found: Found, beyond: Beyond, before: float, rules: Rules, seed: int) -> Judged:
    """before: error energy of the nominal physics, with the best initial state."""
    rng = np.random.default_rng(seed)
    gap = max(found.recalibrated.cost**0.5 - found.floor**0.5, 0.0)
    unexplained = _unexplained(found, beyond, gap, rules, rng)
    alternatives = {name: _alternatives(problem, found, name, rng) for name in found.final.estimate.active}
    if unexplained is not None or beyond.line is not None or _driven(found, beyond, gap, rules):
        verdict = Verdict.UNKNOWN_EFFECT
    elif found.final.estimate.active:
        verdict = Verdict.AMBIGUOUS if any(alternatives.values()) else Verdict.EFFECT_FOUND
    else:
        wrong = before**0.5 > _SHIFTED * found.recalibrated.estimate.cost**0.5
        verdict = Verdict.MISCALIBRATED if wrong else Verdict.NO_DISCREPANCY
    return Judged(verdict, unexplained, alternatives)


def _unexplained(
    found: Found, beyond: Beyond, gap: float, rules: Rules, rng: np.random.Generator
) -> tuple[Stage, Candidate] | None:
    """A correction without a name that does clearly better than the named effects, in their place or beside them.

    Where the physics alone already reaches the noise, its share of the gap says nothing: it must gain more than every
    draw of the null.
    """
    if found.first.free_run is not None:
        return _beside_in_stretches(beyond.beside, found.first.free_run, rules, rng)
    alone = beyond.alone.candidates[0].cost if beyond.alone else np.inf
    beside = _AS_WELL[0] if found.final.cost**0.5 - alone**0.5 >= _AS_WELL[1] * gap else _BESIDE
    far, named = found.final.cost > rules.far * found.floor, bool(found.final.estimate.active)
    seen = found.recalibrated.cost > (1.0 + rules.visible) * found.floor
    explained = _explained(found, gap)
    wanted = ((beyond.alone, _INSTEAD, _VISIBLE_INSTEAD), (beyond.beside, beside, _VISIBLE_BESIDE))
    for stage, least, visible in wanted:
        if stage is None:
            continue
        for one in (candidate for candidate in stage.candidates if candidate.validated):
            gains = _gains(found, stage, one, gap, rng)
            enough = _says_where(gains, rules) if far and not explained else _outweighs(gains, least, visible, rules)
            bends = named and not far and stage is beyond.beside
            if (enough and (seen or gains.lucky >= 1.0)) or (bends and _beyond_luck(gains, rules)):
                return stage, one
    return None


def _explained(found: Found, gap: float) -> bool:
    """Do names close a good part of the gap?"""
    closed = found.recalibrated.cost**0.5 - found.final.cost**0.5
    return bool(found.final.estimate.active) and closed >= _EXPLAINED * gap


def _driven(found: Found, beyond: Beyond, gap: float, rules: Rules) -> bool:
    """Errors far above the noise that names hardly lower, and that follow the signals by whatever law: something is
    missing, though no correction of one equation by one signal describes it."""
    if beyond.follows is None or _explained(found, gap):
        return False
    return beyond.follows.share >= _FOLLOWS and beyond.follows.p_value <= rules.p_value


def _beside_in_stretches(
    stage: Stage | None, begun: float, rules: Rules, rng: np.random.Generator
) -> tuple[Stage, Candidate] | None:
    """Errors of stretches are far above the noise, a correction visibly lowers them, and the free run too; begun: error
    of the free run without effects."""
    if stage is None or stage.free_run is None or stage.base.cost <= rules.far * stage.noise * stage.size:
        return None
    for one in stage.candidates:
        if one.validated is None or one.free_run is None:
            continue
        visible = one.cost <= (1.0 - _VISIBLE_INSTEAD) * stage.base.cost
        sure = stage.p_value(one) <= rules.p_value and chance_better(one.validated, stage.base, rng) >= _CERTAIN
        if visible and sure and stage.free_run - one.free_run >= rules.share * begun:
            return stage, one
    return None


class _Gains(NamedTuple):
    """What a correction brings. fall: of the error energy, relative; share, rest: of the gap and of what is left of it,
    in RMS; better: probability that it predicts better; luck: p-value; lucky: its gain over the largest one by luck."""

    fall: float
    share: float
    rest: float
    better: float
    luck: float
    lucky: float


def _gains(found: Found, stage: Stage, one: Candidate, gap: float, rng: np.random.Generator) -> _Gains:
    assert one.validated is not None
    gained, left = found.final.cost**0.5 - one.cost**0.5, found.final.cost**0.5 - found.floor**0.5
    largest = float(stage.null.max())
    return _Gains(
        1.0 - one.cost / found.final.cost,
        gained / gap if gap > 0 else -np.inf,
        gained / left if left > 0 else -np.inf,
        chance_better(one.validated, found.final, rng),
        stage.p_value(one),
        one.gain / largest if largest > 0 else np.inf,
    )


def _outweighs(gains: _Gains, least: float, visible: float, rules: Rules) -> bool:
    """A part of the gap, or most of what the names leave above the noise: then they are stand-ins."""
    most_of_rest = gains.rest >= _REST and gains.fall >= visible
    if not most_of_rest and not (gains.share >= least and gains.fall >= rules.least):
        return False
    certain = _NEARLY_CERTAIN if gains.fall >= _LARGE else _CERTAIN
    proof = _WEAK_PROOF if most_of_rest and gains.fall >= _VISIBLE_BESIDE else rules.p_value
    return gains.better >= certain and gains.luck <= proof


def _says_where(gains: _Gains, rules: Rules) -> bool:
    """Errors are far above the noise and no name helps much: something is missing, and less proof says where."""
    if gains.share < _NAMELESS or gains.fall < rules.least:
        return False
    certain = _NEARLY_CERTAIN if gains.fall >= _LARGE else _CERTAIN
    surely = gains.better >= certain and gains.luck <= _WEAK_PROOF
    return surely or (gains.better >= _LIKELY and gains.luck <= rules.p_value)


def _beyond_luck(gains: _Gains, rules: Rules) -> bool:
    """Names that bend the numbers of the physics to reach the noise: a correction beside them lets those go back."""
    visible = gains.fall >= rules.least and gains.share >= _INSTEAD
    return visible and gains.lucky >= _BEYOND_LUCK and gains.better >= _LIKELY


def _alternatives(problem: Problem, found: Found, name: str, rng: np.random.Generator) -> tuple[Candidate, ...]:
    """Candidates that do as well in the place of an effect; simpler forms of it aside, because they were preferred."""
    stage = found.stages[name]
    own = next((c for c in stage.candidates if c.name == name), None)
    if own is None or own.validated is None:
        return ()
    gained = stage.base.cost - own.cost
    effect = problem.effect(name)
    rivals = []
    for other in stage.candidates:
        related = other.name in effect.simpler or name in problem.effect(other.name).simpler
        if other.name == name or related or other.validated is None or stage.redundant(other.name):
            continue
        near = stage.base.cost - other.cost >= (1.0 - _SIMILAR) * gained
        if near and chance_better(other.validated, own.validated, rng) > _CHANCE:
            rivals.append(other)
    return tuple(rivals)


def chance_better(one: Validated, other: Validated, rng: np.random.Generator, block: int = 32) -> float:
    """Probability that `one` predicts left-out samples better, from blocks of samples drawn with replacement."""
    difference = block_sums(one.held_out**2 - other.held_out**2, block)
    drawn = difference[rng.integers(0, len(difference), (_RESAMPLED, len(difference)))].sum(1)
    return float((drawn < 0).mean() + 0.5 * (drawn == 0).mean())
