"""The arm's loaders: where they look, what they say, and what they make of it. Nothing here uses the network."""

import re
import textwrap

import numpy as np
import pytest
import scipy.io

from pgrssnn_jax.data.arm_simulator import ArmSimulator, simulated_arm
from pgrssnn_jax.data.download import download_robot
from pgrssnn_jax.data.robot import load_robot_real, load_robot_simulated
from pgrssnn_jax.physics.base import Signal, discrete

REAL = "robot_real/forward_identification_without_raw_data_shifted.mat"
SIMULATED = "1010m_vary_sim_position_noiseTorque{}.mat"


def toy(joints=6, dt=0.1):
    """An arm of a kind: every torque turns its joint."""
    return discrete(
        "toy",
        lambda params, x, u: x + params["gain"] * u,
        lambda params, x, u: x,
        {"gain": 0.1},
        states=tuple(Signal(f"position_{i + 1}", "rad", like=f"position_{i + 1}") for i in range(joints)),
        inputs=tuple(Signal(f"torque_{i + 1}", "Nm") for i in range(joints)),
        outputs=tuple(Signal(f"position_{i + 1}", "rad") for i in range(joints)),
        dt=dt,
    )


def real(**options):
    return load_robot_real(**{"physics": toy(), **options})


def simulated(**options):
    return load_robot_simulated(**{"physics": toy(), "realisations": 2, **options})


def write(file, samples, start=0, counts=(3, 2, 2)):
    """Every u tells its sequence, sample and joint; y is its negative, in degrees."""
    arrays = {}
    for part, count in zip(("train", "val", "test"), counts, strict=True):
        u = start + np.arange(count * samples) + np.arange(6)[:, None] / 10
        arrays |= {f"u_{part}": u, f"y_{part}": -u}
        start += 10**5
    file.parent.mkdir(exist_ok=True)
    scipy.io.savemat(file, arrays)
    return file


@pytest.fixture
def no_folder(monkeypatch):
    monkeypatch.delenv("PGRSSNN_DATA", raising=False)


