"""The poses of an arm along a test sequence, turned towards the reader, and the floor it stands on.

The arm is seen from the side that shows most of it, a little from above, without perspective: lengths across the
picture are true.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

ELEVATION = math.radians(20.0)
BASE = 0.09  # radius of the base's mark, of the floor's


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
    """What every picture of a sequence shares: a round floor, the squares on it, and the corners in view, in metres."""

    centre: np.ndarray
    radius: float
    square: float
    low: np.ndarray
    high: np.ndarray


def read_poses(predictions: Mapping[str, np.ndarray], sequence: int) -> Poses:
    """The poses of one sequence, turned so that the vertical plane in which the arm mostly lies faces the reader."""
    measured, predicted = predictions["skeleton_measured"], predictions["skeleton_predicted"]
    if measured.ndim != 4 or measured.shape[3] != 3 or 0 in measured.shape:
        expected = "expected [sequence, time, point, 3], none of them empty"
        raise ValueError(f"read_poses: skeleton_measured: {expected}, found {measured.shape}")
    if predicted.shape != measured.shape:
        raise ValueError(f"read_poses: skeleton_predicted: expected {measured.shape}, found {predicted.shape}")
    if not 0 <= sequence < len(measured):
        raise ValueError(f"read_poses: sequence: expected 0 to {len(measured) - 1}, found {sequence}")

    both = np.stack([measured[sequence], predicted[sequence]]).astype(np.float64)
    both = np.where(np.isfinite(both).all((2, 3), keepdims=True), both, np.nan)
    known = next((points[np.isfinite(points[:, 0, 0])] for points in both if np.isfinite(points).any()), both[0, :0])
    if not len(known):
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
    both = np.concatenate([points[np.isfinite(points)].reshape(-1, 3) for points in poses])
    trusted = poses.measured[np.isfinite(poses.measured)].reshape(-1, 3)
    trusted = np.concatenate([np.zeros((1, 3)), trusted if len(trusted) else both])
    reach = float(np.linalg.norm(trusted, axis=-1).max()) or 1.0
    corners = np.stack([trusted[:, :2].min(0), trusted[:, :2].max(0)])
    centre = corners.mean(0)
    radius = max((1 + BASE) * float(np.linalg.norm(trusted[:, :2] - centre, axis=-1).max()), 0.3 * reach)
    power = 10.0 ** math.floor(math.log10(radius))
    square = max(size * power for size in (0.2, 0.5, 1.0, 2.0, 5.0) if size * power <= 0.6 * radius)
    seen = project(np.concatenate([np.clip(both, -2 * reach, 2 * reach), floor_edge(centre, radius)]))
    pad = 0.02 * np.ptp(seen, axis=0).max()
    return Stage(centre, radius, square, seen.min(0) - pad, seen.max(0) + pad)


def floor_edge(centre: np.ndarray, radius: float) -> np.ndarray:
    """A circle on the floor, `[corner, 3]`."""
    angle = np.linspace(0.0, 2 * np.pi, 73)
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, np.zeros_like(x)], -1)


def floor_lines(stage: Stage) -> np.ndarray:
    """The sides of the squares on the floor, `[line, end, 3]`, from edge to edge; the base is one of their corners.

    They stand aslant to the reader, or they would look like a flat grid.
    """
    lines = []
    for turn in (math.radians(32.0), math.radians(122.0)):
        along, aside = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        middle = float(stage.centre @ aside)
        first, last = (middle + sign * stage.radius for sign in (-1, 1))
        for k in range(math.ceil(first / stage.square), math.floor(last / stage.square) + 1):
            off = k * stage.square - middle
            half = math.sqrt(max(stage.radius**2 - off**2, 0.0))
            lines.append([stage.centre + off * aside + sign * half * along for sign in (-1, 1)])
    return np.pad(np.array(lines), ((0, 0), (0, 0), (0, 1)))
