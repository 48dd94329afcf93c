"""`recipe=auto`: which candidate wins, what is tried, and members that go back to the physics."""

import math
import threading

import numpy as np
import pytest

import pgrssnn_jax as pg
from pgrssnn_jax.physics.simulate import has_forward_mode
from pgrssnn_jax.physics.tanks import cascaded_tanks
from pgrssnn_jax.training.candidates import candidates, describe, is_alone
from pgrssnn_jax.training.choose import Chosen, choose_settings
from pgrssnn_jax.training.race import Tried, clearly_better
from pgrssnn_jax.training.settings import training_settings

QUICK = {"validate_every": 1, "chunk_epochs": 5, "hidden": 3, "quiet": True}
ALONE, FITTED, BESIDE = (
    training_settings("pg_rssnn", changes)
    for changes in ({"networks": False}, {"networks": False, "physics_parameters": "trained"}, {})
)


def tried(settings, left_out) -> Tried:
    """Members whose errors do not change with training."""
    return Tried(settings, np.exp(np.asarray(left_out, float))[:, None], 10)


def test_networks_that_are_sometimes_better_and_sometimes_worse_do_not_replace_the_physics():
    physics, beside = tried(ALONE, [0, 0, 0, 0, 0]), tried(BESIDE, [-1.5, 1.0, -1.2, 0.8, -0.6])
    assert beside.score < physics.score - 0.1
    assert clearly_better([physics, beside], 0.1) is physics


def test_networks_that_are_always_better_replace_it_whatever_the_size_of_the_errors():
    for size in (0.0, -20.0, 20.0):
        physics, beside = tried(ALONE, np.full(5, size)), tried(BESIDE, size - np.array([0.4, 0.9, 0.6, 0.5, 0.8]))
        assert clearly_better([physics, beside], 0.1) is beside
        assert clearly_better([physics, beside], math.log(4.0)) is physics


def test_networks_must_beat_the_trained_parameters_too():
    physics, fitted = tried(ALONE, np.zeros(5)), tried(FITTED, np.array([-2.0, -2.1, -1.9, -2.0, -2.2]))
    assert clearly_better([physics, fitted, tried(BESIDE, np.full(5, -2.05))], 0.1) is fitted
    assert clearly_better([physics, fitted, tried(BESIDE, np.full(5, -3.0))], 0.1).settings is BESIDE


def test_of_networks_that_do_alike_those_with_small_corrections_are_chosen():
    strong, gentle, worse = (
        tried(training_settings("pg_rssnn", {"correction": c}), np.array([-2.0, -1.0, -1.5, -2.5, -3.0]) + shift)
        for c, shift in ((1.0, 0.0), (0.1, np.array([0.02, -0.01, 0.0, 0.03, -0.02])), (0.01, 0.3))
    )
    alone = tried(ALONE, np.zeros(5))
    assert clearly_better([alone, strong, gentle, worse], 0.1) is gentle
    assert clearly_better([alone, strong, worse], 0.1) is strong


def test_members_share_their_epoch_in_the_score():
    """Each member's own best epoch is luck where the others do not have it."""
    lucky = np.ones((5, 5)) - 0.99 * np.eye(5)
    assert Tried(BESIDE, lucky, 5).score == pytest.approx(0.0, abs=1e-6)


def test_one_good_validation_between_bad_ones_does_not_count():
    unsteady = np.tile([1.0, 0.01, 5.0, 3.0, 7.0], (5, 1))
    steady = np.tile([1.0, 0.9, 0.7, 0.6, 0.5], (5, 1))
    assert Tried(BESIDE, unsteady, 4).score > Tried(BESIDE, steady, 4).score
    assert Tried(BESIDE, steady, 4).score == pytest.approx(math.log(0.6))
    assert Tried(BESIDE, steady[:, :1], 0).score == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("model", ["pg_rssnn", "pg_rssnn_fb", "w_pgnn"])
def test_the_physics_alone_is_always_tried_and_what_is_given_is_not_changed(model):
    settings = training_settings(model, {"learning_rate": 5e-4, "folds": 5})
    found = candidates(settings, cascaded_tanks(), ["learning_rate"], {}, starts="perhaps", networks=True)
    assert is_alone(found[0])
    assert {one.fit.learning_rate for one in found} == {5e-4}
    assert {one.model.hidden for one in found} == {settings.model.hidden}
    assert len(set(found)) == len(found)


def test_what_cannot_be_is_not_tried():
    settings, stopped = training_settings("pg_rssnn"), cascaded_tanks()._replace(differentiable=False)
    found = candidates(settings, stopped, [], {}, starts="never", networks=True)
    assert {one.fit.physics_parameters for one in found} == {"fixed"}
    assert {one.run.initial_state for one in found} == {"first_output"}
    short = candidates(settings, cascaded_tanks(), [], {}, starts="always", networks=False)
    assert not any(one.model.networks for one in short)
    assert {one.run.initial_state for one in short} == {"least_squares"}
    black = candidates(training_settings("rssnn"), cascaded_tanks(), [], {}, starts="perhaps", networks=True)
    assert all(one.model.networks and one.fit.physics_parameters == "fixed" for one in black)