@pytest.fixture
def variable(monkeypatch, tmp_path):
    """An empty folder that PGRSSNN_DATA names."""
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def fake_package(monkeypatch, tmp_path, no_folder):
    """Puts another `nonlinear_benchmarks` first on the path; the argument is the body of its only function."""

    def fake(body):
        (tmp_path / "fake").mkdir()
        begin = "import numpy as np\nfrom types import SimpleNamespace as Data\ndef load(**options):\n"
        end = "\nnot_splitted_benchmarks = Data(Industrial_robot=load)\n"
        text = begin + textwrap.indent(textwrap.dedent(body), "    ") + end
        (tmp_path / "fake" / "nonlinear_benchmarks.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path / "fake")

    return fake


def good(train=66, test=6, samples=606):
    """A download whose u tells sequence and sample, and whose y is its negative."""
    return f"""
    print("noise on the screen")
    ramp = np.arange({samples}.0)[:, None] + np.arange(6) / 10
    make = lambda first, count: [Data(u=ramp + 1000 * (first + i), y=-ramp - 1000 * (first + i)) for i in range(count)]
    return make(0, {train}), make(500, {test})
    """


def test_a_file_for_the_measured_arm(tmp_path):
    splits = real(path=write(tmp_path / "a.mat", 605))
    assert splits.train.u.shape == splits.train.y.shape == splits.train.mask.shape == (1, 3, 605, 6)
    assert splits.validation.u.shape == splits.test.u.shape == (1, 2, 605, 6)
    assert splits.train.u[0, 1, 2, 3] == 605 + 2 + 0.3
    for part in splits:
        np.testing.assert_allclose(np.rad2deg(part.y), -part.u)
    info = splits.train.info
    assert info.inputs == tuple((f"torque_{i}", "Nm") for i in range(1, 7))
    assert info.outputs == tuple((f"position_{i}", "rad") for i in range(1, 7))
    assert (info.source, info.dt) == ("file", 0.1)
    assert re.fullmatch("a.mat, sha256 [0-9a-f]{12}…", info.origin)
    assert info == splits.validation.info == splits.test.info


def test_files_for_the_simulated_arm(tmp_path):
    for i in range(2):
        write(tmp_path / SIMULATED.format(i), 606, start=i * 10**6)
    splits = simulated(path=tmp_path)
    assert splits.train.u.shape == (2, 3, 606, 6)
    assert splits.validation.y.shape == splits.test.mask.shape == (2, 2, 606, 6)
    np.testing.assert_array_equal(splits.train.u[1], splits.train.u[0] + 10**6)
    assert splits.test.info.source == "file"
    assert re.fullmatch(r".*Torque0\.\.1.mat, sha256 of their digests [0-9a-f]{12}…", splits.test.info.origin)


def test_less_data_are_taken_from_the_front(tmp_path):
    file = write(tmp_path / "a.mat", 605)
    part = real(path=file, n_train=1, n_validation=2, n_test=1, n_samples=7)
    for a, b, count in zip(real(path=file), part, (1, 2, 1), strict=True):
        np.testing.assert_array_equal(a.u[:, :count, :7], b.u, strict=True)
        np.testing.assert_array_equal(a.y[:, :count, :7], b.y)


@pytest.mark.data
def test_the_measured_sequences(data):
    lines = []
    splits = real(notify=lines.append)
    assert [part.u.shape for part in splits] == [(1, n, 605, 6) for n in (60, 6, 6)]
    assert splits.train.info.source == "file"
    for part in splits:
        assert np.abs(part.y[:, :, 0]).max() < 1e-3
        assert np.abs(part.y).max() < np.pi
    assert lines == []


@pytest.mark.data
def test_the_published_simulated_sequences(data):
    lines = []
    splits = simulated(notify=lines.append)
    assert [part.u.shape for part in splits] == [(2, n, 606, 6) for n in (60, 6, 6)]
    np.testing.assert_array_equal(splits.test.u[0], splits.test.u[1])
    # Realisations differ by their noise alone where they start.
    assert np.std(splits.train.y[0, :, :3] - splits.train.y[1, :, :3]) == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert lines == []


def test_without_network_an_arm_is_simulated_and_says_so_loudly(fake_package, variable):
    fake_package("raise Exception('Download failed after 5 attempts: no route')")
    lines = []
    splits, again = real(notify=lines.append, seed=3), simulated_arm(3, 72, 605, 1, ArmSimulator(noise=1e-4))
    np.testing.assert_array_equal(np.concatenate([part.u[0] for part in splits]), again.u)
    np.testing.assert_array_equal(np.concatenate([part.y for part in splits], axis=1), again.y)
    assert (splits.train.info.source, splits.train.info.origin) == ("simulated", "built-in simulated arm, seed 3")
    assert lines == [
        f"data: PGRSSNN_DATA: no {REAL} in that folder, trying a download instead",
        "data: NO MEASURED DATA, USING A SIMULATED ARM (seed 3): the download failed (Exception: Download failed after "
        "5 attempts: no route); for measured data set data.path=FILE.mat or PGRSSNN_DATA",
    ]


def test_files_under_the_variable_are_used(variable):
    write(variable / REAL, 605)
    for i in range(2):
        write(variable / "robot_simulated" / SIMULATED.format(i), 606)
    lines = []
    assert real(notify=lines.append).train.info.origin.startswith("forward_identification_without_raw_data_shifted.mat")
    assert simulated(notify=lines.append).train.info.source == "file"
    assert lines == []


@pytest.mark.parametrize("is_set", [True, False])
def test_realisations_nobody_asked_to_generate_are_announced(variable, monkeypatch, is_set):
    monkeypatch.setenv("PGRSSNN_DATA", str(variable) if is_set else "")
    lines = []
    splits = simulated(notify=lines.append, realisations=1)
    assert (splits.train.info.source, splits.train.info.origin) == ("simulated", "generated, seed 0")
    reason = "no folder robot_simulated under PGRSSNN_DATA" if is_set else "PGRSSNN_DATA is not set"
    assert lines == [f"data: NO PUBLISHED DATA, GENERATING THE REALISATIONS (seed 0): {reason}"]


def test_generated_realisations(variable):
    write(variable / REAL, 605)
    lines = []
    splits = simulated(generated=True, notify=lines.append)
    assert [part.y.shape for part in splits] == [(2, n, 606, 6) for n in (60, 6, 6)]
    np.testing.assert_array_equal(splits.train.u[0], splits.train.u[1])
    assert not np.array_equal(splits.train.y[0], splits.train.y[1])
    np.testing.assert_array_equal(simulated(generated=True, realisations=1).train.y[0], splits.train.y[0])
    assert real(generated=True, notify=lines.append).test.y.shape == (1, 6, 605, 6)
    assert lines == []


def test_a_download_is_aligned_split_and_used_without_a_word(fake_package, capfd):
    fake_package(good())
    lines = []
    splits = real(notify=lines.append)
    assert [part.u.shape for part in splits] == [(1, n, 605, 6) for n in (60, 6, 6)]
    for part, first in zip(splits, (0, 60, 500), strict=True):
        np.testing.assert_array_equal(part.u[0, :, 0, 0], 1000 * (first + np.arange(part.u.shape[1])))
        np.testing.assert_allclose(np.rad2deg(part.y), -part.u - 1)
    assert splits.train.info.origin == "package nonlinear_benchmarks"
    assert lines == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("there", "expected"),
    [((65, 9), (59, 6, 6)), ((70, 2), (60, 6, 2)), ((5, 1), (3, 2, 1)), ((2, 1), (1, 1, 1))],
)
def test_of_other_downloads_as_much_as_there_is(monkeypatch, no_folder, there, expected):
    train, test = (np.arange(count)[:, None, None] + np.zeros((count, 4, 12)) for count in there)
    monkeypatch.setattr("pgrssnn_jax.data.robot.download_robot", lambda timeout: (train, test))
    splits = real()
    assert tuple(part.u.shape[1] for part in splits) == expected
    assert splits.validation.u[0, -1, 0, 0] == there[0] - 1


