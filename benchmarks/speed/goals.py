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
_LOOP, _EPOCH = "PyTorch loop, rollout", "PyTorch loop, epoch"
_BATCHED = "PyTorch, networks batched over time, epoch"
PINOCCHIO = "Pinocchio's C++ alone, forward"  # one thread, double precision
OF_AN_EPOCH = f"an epoch's evaluations, {PINOCCHIO}"


def _against(loop: str, what: str, system: str, ours: str, goal: float | None, *, members: int = 1) -> Goal:
    """Times faster than PyTorch, whose members take turns."""
    return Goal(what, system + _TWO, loop, ours, members, goal, more=True)


def _over_pinocchio(what: str, cores: str, ours: str, theirs: str, goal: float | None) -> Goal:
    """Over one thread of Pinocchio, which computes in double precision, whatever the number of cores."""
    return Goal(f"{what}{cores}, over one thread of Pinocchio's C++", "arm" + cores, ours, theirs, 1, goal)


def _seconds(what: str, part: str, figure: str, goal: float) -> Goal:
    return Goal(f"{what}, s", part, figure, "", 1, goal)


GOALS = (
    _against(_EPOCH, "tanks epoch, 1 member: times faster than the PyTorch loop", "tanks", "epoch, 1 member", 600),
    _against(
        _EPOCH,
        "tanks epoch, 10 members: times faster than ten epochs of the loop",
        "tanks",
        "epoch, 10 members",
        2000,
        members=10,
    ),
    _against(
        _EPOCH,
        "LGSSM epoch, 50 members: times faster than fifty epochs of the loop",
        "lgssm",
        "epoch, 50 members",
        100,
        members=50,
    ),
    _against(_EPOCH, "tanks epoch, 1 member, without the C++ kernels", "tanks", "epoch, 1 member" + XLA, None),
    _against(
        _EPOCH, "tanks epoch, 10 members, without the C++ kernels", "tanks", "epoch, 10 members" + XLA, None, members=10
    ),
    _against(
        _EPOCH, "LGSSM epoch, 50 members, without the C++ kernels", "lgssm", "epoch, 50 members" + XLA, None, members=50
    ),
    _against(
        _BATCHED,
        "tanks epoch, 1 member: times faster than torch.nn.GRU and networks batched over time",
        "tanks",
        "epoch, 1 member",
        None,
    ),
    _against(
        _BATCHED,
        "LGSSM epoch, 50 members: times faster than fifty epochs of these",
        "lgssm",
        "epoch, 50 members",
        None,
        members=50,
    ),
    _over_pinocchio("arm epoch, stopped gradient", _ONE, "epoch, gradient stopped", OF_AN_EPOCH, None),
    _over_pinocchio("arm epoch, full gradient", _ONE, "epoch, gradient full", OF_AN_EPOCH, None),
    _over_pinocchio("arm epoch, stopped gradient", _TWO, "epoch, gradient stopped", OF_AN_EPOCH, 1.3),
    _over_pinocchio("arm epoch, full gradient", _TWO, "epoch, gradient full", OF_AN_EPOCH, 2.0),
    _over_pinocchio(
        "arm forward dynamics, float32", _ONE, "evaluation, native float32, forward", f"evaluation, {PINOCCHIO}", 0.40
    ),
    _against(_LOOP, "tanks rollout: times faster than the PyTorch loop", "tanks", "rollout", 500),
    _against(_LOOP, "LGSSM rollout, 50 x 5000: times faster than the loop", "lgssm", "rollout", 50),
    _against(_LOOP, "arm rollout, 6 x 605: times faster than the loop", "arm", "rollout", 100),
    _against(
        "PyTorch loop that calls Pinocchio, rollout",
        "arm rollout, 6 x 605: times faster than a loop that calls Pinocchio",
        "arm",
        "rollout",
        None,
    ),
    _seconds("discovery, tanks without network, all compiled", _START, "discovery, everything compiled", 10),
    _seconds("discovery, tanks without network, nothing compiled", _START, "discovery, nothing compiled", 25),
    _seconds("import with a first physics", _START, "import with a first physics", 1.5),
    _seconds("train.py --help", _START, "train.py --help", 1.0),
    _seconds(
        "second train.py of one shape until its first epochs", _START, "second train.py until its first epochs", 4.0
    ),
    _seconds("make train from a fresh clone", "clone, 2 cores", "make train from a fresh clone", 75.0),
)