def level(samples=240, seed=0, noise=0.02, start="unknown", **numbers):
    """A record of tanks whose levels begin at 4 and 5; start: the label of the record, which may be wrong."""
    rng, plant = np.random.default_rng(seed), cascaded_tanks(**numbers)
    u = np.repeat(rng.uniform(1.5, 3.5, (samples // 12 + 1, 1)), 12, axis=0)[:samples]
    y = pg.simulate(plant, u, np.array([4.0, 5.0])).y
    return pg.record(
        u, y + noise * rng.standard_normal(y.shape),
        dt=4.0, inputs={"pump_voltage": "V"}, outputs={"level_voltage": "V"}, start=start,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("start", "tried_starts"),
    [("unknown", {"least_squares"}), ("shared", {"first_output", "least_squares"}), ("rest", {"zero"})],
)
def test_the_label_of_the_start_decides_which_initial_states_are_tried(start, tried_starts, monkeypatch):
    """From rest the initial state is known: it is not searched, and members leave out the first samples in turn too."""

    def race(physics, train, validation, settings, among, stop, notify):
        return [tried(one, [0.0, 0.0]) for one in among]

    monkeypatch.setattr("pgrssnn_jax.training.choose.race", race)
    record, settings = level(start=start), training_settings("pg_rssnn", {"n_seeds": 2})
    chosen = choose_settings(cascaded_tanks(), record, settings, (), stop=threading.Event(), notify=lambda line: None)
    assert {one.settings.run.initial_state for one in chosen.tried} == tried_starts
    assert (chosen.settings.data.lead == 0) == (start == "rest")
    after = choose_settings(
        cascaded_tanks()._replace(discovered=True), record, settings, (), stop=threading.Event(), notify=print
    )
    assert after.settings.run.initial_state == ("zero" if start == "rest" else "estimated")


@pytest.mark.compiles
def test_a_right_physics_stays_alone_and_says_so():
    record = level()
    said = []
    settings = training_settings("pg_rssnn", {"epochs": 40, "n_seeds": 5, "hidden": 3, "validate_every": 5})
    chosen = choose_settings(
        cascaded_tanks(), record, settings, {"epochs", "n_seeds"}, stop=threading.Event(), notify=said.append
    )
    assert isinstance(chosen, Chosen)
    assert is_alone(chosen.settings)
    report = chosen.report()
    assert report["chosen"] == describe(chosen.settings) == report["tried"][0]["settings"]
    assert report["tried"][0]["left_out_nrmse"] < 0.1
    assert len(report["tried"]) > 5
    assert "the physics alone" in said[-1]


@pytest.mark.compiles
def test_a_bent_physics_is_corrected_and_its_members_predict_what_the_plant_does():
    record, later = level(480, k1=0.055, k4=0.05), level(480, seed=1, k1=0.055, k4=0.05)
    ensemble = pg.fit("pg_rssnn", cascaded_tanks(), record, seeds=5, epochs=400, quiet=True)
    alone = pg.fit(
        "physics_only", cascaded_tanks(), record, initial_state="least_squares", recipe="default", quiet=True
    )
    assert not is_alone(ensemble.settings)  # fitted parameters, a large correction, or both: nearly as good here
    errors = [one.score(later)["rmse"].mean() for one in (ensemble, alone)]
    assert errors[0] < 0.4 * errors[1]
    coverage = ensemble.evaluate(later).metrics["interval"]["coverage"][0]
    assert coverage > 0.75


@pytest.mark.compiles
def test_a_member_that_does_not_beat_the_physics_is_the_physics():
    """Networks whose step is absurd spoil what they begin with, and go back."""
    record = level(120)
    fitted = pg.fit(
        "pg_rssnn", cascaded_tanks(), record, recipe="auto", seeds=3, epochs=5, folds=3, block=30, networks=True,
        start_from_physics=False, correction=1.0, learning_rate=1e-3, physics_parameters="fixed",
        initial_state="first_output", **QUICK,
    )  # fmt: skip
    assert fitted.recipe["fell_back"] == [{"seed": seed, "dataset": 0} for seed in (0, 1, 2)]
    alone = pg.simulate(cascaded_tanks(), record.u, np.array([4.0, 5.0])).y
    again = fitted.simulate(record.u, np.array([4.0, 5.0]))
    np.testing.assert_allclose(again, np.broadcast_to(alone, again.shape), rtol=2e-4, atol=2e-4)


def test_a_stop_while_settings_are_chosen():
    stop = threading.Event()
    stop.set()
    settings = training_settings("pg_rssnn", {"epochs": 5, "n_seeds": 2, "hidden": 3})
    assert choose_settings(cascaded_tanks(), level(60), settings, (), stop=stop, notify=lambda line: None) is None


def test_the_start_of_an_arm_is_not_searched_through_its_whole_run():
    """Its dynamics have a derivative rule that only works backwards: the Jacobian would take tens of gigabytes."""
    assert not has_forward_mode(pg.physics.arm())
    assert has_forward_mode(cascaded_tanks())
