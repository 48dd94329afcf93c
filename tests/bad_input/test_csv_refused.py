"""CSV files with other separators, encodings, columns, times and cells: accepted or refused."""

import numpy as np
import pytest
from commands import called
from sentences import assert_one_sentence, contents, refused, tanks

import pgrssnn_jax as pg

HEADER = "time,pump_voltage,level_voltage"
ROWS = [f"{4 * t},{2 + t % 3},{4 + t % 5}" for t in range(20)]
GOOD = "\n".join([HEADER, *ROWS]) + "\n"


def rows(**changed):
    """The good file with other rows: `r3` is that of the fourth sample, None leaves it out."""
    found = [changed.get(f"r{t}", row) for t, row in enumerate(ROWS)]
    return "\n".join([changed.get("header", HEADER), *(row for row in found if row is not None)]) + "\n"


def drifting(step):
    return "\n".join([HEADER, *(f"{step * t},{2 + t % 3},4" for t in range(20))])


BAD = {
    "semicolons": (GOOD.replace(",", ";"), "line 1: expected commas between columns, found semicolons"),
    "decimal commas": (
        GOOD.replace(",", ";").replace("4;2", "4,0;2"),
        "expected commas between columns, found semicolons",
    ),
    "tabs": (GOOD.replace(",", "\t"), "line 1: expected commas between columns, found tabs"),
    "bars": (GOOD.replace(",", "|"), "line 1: expected commas between columns, found bars"),
    "blanks": (GOOD.replace(",", " "), "column 'pump_voltage': expected a column of this name"),
    "decimal commas in quotes": (rows(r3='12,"2,5",5'), "line 5: column 'pump_voltage': expected a finite number"),
    "decimal commas without quotes": (
        rows(r3="12,2,5,5,0"),
        "line 5: column 'level_voltage': expected 3 cells, found 5",
    ),
    "UTF-16": (GOOD.encode("utf-16"), "line 1: expected text in UTF-8, found text in UTF-16"),
    "UTF-16 of the other kind": (
        b"\xfe\xff" + GOOD.encode("utf-16-be"),
        "expected text in UTF-8, found text in UTF-16",
    ),
    "Latin-1": (rows(r3="12,2°,5").encode("latin-1"), "line 5: expected text in UTF-8, found the byte 0xb0"),
    "a unit in a cell": (rows(r3="12,2 V,5"), "line 5: column 'pump_voltage': expected a finite number, found '2 V'"),
    "a unit below the header": (rows(r0="s,V,V"), "line 2: column 'pump_voltage': expected a finite number, found 'V'"),
    "units in the header": (
        rows(header="time [s],pump_voltage [V],level_voltage [V]"),
        "'pump_voltage': expected a column",
    ),
    "names in capitals": (GOOD.replace("pump", "Pump"), "column 'pump_voltage': expected a column of this name"),
    "no output": (rows(header="time,pump_voltage,note"), "column 'level_voltage': expected a column of this name"),
    "a name twice": (rows(header="time,pump_voltage,pump_voltage"), "'pump_voltage': expected every column name once"),
    "no header": ("\n".join(ROWS), "line 1: column"),
    "an empty input": (
        rows(r3="12,,5"),
        "line 5: column 'pump_voltage': expected a finite number, found an empty cell",
    ),
    "an input that is NaN": (
        rows(r3="12,NaN,5"),
        "line 5: column 'pump_voltage': expected a finite number, found 'NaN'",
    ),
    "an infinite output": (
        rows(r3="12,2,inf"),
        "line 5: column 'level_voltage': expected a finite number, found 'inf'",
    ),
    "an output in words": (rows(r3="12,2,full"), "line 5: column 'level_voltage': expected a finite number"),
    "a missing value in words": (rows(r3="12,2,N/A"), "line 5: column 'level_voltage': expected a finite number"),
    "an error of a spreadsheet": (rows(r3="12,2,#DIV/0!"), "line 5: column 'level_voltage': expected a finite number"),
    "a hexadecimal number": (rows(r3="12,0x10,5"), "line 5: column 'pump_voltage': expected a finite number"),
    "a thousands separator": (rows(r3="12,1'000,5"), "line 5: column 'pump_voltage': expected a finite number"),
    "a date": (rows(r0="2020-01-01,2,5"), "line 2: column 'time': expected a finite number, found '2020-01-01'"),
    "a time twice": (rows(r3="8,2,5"), "line 5: column 'time': expected evenly spaced samples", "found 0 s"),
    "shuffled times": (rows(r3="16,2,5", r4="12,2,5"), "line 5: column 'time': expected evenly spaced", "found 8 s"),
    "a sample that is missing": (rows(r3=None), "line 5: column 'time': expected evenly spaced samples", "found 8 s"),
    "times in milliseconds": (drifting(4000), "line 3: column 'time': expected 4 s between samples", "found 4000 s"),
    "a clock that is fast": (drifting(4.2), "line 3: column 'time': expected 4 s between samples", "found 4.2 s"),
    "an empty time": (rows(r3=",2,5"), "line 5: column 'time': expected a finite number, found an empty cell"),
    "a mask in words": (rows(header="mask,pump_voltage,level_voltage", r0="no,2,5"), "column 'mask': expected 0 or 1"),
    "an empty row above": ("\n" + GOOD, "line 1: expected a header with column names, found a row without any"),
    "an empty file": ("", "line 1: expected a header with column names, found an empty file"),
    "the header alone": (HEADER, "line 1: expected samples below the header, found none"),
    "one row": ("\n".join([HEADER, ROWS[0]]), "line 2: expected at least 2 samples, found 1"),
    "a binary file": (bytes(range(256)) * 4, "expected text in UTF-8, found the byte 0x80"),
    "an archive": (b"PK\x03\x04" + bytes(100), "expected"),
    "a page": ("<html>\n<body>404</body>\n</html>\n", "column 'pump_voltage': expected a column of this name"),
    "a row that is cut off": (GOOD[:-4], "line 21: column 'level_voltage': expected 3 cells, found 2"),
}


