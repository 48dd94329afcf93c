"""Training on arms as a user does it: small generated data, every configuration, own files, bad input."""

import json

import numpy as np
import pytest
from commands import QUICK, ROOT, called, composed, config_names, planned, trained, without_pictures

from pgrssnn_jax.data.arm_simulator import simulated_arm
from pgrssnn_jax.physics.arms.tables import described

SMALL = ["data.generated=true", "data.n_train=3", "data.n_validation=1", "data.n_test=2", "data.n_samples=25"]
SIMULATED = ["+experiment=robot_simulated", "data.realisations=1"]
TINY = ["model.gru_layers=1", *QUICK]
TORQUES, POSITIONS = ([f"{name}_{i + 1}" for i in range(6)] for name in ("torque", "position"))


def metrics_of(run) -> dict:
    return json.loads((run.path / "metrics.json").read_text())


def predictions_of(run) -> dict:
    return run.read_arrays("predictions.npz")


ARMS = [name for name in config_names("physics") if name.startswith("arm")]


@pytest.mark.compiles
@pytest.mark.parametrize("physics", ARMS)
def test_every_arm_physics_runs_on_every_dataset(tmp_path, physics):
    overrides = ["data.realisations=2", f"physics={physics}", *SMALL, "model=physics_only"]
    metrics = metrics_of(trained(tmp_path / "run", "+experiment=robot_simulated", *overrides))
    assert [m["dataset"] for m in metrics["members"]] == [0, 1]
    assert metrics["summary"]["failed"] == 0
    assert [output["name"] for output in metrics["outputs"]] == POSITIONS


@pytest.mark.compiles
def test_both_backends_predict_the_same_untrained_arm_that_starts_at_rest_at_zero(tmp_path):
    found = []
    for backend in ("jax", "pinocchio"):
        overrides = [*SMALL, "model=physics_only", f"physics.backend={backend}"]
        arrays = predictions_of(trained(tmp_path / backend, "+experiment=robot_real", *overrides))
        assert not arrays["x0"].any()
        found.append(arrays["y_hat"])
    np.testing.assert_allclose(*found, atol=2e-4)  # rad; float32, and friction switches its sign at standstill


@pytest.mark.compiles
def test_the_pinocchio_backend_trains_on_two_devices(tmp_path):
    overrides = [*SMALL, *TINY, "physics.backend=pinocchio", "physics.physics_gradient=full", "members.devices=2"]
    assert metrics_of(trained(tmp_path / "run", "+experiment=robot_real", *overrides))["summary"]["finished"] == 2


@pytest.mark.compiles
def test_a_trained_run_shows_the_arm(tmp_path):
    run = trained(tmp_path / "run", "+experiment=robot_real", *SMALL, *TINY, "physics.physics_gradient=stopped")
    assert metrics_of(run)["summary"]["finished"] == 2
    arrays = predictions_of(run)
    for name in ("measured", "predicted"):
        assert arrays[f"skeleton_{name}"].shape == (2, 25, 8, 3)
    assert np.isfinite(arrays["skeleton_predicted"]).all()
    assert (run.path / "figures/arm.png").exists()
    assert "<svg" in (run.path / "report.html").read_text()


def test_velocities_have_a_scale_of_their_own_and_no_offset():
    scaling = planned("+experiment=robot_simulated", "data.realisations=1", *SMALL).plan.data.scaling
    assert not scaling.x.offset[:, 6:].any()
    assert np.abs(scaling.x.offset[:, :6]).min() > 0
    assert (scaling.x.scale[:, 6:] != scaling.x.scale[:, :6]).all()


