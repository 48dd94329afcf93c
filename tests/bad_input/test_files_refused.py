"""Files of benchmarks and arms that are missing, cut off, damaged or of something else."""

import io
import os

import numpy as np
import pytest
import scipy.io
from commands import write_benchmark
from sentences import assert_one_sentence, contents, refused

import pgrssnn_jax as pg

# --- MAT files of the measured arm ------------------------------------------------------------------------------------


def mat(**changes):
    """A file of the published layout, one sequence in each part; None leaves an array out."""
    found = {f"{kind}_{part}": np.full((6, 605), 30.0) for kind in "uy" for part in ("train", "val", "test")}
    content = io.BytesIO()
    scipy.io.savemat(content, {key: value for key, value in {**found, **changes}.items() if value is not None})
    return content.getvalue()


WHOLE = mat()
MATS = {
    "an empty file": (b"", "expected a readable MAT file, found"),
    "a text": (b"u_train,y_train\n1,2\n" * 20, "expected a readable MAT file, found"),
    "a file that is cut off": (WHOLE[: len(WHOLE) // 2], ""),
    "the header alone": (WHOLE[:128], "array 'u_train': expected it in the file, found no array"),
    "zeros after the header": (WHOLE[:128] + bytes(500), ""),
    "version 7.3": (b"\x89HDF\r\n\x1a\n" + bytes(600), "expected a MAT file up to version 7.2, found version 7.3"),
    "no test part": (mat(y_test=None), "array 'y_test': expected it in the file, found u_test"),
    "other names": (
        mat(u_train=None, U_train=np.ones((6, 605))),
        "array 'u_train': expected it in the file, found U_tr",
    ),
    "five joints": (mat(u_train=np.ones((5, 605))), "array 'u_train': expected 6 rows, one for each joint"),
    "time along the first axis": (mat(u_train=np.ones((605, 6))), "array 'u_train': expected 6 rows"),
    "half a sequence": (mat(u_val=np.ones((6, 300)), y_val=np.ones((6, 300))), "expected a multiple of 605 columns"),
    "outputs that are shorter": (mat(y_val=np.ones((6, 1210))), "array 'y_val': expected 605 columns, as 'u_val'"),
    "NaN": (
        mat(y_val=np.full((6, 605), np.nan)),
        "array 'y_val': expected finite numbers, found nan in row 1, column 1",
    ),
    "complex numbers": (mat(u_val=np.ones((6, 605)) + 1j), "array 'u_val': expected a matrix of real numbers"),
    "words": (mat(u_val=np.array([["a"]])), "array 'u_val': expected a matrix of real numbers"),
    "radians": (
        mat(**{f"y_{part}": np.ones((6, 605)) for part in ("train", "val", "test")}),
        "expected degrees, found no",
    ),
}


@pytest.mark.parametrize(("content", "words"), MATS.values(), ids=MATS)
def test_a_bad_mat_file_is_refused(folder, content, words):
    (folder / "arm.mat").write_bytes(content)
    refused(lambda: pg.load_benchmark("robot_real", path="arm.mat"), "arm.mat: ", words)


def test_a_mat_file_that_cannot_be_read_is_named(folder):
    refused(
        lambda: pg.load_benchmark("robot_real", path="none.mat"), "none.mat: expected a MAT file, found no such file"
    )
    refused(lambda: pg.load_benchmark("robot_real", path="."), "expected a readable MAT file, found")
    refused(lambda: pg.load_benchmark("robot_simulated", path="."), "0.mat: expected a MAT file, found no such file")


# --- NPZ and CSV logs of arms -----------------------------------------------------------------------------------------


def npz(**changes):
    time = np.arange(40) * 0.1
    found = {"time": time, "position": np.sin(time)[:, None] * np.ones(6), "torque": np.ones((40, 6)), **changes}
    content = io.BytesIO()
    np.savez(content, **{key: value for key, value in found.items() if value is not None})
    return content.getvalue()


PICKLED = io.BytesIO()
np.save(PICKLED, np.array([{}], object), allow_pickle=True)
ARRAYS = {"position": "position", "torque": "torque"}
GOOD = npz()
LOGS = {
    "an empty file": (b"", ARRAYS, "expected a readable NPZ file, found"),
    "a text": (b"time,torque\n", ARRAYS, "expected a readable NPZ file, found"),
    "a file that is cut off": (GOOD[: len(GOOD) // 2], ARRAYS, "expected a readable NPZ file, found"),
    "a damaged file": (GOOD.replace(b"NUMPY", b"NUMPX"), ARRAYS, "expected a readable NPZ file, found"),
    "one array alone": (PICKLED.getvalue(), ARRAYS, "expected a readable NPZ file, found"),
    "no torque": (npz(torque=None), ARRAYS, "expected an array 'torque', found none"),
    "no time": (npz(time=None), ARRAYS, "expected an array 'time', found none"),
    "an array that is not there": (GOOD, {**ARRAYS, "position": "q"}, "expected an array 'q', found none"),
    "five joints": (npz(torque=np.ones((40, 5))), ARRAYS, "'torque': expected [time, 6] or [sequence, time, 6]"),
    "arrays of two lengths": (npz(torque=np.ones((39, 6))), ARRAYS, "expected arrays of one shape, found (1, 40, 6)"),
    "a short time": (npz(time=np.arange(39) * 0.1), ARRAYS, "'time': expected shape (1, 40), found (39,)"),
    "NaN": (npz(torque=np.full((40, 6), np.nan)), ARRAYS, "array 'torque': expected finite numbers, found NaN"),
    "words": (npz(torque=np.full((40, 6), "a")), ARRAYS, "expected"),
    "complex numbers": (
        npz(torque=np.ones((40, 6)) + 1j),
        ARRAYS,
        "array 'torque': expected real numbers, found complex",
    ),
    "times that stand still": (npz(time=np.zeros(40)), ARRAYS, "time: expected times that grow"),
    "samples that are too far apart": (npz(time=np.arange(40) * 1.0), ARRAYS, "expected a sample every 0.1 s"),
    "a gap": (npz(time=np.r_[np.arange(20), np.arange(25, 45)] * 0.1), ARRAYS, "expected gaps up to 0.1 s"),
    "few samples": (
        npz(time=np.arange(4) * 0.1, position=np.ones((4, 6)), torque=np.ones((4, 6))),
        ARRAYS,
        "at least 16",
    ),
    "five names": (GOOD, {**ARRAYS, "torque": list("abcde")}, "expected one column per joint, 6"),
    "another unit": (GOOD, {**ARRAYS, "position_unit": "turns"}, "load_arm_log.position_unit: expected rad | deg"),
    "a transmission of two joints": (
        GOOD,
        {**ARRAYS, "transmission": [1.0, 2.0]},
        "data.transmission: expected 6 ratios",
    ),
    "a transmission of zero": (GOOD, {**ARRAYS, "transmission": [0.0] * 6}, "data.transmission: expected 6 ratios"),
    "no sample time": (GOOD, {**ARRAYS, "time": None}, "data.sample_time: expected s per sample"),
    "a cut-off that is too high": (GOOD, {**ARRAYS, "cutoff": 50.0}, "cutoff: expected more than 0 and less than 5 Hz"),
    "a test part of everything": (GOOD, {**ARRAYS, "test_share": 1.0}, "data.test_share: expected more than 0"),
    "a setting that there is not": (GOOD, {"positions": "q"}, "load_arm_log: expected the keys"),
}


@pytest.fixture(scope="module")
def arm():
    return pg.physics.arm()


@pytest.mark.parametrize(("content", "settings", "words"), LOGS.values(), ids=LOGS)
def test_a_bad_log_is_refused(folder, arm, content, settings, words):
    (folder / "log.npz").write_bytes(content)
    refused(lambda: pg.load_arm_log(arm, "log.npz", **settings), words)


def test_a_csv_log_names_its_column(folder, arm):
    (folder / "log.csv").write_text("time,position_1\n0,1\n0.1,1\n")
    refused(
        lambda: pg.load_arm_log(arm, "log.csv"), "data.train: log.csv: line 1: column 'position_2': expected a column"
    )
    refused(
        lambda: pg.load_arm_log(arm, "none.csv"), "data.train: none.csv: expected a readable CSV file, found no such"
    )
    refused(lambda: pg.load_arm_log(arm, "none.npz"), "data.train: none.npz: expected a readable NPZ file, found")


# --- the benchmark of the tanks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("yEst", "y", "column 'yEst': expected a column of this name"),
        ("Ts", "T", "column 'Ts': expected a column of this name"),
        (",4,\n", ",1,\n", "line 2: column 'Ts': expected 4 s (the physics' dt), found 1 s"),
        (",4,\n", ",,\n", "line 2: column 'Ts': expected a finite number, found an empty cell"),
        (",", ";", "line 1: expected commas between columns, found semicolons"),
    ],
)
def test_a_benchmark_of_another_layout_is_refused(folder, old, new, words):
    file = write_benchmark(folder / "tanks.csv", samples=300)
    file.write_text(file.read_text().replace(old, new))
    refused(lambda: pg.load_benchmark("cascaded_tank", path="tanks.csv"), "tanks.csv: ", words)
    write_benchmark(file, samples=300)
    settings = {"path": "tanks.csv", "n_validation": 300}
    refused(lambda: pg.load_benchmark("cascaded_tank", **settings), "data.n_validation: expected between 1 and 299")


# --- URDF files -------------------------------------------------------------------------------------------------------

LINK = (
    '<link name="{}"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="one" type="{}"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
)
URDF = f'<robot name="r">{LINK.format("a")}{LINK.format("b")}{JOINT.format("revolute")}</robot>'
URDFS = {
    "an empty file": ("", {}, "expected a URDF that Pinocchio can read, found"),
    "no XML": ("joint: one", {}, "expected a URDF that Pinocchio can read, found"),
    "a file that is cut off": (URDF[:150], {}, "expected a URDF that Pinocchio can read, found"),
    "another kind of XML": ("<svg/>", {}, "expected a URDF that Pinocchio can read, found"),
    "a link that is not there": (URDF.replace('link="b"', 'link="c"'), {}, "expected a URDF that Pinocchio can read"),
    "a slide": (
        URDF.replace("revolute", "prismatic"),
        {},
        "joint 'one': expected a revolute joint, found a prismatic one",
    ),
    "no joint that moves": (URDF.replace("revolute", "fixed"), {}, "expected at least one revolute joint, found none"),
    "a lock that is not there": (URDF, {"lock": ["two"]}, "physics.lock: expected names among ['one'], found 'two'"),
    "a lock that is no list": (URDF, {"lock": "one"}, "physics.lock: expected a list of joint names"),
    "ratios of two joints": (URDF, {"gear_ratio": [1.0, 2.0]}, "gear_ratio: expected one number or 1, one per joint"),
}


@pytest.mark.parametrize(("content", "settings", "words"), URDFS.values(), ids=URDFS)
def test_a_bad_urdf_is_refused(folder, content, settings, words, capfd):
    (folder / "robot.urdf").write_text(content)
    refused(lambda: pg.physics.arm(urdf="robot.urdf", **settings), "physics.", words)
    assert capfd.readouterr().err == ""
    os.write(2, b"said later")
    assert capfd.readouterr() == ("", "said later")


def test_an_arm_of_other_joints_than_the_data_is_refused(folder):
    (folder / "robot.urdf").write_text(URDF)
    arm = pg.physics.arm(urdf="robot.urdf")
    before = contents(folder)
    with pytest.raises(ValueError) as caught:
        pg.load_benchmark("robot_simulated", generated=True, realisations=1, physics=arm)
    assert_one_sentence(str(caught.value), "physics: expected 6 inputs and 6 outputs", "found 1 and 1")
    assert contents(folder) == before
    refused(
        lambda: pg.physics.arm(urdf="none.urdf"), "physics.urdf: expected a URDF file, found no such file: none.urdf"
    )
    refused(lambda: pg.physics.arm(urdf="."), "physics.urdf: expected a URDF file, found a folder")