def test_a_single_training_sequence_is_no_download(fake_package):
    fake_package(good(train=1))
    lines = []
    assert real(notify=lines.append).train.info.source == "simulated"
    assert "the download failed (expected at least two training sequences, found 1)" in lines[0]


def test_a_broken_cache_is_fetched_anew(fake_package):
    fake_package("if not options.get('force_download'):\n    raise OSError('cut off')\n" + textwrap.dedent(good(3, 1)))
    train, test = download_robot(30.0)
    assert (train.shape, test.shape) == ((3, 606, 12), (1, 606, 12))


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        pytest.param("raise Exception('Download failed after 5 attempts: x')", "Download failed after", id="offline"),
        pytest.param("return [], []", "need at least one array", id="nothing"),
        pytest.param(good(2, 1).replace("+ 1000", "+ np.nan"), "expected sequences of twelve columns", id="NaN"),
        pytest.param(good(2, 1, samples=1), "expected sequences of twelve columns", id="too short to align"),
        pytest.param(good(2, 1).replace("np.arange(6)", "np.arange(5)"), "expected sequences of twelve", id="joints"),
    ],
)
def test_what_goes_wrong_with_a_download_is_one_exception(fake_package, body, reason):
    fake_package(body)
    with pytest.raises(ConnectionError) as caught:
        download_robot(30.0)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("load", [real, simulated])
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"path": "a.mat"}, "data.generated: expected false where data.path names a (file|folder), found true"),
        ({"seed": -1}, "data.seed: expected between 0 .*, found -1"),
        ({"physics": toy(dt=0.2)}, "physics.dt: expected 0.1 s, the sample time of the arm's data, found 0.2 s"),
        ({"physics": toy(2)}, "physics: expected 6 inputs and 6 outputs, the joints of the arm .*, found 2 and 2"),
    ],
)
def test_bad_options(load, options, expected):
    with pytest.raises(ValueError, match=f"^{expected}$"):
        load(generated=True, **options)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"n_train": 4}, "data.n_train: expected between 1 and 3 train sequences in a.mat, sha256 .*, found 4"),
        ({"n_validation": 0}, "data.n_validation: expected between 1 and 2 validation sequences in .*, found 0"),
        ({"n_test": 3}, "data.n_test: expected between 1 and 2 test sequences in .*, found 3"),
        ({"n_samples": 606}, "data.n_samples: expected between 1 and 605 samples per sequence in .*, found 606"),
    ],
)
def test_more_than_there_is(tmp_path, options, expected):
    with pytest.raises(ValueError, match=f"^{expected}$"):
        real(path=write(tmp_path / "a.mat", 605), **options)


def test_bad_files_and_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path / "nowhere"))
    for load in (real, simulated):
        with pytest.raises(ValueError, match="PGRSSNN_DATA: expected the folder that holds the data, found nothing"):
            load()
    with pytest.raises(ValueError, match="no.mat: expected a MAT file, found no such file"):
        real(path=tmp_path / "no.mat")
    with pytest.raises(ValueError, match="expected a multiple of 605 columns, the samples of a sequence, found 1818"):
        real(path=write(tmp_path / "a.mat", 606))
    with pytest.raises(ValueError, match=r"data.path: expected the folder .*, found no folder: nowhere"):
        simulated(path="nowhere")
    with pytest.raises(ValueError, match=r"data.realisations: expected between 1 and 1000 datasets, found 0"):
        simulated(realisations=0)


def test_every_realisation_needs_its_file_of_equal_size(tmp_path):
    write(tmp_path / SIMULATED.format(0), 606)
    with pytest.raises(ValueError, match=r"Torque1.mat: expected a MAT file, found no such file"):
        simulated(path=tmp_path)
    write(tmp_path / SIMULATED.format(1), 606, counts=(3, 1, 2))
    with pytest.raises(ValueError, match=r"Torque1.mat: sequences: expected \(3, 2, 2\) .*, found \(3, 1, 2\)"):
        simulated(path=tmp_path)
