"""The ratios that `rollout.py` prints first, with the goal of each.

Both figures of a ratio come from one process, which measured them in turn. The ratio is the median of those of its
rounds, so that a busy moment meets both figures.
"""

from collections.abc import Mapping
from statistics import median
from typing import Any, NamedTuple

XLA = ", without the C++ kernels"  # in the names of figures: as the experiments of the paper train
Measured = Mapping[str, Mapping[str, Any]]  # part -> what it found, as in the file


class Goal(NamedTuple):
    """factor × figure `over` / figure `under` of a part; without `under` seconds of `over`.

    goal: None for a ratio without one; more: is more better?
    """

    what: str
    part: str
    over: str
    under: str
    factor: float
    goal: float | None
    more: bool = False

    def ratio(self, measured: Measured) -> float | None:
        """None where one of the figures was not measured."""
        figures = measured.get(self.part, {}).get("figures", {})
        if self.over not in figures or (self.under and self.under not in figures):
            return None
        if not self.under:
            return figures[self.over]["ms"][0] / 1e3
        rounds = zip(figures[self.over]["rounds"], figures[self.under]["rounds"], strict=True)
        return self.factor * median(over / under for over, under in rounds)

    def reached(self, ratio: float) -> bool:
        if self.goal is None:
            return True
        return ratio >= self.goal if self.more else ratio <= self.goal


_TWO, _ONE, _START = ", 2 cores", ", 1 core", "startup, 2 cores"
_LOOP, _EPOCH, _ALONE = "PyTorch loop, rollout", "PyTorch loop, epoch", "evaluation, Pinocchio's C++ alone, forward"
_EPOCH_SHARE = 1.0 / (60 * 605 * 4)  # Pinocchio's time for the evaluations of an epoch is this many of one evaluation

GOALS = (
    Goal(
        "tanks epoch, 1 member: times faster than the PyTorch loop",
        "tanks" + _TWO,
        _EPOCH,
        "epoch, 1 member",
        1,
        600,
        True,
    ),
    Goal("tanks epoch, 10 members: than ten epochs of it", "tanks" + _TWO, _EPOCH, "epoch, 10 members", 10, 2000, True),
    Goal(
        "LGSSM epoch, 50 members: than fifty epochs of it", "lgssm" + _TWO, _EPOCH, "epoch, 50 members", 50, 100, True
    ),
    Goal(
        "tanks epoch, 1 member, without the C++ kernels", "tanks" + _TWO, _EPOCH, "epoch, 1 member" + XLA, 1, None, True
    ),
    Goal("tanks epoch, 10 members, without them", "tanks" + _TWO, _EPOCH, "epoch, 10 members" + XLA, 10, None, True),
    Goal("LGSSM epoch, 50 members, without them", "lgssm" + _TWO, _EPOCH, "epoch, 50 members" + XLA, 50, None, True),
    Goal(
        "arm epoch, stopped gradient, over Pinocchio's C++, one core",
        "arm" + _ONE,
        "epoch, gradient stopped",
        _ALONE,
        _EPOCH_SHARE,
        1.3,
    ),
    Goal(
        "arm epoch, full gradient, over Pinocchio's C++, one core",
        "arm" + _ONE,
        "epoch, gradient full",
        _ALONE,
        _EPOCH_SHARE,
        2.0,
    ),
    Goal(
        "arm epoch, stopped gradient, over Pinocchio's C++, two cores",
        "arm" + _TWO,
        "epoch, gradient stopped",
        _ALONE,
        _EPOCH_SHARE,
        1.3,
    ),
    Goal(
        "arm epoch, full gradient, over Pinocchio's C++, two cores",
        "arm" + _TWO,
        "epoch, gradient full",
        _ALONE,
        _EPOCH_SHARE,
        2.0,
    ),
    Goal(
        "arm forward dynamics, float32, over Pinocchio's C++, one core",
        "arm" + _ONE,
        "evaluation, jax float32, forward",
        _ALONE,
        1,
        0.40,
    ),
    Goal("tanks rollout: times faster than the PyTorch loop", "tanks" + _TWO, _LOOP, "rollout", 1, 500, True),
    Goal("LGSSM rollout, 50 x 5000", "lgssm" + _TWO, _LOOP, "rollout", 1, 50, True),
    Goal("arm rollout, 6 x 605", "arm" + _TWO, _LOOP, "rollout", 1, 100, True),
    Goal(
        "arm rollout, 6 x 605, than a loop that calls Pinocchio",
        "arm" + _TWO,
        "PyTorch loop that calls Pinocchio, rollout",
        "rollout",
        1,
        None,
        True,
    ),
    Goal("discovery, tanks without network, all compiled, s", _START, "discovery, everything compiled", "", 1, 10),
    Goal("discovery, tanks without network, nothing compiled, s", _START, "discovery, nothing compiled", "", 1, 25),
    Goal("import with a first physics, s", _START, "import with a first physics", "", 1, 1.5),
    Goal("train.py --help, s", _START, "train.py --help", "", 1, 1.0),
    Goal(
        "second train.py of one shape until its first epochs, s",
        _START,
        "second train.py until its first epochs",
        "",
        1,
        4.0,
    ),
    Goal("make train from a fresh clone, s", "clone, 2 cores", "make train from a fresh clone", "", 1, 75.0),
)