@pytest.mark.compiles
def test_published_scaling_gives_velocities_the_positions_units_and_starts_at_their_mean(tmp_path):
    overrides = ["data.realisations=1", "data.published_scaling=true", "initial_state=scaled_zero", *SMALL]
    plan = planned("+experiment=robot_simulated", *overrides).plan
    scaling = plan.data.scaling.x
    np.testing.assert_array_equal(scaling.offset[:, 6:], scaling.offset[:, :6])
    np.testing.assert_array_equal(scaling.scale[:, 6:], scaling.scale[:, :6])
    run = trained(tmp_path / "run", "+experiment=robot_simulated", *overrides, "model=physics_only")
    np.testing.assert_allclose(predictions_of(run)["x0"][0, 0], scaling.offset[0], rtol=1e-6)


def write_arm_csv(path, *, degrees=False, joints=6):
    data = simulated_arm(0, 2, 40)
    q = np.degrees(data.y[0]) if degrees else data.y[0]
    names = ["sequence", *TORQUES[:joints], *POSITIONS[:joints]]
    rows = [
        [s + 1, *data.u[s, t, :joints], *q[s, t, :joints]] for s in range(len(data.u)) for t in range(data.u.shape[1])
    ]
    path.write_text("\n".join(",".join(map(str, row)) for row in [names, *rows]) + "\n")
    return path


@pytest.mark.compiles
def test_own_arm_data_comes_as_columns_and_what_was_not_measured_has_no_pose(tmp_path):
    file = write_arm_csv(tmp_path / "arm.csv")
    short = tmp_path / "short.csv"
    lines = file.read_text().splitlines()
    short.write_text("\n".join(lines[:-10]) + "\n")  # the second sequence ends early
    data = ["data=csv", f"data.train={file}", f"data.test={short}", "recipe=default"]
    with without_pictures():
        run = trained(tmp_path / "run", "physics=arm", *data, "initial_state=zero", "model=physics_only")
    metrics = metrics_of(run)
    assert metrics["summary"]["finished"] == 1
    assert {output["unit"] for output in metrics["outputs"]} == {"rad"}
    poses = predictions_of(run)["skeleton_measured"]
    assert np.isfinite(poses[0]).all()
    assert np.isnan(poses[1, -10:]).any(axis=(1, 2)).all()


def test_degrees_are_found_by_their_range(tmp_path):
    file = write_arm_csv(tmp_path / "arm.csv", degrees=True)
    with pytest.raises(ValueError, match=r"data: train: position_\d: expected .* rad, found .*: are they in rad\?"):
        planned("physics=arm", "data=csv", f"data.train={file}", f"data.test={file}")


def test_positions_within_the_limits_and_their_noise_are_taken(tmp_path):
    tables = described("kuka_kr300")
    file = write_arm_csv(tmp_path / "arm.csv")
    y = planned("physics=arm", "data=csv", f"data.train={file}", f"data.test={file}").test.y
    assert (y <= tables.position_max + 1).all()


def test_columns_of_another_arm_are_one_sentence(tmp_path):
    file = write_arm_csv(tmp_path / "arm.csv", joints=4)
    code, _, err = called("physics=arm", "data=csv", f"data.train={file}", f"data.test={file}", cwd=tmp_path)
    assert code == 2
    assert err.count("\n") == 1
    assert "torque_5" in err