@pytest.mark.parametrize(("content", "words"), [(content, words) for content, *words in BAD.values()], ids=BAD)
def test_a_bad_file_is_refused_with_its_place(folder, content, words):
    (folder / "A.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(lambda: pg.read_csv("A.csv", tanks()), "A.csv: ", *words)


def test_a_file_that_cannot_be_read_is_named(folder):
    refused(lambda: pg.read_csv("none.csv", tanks()), "none.csv: expected a readable CSV file, found no such file")
    refused(lambda: pg.read_csv(folder, tanks()), f"{folder}: expected a readable CSV file, found a folder")
    refused(lambda: pg.read_csv("a\0b.csv", tanks()), "found no such file")
    refused(lambda: pg.read_csv("a" * 300 + ".csv", tanks()), "expected a readable CSV file, found")


@pytest.mark.parametrize("cell", ["", " ", "nan", "NaN"])
def test_an_empty_output_is_accepted_as_not_measured(folder, cell):
    (folder / "A.csv").write_text(rows(r3=f"12,2,{cell}"))
    found = pg.read_csv("A.csv", tanks())
    assert np.flatnonzero(~found.mask[0, :, 0]).tolist() == [3]
    assert np.isfinite(found.y).all()


def test_a_clock_within_one_per_cent_is_accepted(folder):
    (folder / "A.csv").write_text(drifting(4.02))
    assert pg.read_csv("A.csv", tanks()).info.dt == 4.0


OWN = ["physics=tanks", "data=csv", "data.train=A.csv", "data.test=A.csv"]
COMMANDS = {
    "a training file that is not there": ([*OWN[:2], "data.train=no.csv", OWN[3]], "data.train: no.csv: expected a"),
    "a test file that is not there": (
        [*OWN[:3], "data.test=no.csv"],
        "data.test: no.csv: expected a readable CSV file",
    ),
    "no test file": (OWN[:3], "data.test: expected data.test=FILE.csv, found none"),
    "a validation file that is damaged": ([*OWN, "data.validation=B.csv"], "data.validation: B.csv: line 1: expected"),
    "more samples than there are": ([*OWN, "data.n_validation=20"], "data.n_validation: expected between 1 and 19"),
    "a state that is not measured": ([*OWN, "physics=lgssm"], "column 'u': expected a column of this name"),
    "another sample time": ([*OWN, "physics.dt=1"], "line 3: column 'time': expected 1 s between samples"),
    "data that there are not": ([*OWN, "data.name=excel"], "data.name: expected one of ["),
    "effects that are no file": ([*OWN, "physics.effects=none.json"], "physics.effects: expected a discovery.json"),
    "effects that are damaged": ([*OWN, "physics.effects=bad.json"], "physics.effects: bad.json: expected the key"),
}


SCRIPTS = ("train.py", "discover.py")
CALLS = {
    **{f"{name}-{script}": (*row, script) for name, row in COMMANDS.items() for script in SCRIPTS},
    "no run": (["resume=none"], "run folder: expected one with a config.yaml, found none", "train.py"),
}
FAST = ("no test file", "a state that is not measured", "effects that are no file", "effects that are damaged")


def marks(name: str) -> list[pytest.MarkDecorator]:
    """Both commands read files by the same lines."""
    return [pytest.mark.slow] if name.endswith("discover.py") and not name.startswith(FAST) else []


@pytest.mark.parametrize(
    ("arguments", "words", "script"), [pytest.param(*call, id=name, marks=marks(name)) for name, call in CALLS.items()]
)
def test_a_command_ends_with_2_and_writes_nothing(folder, arguments, words, script):
    (folder / "A.csv").write_text(GOOD)
    (folder / "B.csv").write_text(GOOD.replace(",", ";"))
    (folder / "bad.json").write_text("{}")
    before = contents(folder)
    code, out, err = called(*arguments, cwd=folder, script=script)
    assert code == 2, out + err
    assert "Traceback" not in out + err
    assert_one_sentence(err.strip(), words)
    assert {path: kept for path, kept in contents(folder).items() if kept is not None} == {
        path: kept for path, kept in before.items() if kept is not None
    }
