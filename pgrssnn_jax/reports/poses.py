"""The poses of an arm along a test sequence, turned towards the reader, and the floor it stands on.

The arm is seen from the side that shows most of it, a little from above, without perspective: lengths across the
picture are true.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

ELEVATION = math.radians(20.0)


class Poses(NamedTuple):
    """One sequence, `[time, point, 3]` in metres from the base: to the right, away from the reader, up.

    A pose that lacks a coordinate is NaN as a whole.
    """

    measured: np.ndarray
    predicted: np.ndarray

    @property
    def tip_distance(self) -> np.ndarray:
        """Metres between the measured and the predicted tip at every sample; NaN where one is missing."""
        return np.linalg.norm(self.measured[:, -1] - self.predicted[:, -1], axis=-1)


class Stage(NamedTuple):
    """What every picture of a sequence shares, in metres: the floor's radius, the side of its squares, the view."""

    radius: float
    square: float
    low: np.ndarray
    high: np.ndarray


def read_poses(predictions: Mapping[str, np.ndarray]) -> Poses:
    """The first sequence, turned so that the vertical plane in which the arm mostly lies faces the reader.

    predictions: `skeleton_measured` and `skeleton_predicted` `[seq, time, point, 3]` in metres, points from the base to
    the tip, z up.
    """
    both = np.stack([predictions[f"skeleton_{name}"][0] for name in Poses._fields]).astype(np.float64)
    both = np.where(np.isfinite(both).all((2, 3), keepdims=True), both, np.nan)
    known = next((points[np.isfinite(points[:, 0, 0])] for points in both if np.isfinite(points).any()), None)
    if known is None:
        return Poses(*both)
    across = (known - known[0, 0])[..., :2].reshape(-1, 2)
    main = np.linalg.eigh(across.T @ across)[1][:, -1]
    x, y = main if across.mean(0) @ main >= 0 else -main
    axes = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
    return Poses(*((both - known[0, 0]) @ axes.T))


def project(points: np.ndarray) -> np.ndarray:
    """Where points `[..., 3]` of `Poses` lie in the picture `[..., 2]`."""
    lifted = points[..., 2] * math.cos(ELEVATION) + points[..., 1] * math.sin(ELEVATION)
    return np.stack([points[..., 0], lifted], -1)


def set_stage(poses: Poses) -> Stage:
    """A floor below all places of the measured arm; a prediction that runs away is not followed further than twice."""
    measured, predicted = (points[np.isfinite(points)].reshape(-1, 3) for points in poses)
    trusted = measured if len(measured) else predicted
    reach = float(np.linalg.norm(trusted, axis=-1).max(initial=0.0)) or 1.0
    radius = max(1.1 * float(np.linalg.norm(trusted[:, :2], axis=-1).max(initial=0.0)), 0.3 * reach)
    power = 10.0 ** math.floor(math.log10(0.6 * radius))
    square = max(size * power for size in (1.0, 2.0, 5.0) if size * power <= 0.6 * radius)
    seen = project(np.concatenate([measured, np.clip(predicted, -2 * reach, 2 * reach), circle(radius)]))
    pad = 0.02 * np.ptp(seen, axis=0).max()
    return Stage(radius, square, seen.min(0) - pad, seen.max(0) + pad)


def circle(radius: float) -> np.ndarray:
    """A circle on the floor around the base, `[corner, 3]`."""
    angle = np.linspace(0.0, 2 * np.pi, 73)
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(73)], -1)


def floor_lines(stage: Stage) -> np.ndarray:
    """The sides of the squares on the floor, `[line, end, 3]`, from edge to edge; the base is one of their corners.

    They stand aslant to the reader, or they would look like a flat grid.
    """
    steps = math.floor(stage.radius / stage.square)
    off = stage.square * np.arange(-steps, steps + 1)[:, None]
    ends = np.sqrt(stage.radius**2 - off**2) * (-1, 1)
    turn = np.radians([32.0, 122.0])[:, None, None]
    x, y = np.cos(turn) * ends - np.sin(turn) * off, np.sin(turn) * ends + np.cos(turn) * off
    return np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 2, 3)
