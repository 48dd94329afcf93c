"""Whatever happens to a good file, its reader works or raises `ValueError` with one sentence."""

import copy
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sentences import assert_one_sentence, tanks
from stored_run import copied, save, use

import pgrssnn_jax as pg
from pgrssnn_jax.effects.stored import physics_to_json, read_stored, stored_physics

SHARED = {"deadline": None, "derandomize": True, "database": None}
SHARED["suppress_health_check"] = [HealthCheck.function_scoped_fixture]  # the current folder, which nothing is put into
LINES = [f"{4 * t},{'a' if t < 6 else 'b'},{2 + t % 3},{4 + t % 5},1" for t in range(12)]
TABLE = "\n".join(["time,sequence,pump_voltage,level_voltage,mask", *LINES]).encode()
CELLS = st.sampled_from(
    [b"", b"nan", b"inf", b"1e400", b"-1", b"0", b"\xff", b'"', b'"\n', b"\x00", b",", b";", b"1_0"]
)
ODD = [-1, 0, 0.5, 10**400, float("nan"), float("inf"), "", "x", "\n", "é"]
GROUPS = st.dictionaries(st.sampled_from(["a", "k1", "rate"]), st.integers(), max_size=2)
VALUES = st.one_of(st.none(), st.booleans(), st.sampled_from(ODD), st.lists(st.integers(-1, 2), max_size=3), GROUPS)


def outcome(read) -> None:
    """Anything but a result or one sentence is a defect."""
    try:
        read()
    except ValueError as problem:
        assert_one_sentence(str(problem))


@st.composite
def mangled(draw, content: bytes) -> bytes:
    """Bytes flipped, cut off, taken out, put twice; lines dropped and exchanged."""
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(["flip", "cut", "drop", "twice", "lines", "swap"]))
        at, to = sorted((draw(st.integers(0, len(content))), draw(st.integers(0, len(content)))))
        if how == "flip":
            content = content[:at] + bytes([draw(st.integers(0, 255))]) + content[at + 1 :]
        elif how == "cut":
            content = content[:at]
        elif how == "drop":
            content = content[:at] + content[to:]
        elif how == "twice":
            content = content[:to] + content[at:]
        else:
            lines = content.split(b"\n")
            i, j = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
            lines[i], lines[j] = lines[j], lines[i]
            content = b"\n".join(lines if how == "swap" else lines[:i] + lines[i + 1 :])
    return content


@st.composite
def other_values(draw, tree):
    """The same tree with another value, or none, in some place."""
    found = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 2))):
        inner, places = found, []
        while isinstance(inner, dict | list) and inner and (not places or draw(st.booleans())):
            keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
            places.append((inner, draw(st.sampled_from(list(keys)))))
            inner = inner[places[-1][1]]
        if places:
            holder, key = places[-1]
            if draw(st.integers(0, 4)):
                holder[key] = draw(VALUES)
            else:
                del holder[key]
    return found


def read_table(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "A.csv"
        file.write_bytes(content)
        record = pg.read_csv(file, tanks())
    assert np.isfinite(record.u).all()
    assert np.isfinite(record.y).all()


@settings(max_examples=120, **SHARED)
@given(content=mangled(TABLE))
def test_a_mangled_csv_file_is_read_or_refused(content):
    outcome(lambda: read_table(content))


@settings(max_examples=80, **SHARED)
@given(line=st.integers(0, 12), column=st.integers(0, 4), cell=CELLS)
def test_a_csv_file_with_another_cell_is_read_or_refused(line, column, cell):
    lines = [text.split(b",") for text in TABLE.split(b"\n")]
    lines[line][column] = cell
    outcome(lambda: read_table(b"\n".join(b",".join(cells) for cells in lines)))


FOUND = physics_to_json(pg.add(pg.add(tanks(), "leak_tank1", rate=0.01), "pump_saturation", voltage=4.0))
FOUND = {**FOUND, "verdict": "effect_found", "initial_state": {"upper_level": 3.0}}


def read_discovery(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "discovery.json"
        file.write_bytes(content)
        stored_physics(tanks(), read_stored(file, "physics.effects"), where="physics.effects")


@settings(max_examples=60, **SHARED)
@given(
    content=st.one_of(mangled(json.dumps(FOUND).encode()), other_values(FOUND).map(lambda t: json.dumps(t).encode()))
)
def test_a_mangled_discovery_is_read_or_refused(content):
    outcome(lambda: read_discovery(content))


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return save(tmp_path_factory.mktemp("good") / "run")


# The files of a checkpoint are those of another library, whose threads print what they find: single damages of them
# stand in `test_folders_refused.py`.
FILES = ["config.yaml", "physics.json", "metrics.json", "predictions.npz", "intervals.npz"]


@pytest.mark.filterwarnings("ignore:.*the source of physics:UserWarning", "ignore:.*is now called:FutureWarning")
@pytest.mark.filterwarnings("ignore:.*kept no copy of:UserWarning")
@settings(max_examples=30, **SHARED)
@given(data=st.data())
def test_a_mangled_run_folder_is_read_or_refused(good, data):
    name = data.draw(st.sampled_from(FILES))
    content = (good / name).read_bytes()
    if not name.endswith(".npz") and data.draw(st.booleans()):
        tree = json.loads(content) if name.endswith(".json") else yaml.safe_load(content)
        changed = data.draw(other_values(tree))
        content = (json.dumps(changed) if name.endswith(".json") else yaml.safe_dump(changed)).encode()
    else:
        content = data.draw(mangled(content))
    with TemporaryDirectory() as folder:
        run = copied(good, Path(folder) / "run")
        (run / name).write_bytes(content)
        outcome(lambda: use(run))
