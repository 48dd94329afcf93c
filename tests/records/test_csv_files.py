"""Users' CSV files: what is read, what is written, and the one sentence for each kind of bad file."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pgrssnn_jax.records.csv import read_csv
from pgrssnn_jax.records.record import Channel, RecordInfo, record

U, Y = (Channel("pump_voltage", "V"),), (Channel("level_voltage", "V"),)
HEADER = "pump_voltage,level_voltage"
GOOD = f"{HEADER}\n1,5\n2,6\n3,7\n"


def read(folder, content, outputs=Y, **options):
    file = folder / "mine.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_csv(file, U, outputs, 4.0, **options)


def message(folder, content, **options):
    with pytest.raises(ValueError) as caught:
        read(folder, content, **options)
    return str(caught.value).removeprefix(str(folder / "mine.csv") + ": ")


def assert_one_sentence(text):
    assert "\n" not in text
    assert re.search("expected .+, found .+", text)


def test_columns_become_a_record(tmp_path):
    found = read(tmp_path, GOOD)
    assert found.u.shape == found.y.shape == found.mask.shape == (1, 3, 1)
    np.testing.assert_array_equal(found.u[0, :, 0], [1, 2, 3])
    np.testing.assert_array_equal(found.y[0, :, 0], [5, 6, 7])
    assert found.mask.all()
    assert (found.info.source, found.info.dt, found.info.inputs, found.info.outputs) == ("file", 4.0, U, Y)
    assert found.info.origin.startswith("mine.csv, sha256 ")


@pytest.mark.parametrize(
    "content",
    [
        pytest.param("\ufeff" + GOOD, id="byte-order mark"),
        pytest.param(GOOD.replace("\n", "\r\n"), id="windows line ends"),
        pytest.param(GOOD.replace("\n", "\r"), id="old line ends"),
        pytest.param(GOOD.rstrip("\n"), id="no last line end"),
        pytest.param(GOOD + "\n\n  \n,\n", id="empty rows at the end"),
        pytest.param(GOOD.replace("\n", ",\n"), id="trailing comma everywhere"),
        pytest.param(GOOD.replace(HEADER, HEADER + ","), id="trailing comma in the header"),
        pytest.param(GOOD.replace(HEADER, '"pump_voltage","level_voltage"'), id="quoted header"),
        pytest.param(GOOD.replace(HEADER, ' pump_voltage , "level_voltage" '), id="blanks around names"),
        pytest.param("level_voltage,note,pump_voltage\n5,a,1\n6,,2\n7,c,3\n", id="extra column, other order"),
        pytest.param(f",{HEADER}\n0,1,5\n1,2,6\n2,3,7\n", id="index column without a name"),
        pytest.param(f"time,{HEADER}\n0,1,5\n4.03,2,6\n8.01,3,7\n", id="time within one per cent"),
        pytest.param(f"time,{HEADER}\n1.7e9,1,5\n1700000004,2,6\n1700000008,3,7\n", id="time since 1970"),
        pytest.param(f"mask,{HEADER}\n1,1,5\n1.0,2,6\n1,3,7\n", id="mask of ones"),
        pytest.param(f"sequence,{HEADER}\na,1,5\na,2,6\na,3,7\n", id="one sequence"),
    ],
)
def test_harmless_differences_between_files_do_not_matter(tmp_path, content):
    found, expected = read(tmp_path, content), read(tmp_path, GOOD)
    for a, b in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_array_equal(a, b)


def test_unequal_sequences_are_padded_at_their_end(tmp_path):
    rows = "sequence,pump_voltage,level_voltage\nb,1,5\na,2,6\nb,3,7\na,4,8\nb,9,9\n"
    found = read(tmp_path, rows)
    np.testing.assert_array_equal(found.u[..., 0], [[1, 3, 9], [2, 4, 4]])
    np.testing.assert_array_equal(found.y[..., 0], [[5, 7, 9], [6, 8, 0]])
    np.testing.assert_array_equal(found.mask[..., 0], [[True] * 3, [True, True, False]])


def test_time_starts_anew_with_each_sequence(tmp_path):
    found = read(tmp_path, f"sequence,time,{HEADER}\n1,0,1,5\n1,4,1,5\n2,0,1,5\n2,4,1,5\n")
    assert found.u.shape == (2, 2, 1)


def test_an_empty_output_was_not_measured(tmp_path):
    for cell in ("", "nan", "NaN"):
        found = read(tmp_path, GOOD.replace("2,6", f"2,{cell}"))
        np.testing.assert_array_equal(found.mask[0, :, 0], [True, False, True])
        np.testing.assert_array_equal(found.y[0, :, 0], [5, 0, 7])


def test_masks_of_all_and_of_one_output(tmp_path):
    two = (Channel("a"), Channel("b"))
    rows = "pump_voltage,a,b,mask,mask_b\n0,1,2,1,1\n0,3,,1,0\n0,NaN,x,0,1\n".replace("x", "inf")
    found = read(tmp_path, rows, outputs=two)
    np.testing.assert_array_equal(found.mask[0], [[1, 1], [1, 0], [0, 0]])
    np.testing.assert_array_equal(found.y[0], [[1, 2], [3, 0], [0, 0]])


BAD = {
    "empty file": ("", "line 1: expected a header with column names, found an empty file"),
    "nothing but blanks": ("\n\n  \n", "line 1: expected a header with column names, found an empty file"),
    "header alone": (HEADER + "\n", "line 1: expected samples below the header, found none"),
    "missing column": (
        "pump,level_voltage\n1,2\n1,2\n",
        "line 1: column 'pump_voltage': expected a column of this name, found 'pump', 'level_voltage'",
    ),
    "other separator": (
        GOOD.replace(",", ";"),
        "line 1: expected commas between columns, found semicolons in 'pump_voltage;level_voltage'",
    ),
    "no header": (
        "1,2\n3,4\n",
        "line 1: column 'pump_voltage': expected a column of this name, found '1', '2'",
    ),
    "duplicate column": (
        f"{HEADER},pump_voltage\n1,2,3\n1,2,3\n",
        "line 1: column 'pump_voltage': expected every column name once, found it 2 times",
    ),
    "text in a number": (
        GOOD.replace("6", "six"),
        "line 3: column 'level_voltage': expected a finite number, found 'six'",
    ),
    "a number no other program writes": (
        GOOD.replace("6", "1_0"),
        "line 3: column 'level_voltage': expected a finite number, found '1_0'",
    ),
    "decimal comma": (
        f'{HEADER}\n"1,5",2\n1,2\n',
        "line 2: column 'pump_voltage': expected a finite number, found '1,5'",
    ),
    "empty input": (
        GOOD.replace("2,6", ",6"),
        "line 3: column 'pump_voltage': expected a finite number, found an empty cell",
    ),
    "NaN in an input": (
        GOOD.replace("2,6", "nan,6"),
        "line 3: column 'pump_voltage': expected a finite number, found 'nan'",
    ),
    "infinite output": (
        GOOD.replace("7", "-inf"),
        "line 4: column 'level_voltage': expected a finite number, found '-inf'",
    ),
    "empty output with mask 1": (
        f"{HEADER},mask\n1,,1\n1,2,1\n",
        "line 2: column 'level_voltage': expected a finite number, found an empty cell",
    ),
    "mask that is no bit": (
        f"{HEADER},mask\n1,2,1\n1,2,0.5\n",
        "line 3: column 'mask': expected 0 or 1, found '0.5'",
    ),
    "mask of one output that is no bit": (
        f"{HEADER},mask_level_voltage\n1,2,yes\n1,2,0\n",
        "line 2: column 'mask_level_voltage': expected 0 or 1, found 'yes'",
    ),
    "empty mask": (f"{HEADER},mask\n1,2,1\n1,2,\n", "line 3: column 'mask': expected 0 or 1, found an empty cell"),
    "wrong dt": (
        f"time,{HEADER}\n0,1,2\n2,1,2\n4,1,2\n",
        "line 3: column 'time': expected 4 s between samples (the physics' dt), found 2 s",
    ),
    "uneven sampling": (
        f"time,{HEADER}\n0,1,2\n4,1,2\n12,1,2\n16,1,2\n",
        "line 4: column 'time': expected evenly spaced samples, 4 s (the physics' dt) after the one before, found 8 s",
    ),
    "time runs backwards": (
        f"time,{HEADER}\n0,1,2\n4,1,2\n8,1,2\n0,1,2\n4,1,2\n",
        "line 5: column 'time': expected evenly spaced samples, 4 s (the physics' dt) after the one before, found -8 s",
    ),
    "time without a number": (
        f"time,{HEADER}\n0,1,2\n,1,2\n",
        "line 3: column 'time': expected a finite number, found an empty cell",
    ),
    "too short": (f"{HEADER}\n1,2\n", "line 2: expected at least 2 samples, found 1"),
    "a sequence too short": (
        f"sequence,{HEADER}\na,1,2\na,1,2\nb,1,2\n",
        "line 4: column 'sequence': expected at least 2 samples of sequence 'b', found 1",
    ),
    "sequence without a label": (
        f"sequence,{HEADER}\na,1,2\n,1,2\n",
        "line 3: column 'sequence': expected a label, found an empty cell",
    ),
    "too many cells": (GOOD.replace("2,6", "2,6,1"), "line 3: column 'level_voltage': expected 2 cells, found 3"),
    "too few cells": (GOOD.replace("2,6", "2"), "line 3: column 'level_voltage': expected 2 cells, found 1"),
    "empty row in the middle": (GOOD.replace("2,6", ""), "line 3: column 'pump_voltage': expected 2 cells, found 0"),
    "not UTF-8": (GOOD.encode() + b"\xb0,1\n", "line 5: expected text in UTF-8, found the byte 0xb0"),
    "UTF-16": (GOOD.encode("utf-16"), "line 1: expected text in UTF-8, found text in UTF-16"),
    "unclosed quote": (GOOD.replace("2,6", '"2,6'), "line 3: column 'level_voltage': expected 2 cells, found 1"),
    "endless cell": (f"{HEADER}\n" + "1" * 200_000, "line 2: expected comma-separated values, found a malformed row"),
    "line counted after a cell of two lines": (
        f'note,{HEADER}\n"a\nb",1,2\nc,x,2\n',
        "line 4: column 'pump_voltage': expected a finite number, found 'x'",
    ),
}


@pytest.mark.parametrize(("content", "expected"), BAD.values(), ids=BAD.keys())
def test_a_bad_file_is_one_sentence_with_its_place(tmp_path, content, expected):
    found = message(tmp_path, content)
    assert found.startswith(expected)
    assert_one_sentence(found)


def test_long_cells_are_cut_in_messages(tmp_path):
    found = message(tmp_path, GOOD.replace("6", "x" * 1000))
    assert len(found) < 150
    assert found.endswith("…'")


def test_missing_file_and_folder(tmp_path):
    for path, found in ((tmp_path / "no.csv", "no such file"), (tmp_path, "a folder"), ("a\0b", "no such file")):
        with pytest.raises(ValueError, match=f"expected a readable CSV file, found {found}"):
            read_csv(path, U, Y, 4.0)


floats = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def measured(draw):
    n_seq, time, n_u, n_y = (draw(st.integers(low, 3)) for low in (1, 2, 1, 1))
    u, y = ([draw(floats) for _ in range(n_seq * time * n)] for n in (n_u, n_y))
    mask = draw(st.lists(st.booleans(), min_size=len(y), max_size=len(y)))
    dt = draw(st.floats(1e-6, 1e6))
    shape = (n_seq, time, n_y)
    return np.reshape(u, (n_seq, time, n_u)), np.reshape(y, shape), np.reshape(np.array(mask, bool), shape), dt


@settings(max_examples=60, deadline=None)
@given(drawn=measured())
def test_numbers_masks_and_sequences_are_read_back_to_the_last_digit(tmp_path_factory, drawn):
    u, y, mask, dt = drawn
    inputs, outputs = (tuple(Channel(f"{name}{i}") for i in range(a.shape[-1])) for name, a in (("u", u), ("y", y)))
    whole = record(u, y, RecordInfo(inputs, outputs, dt, "simulated"), mask)
    file = tmp_path_factory.mktemp("csv") / "written.csv"
    n_seq, time = u.shape[:2]
    columns = {"sequence": np.repeat(np.arange(n_seq), time), "time": np.tile(np.arange(time) * dt, n_seq)}
    columns |= {channel.name: u[..., i].ravel() for i, channel in enumerate(inputs)}
    for i, channel in enumerate(outputs):
        columns[channel.name] = np.where(mask, y, np.nan)[..., i].ravel()
        columns[f"mask_{channel.name}"] = mask[..., i].ravel().astype(int)
    pd.DataFrame(columns).to_csv(file, index=False)
    found = read_csv(file, whole.info.inputs, whole.info.outputs, whole.info.dt)
    for a, b in zip(found[:3], whole[:3], strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.any(np.signbit(found.u) != np.signbit(whole.u))
