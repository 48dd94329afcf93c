"""The figures of a run: what was predicted, how an arm moved, how it was trained, how the members compare.

Each function returns a `matplotlib.figure.Figure`, and `figure.savefig(path)` writes it; `stick_animation` returns an
SVG element. `CAPTIONS` says what to look at.
"""

from pgrssnn_jax.reports.animation import stick_animation
from pgrssnn_jax.reports.prediction import prediction_figure
from pgrssnn_jax.reports.ranking import members_figure
from pgrssnn_jax.reports.stick import stick_figure
from pgrssnn_jax.reports.training import training_figure

__all__ = ["CAPTIONS", "members_figure", "prediction_figure", "stick_animation", "stick_figure", "training_figure"]

CAPTIONS = {
    "Prediction": "Free-run simulation of the test record. What the model explains lies on the measured line; what it"
    " does not is left in the residual below. Thin lines are members, the band is one standard deviation over them.",
    "Arm": "Poses of the arm at evenly spaced times of the sequence, all to one scale and seen from a little above: a"
    " wrong pose shows as blue beside the grey. The light line on the floor is the measured arm from above. The curve"
    " is the error that this makes at the tip; its numbered lines are the moments above.",
    "Animation": "The same sequence in motion, over and over; the picture says how fast. The line that runs along the"
    " curve is the moment shown.",
    "Training": "Each thin line is a member; the strong line is the median over members, drawn while at least half of"
    " them train. Dots mark the epoch whose parameters were kept: the lowest validation loss.",
    "Members": "Test error of every member, sorted. The ensemble is the error of the mean prediction, which can be"
    " lower than the error of any member.",
}
"""How the title of a figure begins, and what to look at; the page puts it under the figure."""
