"""The cascaded-tanks loader: where it looks, what it says, and what it makes of it. Nothing here uses the network."""

import re
import textwrap
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pgrssnn_jax.data.download import download_tanks
from pgrssnn_jax.data.tank_simulator import estimation_and_test
from pgrssnn_jax.data.tanks import load_cascaded_tank
from pgrssnn_jax.physics.tanks import cascaded_tanks

HEADER = '"uEst","uVal","yEst","yVal","Ts",'


def content(rows=400, sample_time="4", header=HEADER):
    numbers = [f"{i},{-i},{i + 0.5},{-i - 0.5},{'' if i else sample_time}," for i in range(rows)]
    return "\r\n".join([header, *numbers, "", ""])


def load(**options):
    return load_cascaded_tank(**{"physics": cascaded_tanks(), **options})


@pytest.fixture
def no_folder(monkeypatch):
    monkeypatch.delenv("PGRSSNN_DATA", raising=False)


@pytest.fixture
def short_records(monkeypatch):
    """Of the simulated plant, whose every sample is many small steps."""
    monkeypatch.setattr("pgrssnn_jax.data.tanks.estimation_and_test", partial(estimation_and_test, n=300))


@pytest.fixture
def fake_package(monkeypatch, tmp_path, no_folder):
    """Puts another `nonlinear_benchmarks` first on the path; the argument is the body of its only function."""

    def fake(body):
        folder = tmp_path / "fake"
        folder.mkdir()
        text = "import numpy as np\nfrom types import SimpleNamespace as Data\ndef Cascaded_Tanks(**options):\n"
        (folder / "nonlinear_benchmarks.py").write_text(text + textwrap.indent(textwrap.dedent(body), "    "))
        monkeypatch.syspath_prepend(folder)

    return fake


GOOD_DOWNLOAD = """
    print("noise on the screen")
    ramp = np.arange(300.0)[:, None]
    return Data(u=ramp, y=ramp + 1, sampling_time=4), Data(u=ramp + 2, y=ramp + 3, sampling_time=4)
"""


def test_the_published_split_of_a_file(tmp_path):
    file = tmp_path / "other.csv"
    file.write_text(content(1024))
    splits = load(path=file)
    assert splits.train.u.shape == splits.train.y.shape == (1, 1, 768, 1)
    assert splits.validation.u.shape == (1, 1, 256, 1)
    assert splits.test.u.shape == (1, 1, 1024, 1)
    np.testing.assert_array_equal(splits.train.u[0, 0, :, 0], np.arange(768))
    np.testing.assert_array_equal(splits.validation.y[0, 0, :, 0], np.arange(768, 1024) + 0.5)
    np.testing.assert_array_equal(splits.test.u[0, 0, :, 0], -np.arange(1024))
    info = splits.train.info
    assert (info.source, info.dt) == ("file", 4.0)
    assert re.fullmatch("other.csv, sha256 [0-9a-f]{12}…, not the published benchmark", info.origin)
    assert info == splits.test.info
    assert splits.validation.info == replace(info, begins=768)


def test_less_training_data_is_taken_from_the_front(tmp_path):
    (tmp_path / "a.csv").write_text(content())
    splits = load(path=str(tmp_path / "a.csv"), n_train=10, n_validation=5)
    np.testing.assert_array_equal(splits.train.u[0, 0, :, 0], np.arange(10))
    np.testing.assert_array_equal(splits.validation.u[0, 0, :, 0], np.arange(395, 400))


@pytest.mark.data
def test_the_measured_benchmark_is_recognised(data):
    lines = []
    splits = load(notify=lines.append)
    assert splits.train.info.source == "file"
    assert splits.train.info.origin.endswith("the published benchmark (numbers verified)")
    assert splits.train.y[0, 0, 0, 0] == 5.205
    assert splits.test.y[0, 0, 0, 0] == 4.9728
    assert splits.test.y[0, 0, -1, 0] == 3.7179
    assert lines == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param(
            content(header='"uEst","uVal","yEst","level","Ts",'),
            "line 1: column 'yVal': expected a column of this name, found 'uEst', 'uVal', 'yEst', 'level', 'Ts'",
            id="missing column",
        ),
        pytest.param(
            content(sample_time="2"), "line 2: column 'Ts': expected 4 s (the physics' dt), found 2 s", id="Ts"
        ),
        pytest.param(
            content(sample_time=""), "line 2: column 'Ts': expected a finite number, found an empty cell", id="no Ts"
        ),
        pytest.param(
            content().replace("-3,", "NaN,", 1),
            "line 5: column 'uVal': expected a finite number, found 'NaN'",
            id="not finite",
        ),
        pytest.param(content(0), "line 1: expected samples below the header, found none", id="no samples"),
    ],
)
def test_a_bad_file_is_one_sentence_with_its_place(tmp_path, text, expected):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ValueError) as caught:
        load(path=file)
    assert str(caught.value) == f"{file}: {expected}"


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"n_validation": 400}, "data.n_validation: expected between 1 and 399 samples in a.csv.*, found 400"),
        ({"n_train": 145}, "data.n_train: expected between 1 and 144 samples before the 256 for validation, found 145"),
        ({"n_train": 0}, "data.n_train: expected between 1 and 144 .*, found 0"),
        ({"generated": True}, "data.generated: expected false where data.path names a file, found true"),
        ({"seed": -1}, "data.seed: expected between 0 .*, found -1"),
        ({"physics": cascaded_tanks(dt=2.0)}, r".*a.csv: line 2: column 'Ts': expected 2 s .*, found 4 s"),
    ],
)
def test_bad_options(tmp_path, options, expected):
    (tmp_path / "a.csv").write_text(content())
    with pytest.raises(ValueError, match=f"^{expected}$"):
        load(path=tmp_path / "a.csv", **options)