def test_a_urdf_of_a_gripper_is_one_sentence(tmp_path):
    urdf = tmp_path / "slide.urdf"
    urdf.write_text(
        """<robot name="slide"><link name="base"/><link name="sled"><inertial><mass value="1"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="rail" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="1 0 0"/>
        <limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""
    )
    file = write_arm_csv(tmp_path / "arm.csv")
    data = ["data=csv", f"data.train={file}", f"data.test={file}"]
    code, _, err = called("physics=arm", f"physics.urdf={urdf}", *data, cwd=tmp_path)
    assert code == 2
    assert "rail" in err
    assert "prismatic" in err
    assert err.count("\n") == 1


@pytest.mark.compiles
def test_an_estimated_start_is_found_through_the_arm(tmp_path):
    overrides = [*SMALL, "model=physics_only", "initial_state=estimated", "n_init=3", "data.n_test=1"]
    x0 = predictions_of(trained(tmp_path / "run", "+experiment=robot_real", *overrides))["x0"]
    assert np.isfinite(x0).all()
    assert np.abs(x0[0, 0, :6]).max() < 0.02  # rad; the generated arm starts at zero, its encoder errs by 1e-4


@pytest.mark.parametrize("more", ["fit.physics_parameters=trained", "initial_state=estimated"])
def test_what_needs_the_gradient_of_the_physics_is_refused_without_it(more):
    with pytest.raises(ValueError, match=f"physics_gradient: expected full with {more}, "):
        planned("+experiment=robot_real", *SMALL, "physics.physics_gradient=stopped", more)


def test_the_joints_of_a_urdf_are_named_in_their_order(tmp_path):
    pendulum = """<link name="{0}"><inertial><mass value="1"/><origin xyz="0 0 1"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="to_{0}" type="continuous"><parent link="base"/><child link="{0}"/><axis xyz="1 0 0"/></joint>"""
    urdf = tmp_path / "two.urdf"
    urdf.write_text(f'<robot name="two"><link name="base"/>{pendulum.format("zz")}{pendulum.format("aa")}</robot>')
    data = tmp_path / "two.csv"
    rows = [",".join(map(str, row)) for row in np.random.default_rng(0).normal(size=(20, 4))]
    data.write_text("\n".join(["torque_1,torque_2,position_1,position_2", *rows]) + "\n")
    lines = []
    overrides = [f"physics.urdf={urdf}", "data=csv", f"data.train={data}", f"data.test={data}"]
    plan = planned("physics=arm", *overrides, notify=lines.append).plan
    assert "joints of two: 1 to_aa, 2 to_zz" in lines
    assert plan.fit.objective.model.physics.skeleton is None  # two arms on one base are no line


@pytest.mark.data
@pytest.mark.parametrize(
    ("overrides", "nrmse"),
    [
        pytest.param([*SIMULATED, "physics=arm_model1"], (0.52, 0.54), marks=pytest.mark.compiles),
        pytest.param([*SIMULATED, "physics=arm_model2"], (0.80, 0.81), marks=pytest.mark.compiles),
        pytest.param([*SIMULATED, "physics=arm_true"], (0.32, 0.33), marks=pytest.mark.compiles),
        pytest.param(["+experiment=robot_real"], (3.2, 3.32), marks=pytest.mark.compiles),
    ],
)
def test_the_published_figures_of_the_physics_alone(tmp_path, data, overrides, nrmse):
    with without_pictures():
        summary = metrics_of(trained(tmp_path / "run", *overrides, "model=physics_only"))["summary"]
    assert nrmse[0] <= summary["nrmse_mean"] <= nrmse[1]


def test_the_published_networks_of_the_arm():
    for experiment in ("robot_real", "robot_simulated"):
        config = composed(f"+experiment={experiment}")
        assert (config["model"]["hidden"], config["model"]["gru_layers"]) == (64, 3)
        assert config["fit"]["epochs"] <= 200


@pytest.mark.compiles
def test_a_filter_takes_the_numbers_of_a_file_or_those_of_the_record(tmp_path):
    small = [*SMALL, "data.n_samples=80", "model=physics_only"]
    ways = {"stored": ["+experiment=robot_real_filter"], "record": ["+experiment=robot_real", "physics.form=filter"]}
    numbers = {}
    for name, way in ways.items():
        run = trained(tmp_path / name, *way, *small)
        assert metrics_of(run)["summary"]["failed"] == 0
        saved = json.loads((run.path / "physics.json").read_text())
        assert saved["physics"]["form"] == "filter"
        numbers[name] = saved["physics"]["filter_numbers"]
    shipped = json.loads((ROOT / "conf/physics/robot_real_filter.json").read_text())
    assert numbers["stored"] == shipped["physics"]["filter_numbers"]
    assert numbers["record"]["position"] != numbers["stored"]["position"]