def test_a_named_file_must_be_there(tmp_path):
    with pytest.raises(ValueError, match="no.csv: expected a readable CSV file, found no such file"):
        load(path=tmp_path / "no.csv")


def test_the_variable_must_name_a_folder(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    for name, found in (("file", "a file"), ("nowhere", "nothing there")):
        monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path / name))
        with pytest.raises(ValueError, match=f"PGRSSNN_DATA: expected the folder that holds the data, found {found}"):
            load()


def test_the_file_under_the_variable_is_used(tmp_path, monkeypatch):
    (tmp_path / "cascaded_tanks").mkdir()
    (tmp_path / "cascaded_tanks" / "dataBenchmark.csv").write_text(content())
    monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path))
    assert load().train.info.origin.startswith("dataBenchmark.csv, ")


def test_a_download_is_used_without_a_word(fake_package, capfd):
    fake_package(GOOD_DOWNLOAD)
    lines = []
    splits = load(notify=lines.append)
    np.testing.assert_array_equal(splits.test.y[0, 0, :, 0], np.arange(300) + 3)
    assert splits.train.info.source == "download"
    assert splits.train.info.origin == "package nonlinear_benchmarks, not the published benchmark"
    assert lines == []
    assert capfd.readouterr() == ("", "")


def test_a_broken_cache_is_fetched_anew(fake_package):
    body = "if not options.get('force_download'):\n    raise KeyError('uEst')\n"
    fake_package(body + textwrap.dedent(GOOD_DOWNLOAD))
    assert download_tanks(30.0)[0].shape == (300, 4)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        pytest.param("raise ValueError('unable to download with urls: [...]')", "unable to download", id="offline"),
        pytest.param("raise OSError('cache is broken\\nbadly')", "badly", id="broken cache"),
        pytest.param("import os; os._exit(3)", "no reason given", id="it dies"),
        pytest.param(GOOD_DOWNLOAD.replace("ramp + 3", "ramp * np.nan"), "expected four columns of finite", id="NaN"),
        pytest.param(GOOD_DOWNLOAD.replace("ramp + 3", "ramp[1:]"), "must match exactly", id="unequal lengths"),
    ],
)
def test_what_goes_wrong_with_a_download_is_one_exception(fake_package, body, reason):
    fake_package(body)
    with pytest.raises(ConnectionError) as caught:
        download_tanks(30.0)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_download_that_hangs_is_ended(fake_package):
    fake_package("import time; time.sleep(60)")
    with pytest.raises(ConnectionError, match=r"no answer within 0.5 s"):
        download_tanks(0.5)


@pytest.mark.usefixtures("short_records")
def test_without_network_a_rig_is_simulated_and_says_so_loudly(fake_package, tmp_path, monkeypatch):
    fake_package("raise ValueError('unable to download')")
    monkeypatch.setenv("PGRSSNN_DATA", str(tmp_path))
    lines = []
    splits, again = load(notify=lines.append, seed=3), estimation_and_test(3, 300)
    np.testing.assert_array_equal(splits.train.y[0, 0, :, 0], again[:-256, 2])
    np.testing.assert_array_equal(splits.test.y[0, 0, :, 0], again[:, 3])
    assert (splits.train.info.source, splits.train.info.origin) == ("simulated", "built-in two-tank simulator, seed 3")
    assert len(lines) == 2
    assert "PGRSSNN_DATA: no cascaded_tanks/dataBenchmark.csv" in lines[0]
    assert "NO MEASURED DATA, USING A SIMULATED TWO-TANK PLANT (seed 3)" in lines[1]
    assert not any("\n" in line for line in lines)


@pytest.mark.usefixtures("no_folder", "short_records")
def test_a_rig_on_demand_needs_neither_word_nor_network():
    lines = []
    assert load(generated=True, notify=lines.append).train.info.source == "simulated"
    assert lines == []


def test_the_rig_has_its_own_sample_time(no_folder):
    with pytest.raises(ValueError, match="physics.dt: expected 4 s, the sample time of the simulated plant, found 2 s"):
        load(generated=True, physics=cascaded_tanks(dt=2.0))
