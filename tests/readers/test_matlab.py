"""MATLAB files of version 5 and 7.3: vectors, structs, arrays of structs, Simulink's structures with time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.matlab.reader import tables_of
from towtank.readers.matlab.variables import load_variables
from towtank.recording import ColumnMapping

N = 300
T = 0.02 * np.arange(N)
U, R = np.sin(T), np.cos(T)


def mapping(**columns: Any) -> ColumnMapping:
    return ColumnMapping.model_validate({"columns": columns})


def save(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path, variables, do_compression=path.stem.endswith("z"))
    return path


def save_73(path: Path, **variables: Any) -> Path:
    """Write version 7.3 as MATLAB does: HDF5 behind a block of text, arrays transposed, texts as codes."""

    def put(group: Any, name: str, value: Any) -> None:
        if isinstance(value, dict):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, each in value.items():
                put(inner, key, each)
        elif isinstance(value, str):
            data = group.create_dataset(name, data=np.array([[ord(letter)] for letter in value], dtype=np.uint16))
            data.attrs["MATLAB_class"] = np.bytes_("char")
        elif isinstance(value, list):
            for key in value[0]:
                cells = []
                for k, each in enumerate(value):
                    at = f"#refs#/{name}_{key}_{k}"
                    group.file.create_dataset(at, data=np.atleast_2d(each[key]).T)
                    cells.append(group.file[at].ref)
                group.create_dataset(f"{name}/{key}", data=np.array([cells], dtype=h5py.ref_dtype).T)
        else:
            array = np.atleast_2d(value)
            data = group.create_dataset(name, data=array.T, compression="gzip" if array.size > 9 else None)
            data.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            put(file, name, value)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


SAVERS = {"5": (save, "a.mat"), "5z": (save, "az.mat"), "7.3": (save_73, "a.mat")}
versions = pytest.mark.parametrize("version", list(SAVERS))


def stored(folder: Path, version: str, **variables: Any) -> Path:
    saver, name = SAVERS[version]
    return saver(folder / name, **variables)


@versions
def test_vectors_side_by_side(tmp_path: Path, version: str) -> None:
    path = stored(tmp_path, version, t=T, u=U[:, None], r=R[None], cmd_1=1500.0 + T, remark="on the 3rd", gain=7.0)
    run = read(path)
    assert set(run.names) == {"u", "r", "cmd_1"}
    assert np.array_equal(run["u"].t, T)
    assert np.array_equal(run["u"].values, U)
    assert np.array_equal(run["r"].values, R)
    assert [(each.name, each.count, each.rate) for each in run.contents] == [("top level", N, 50.0)]
    assert not run.repairs


@versions
def test_structs_each_with_its_own_times(tmp_path: Path, version: str) -> None:
    dive = {"time": T, "u": U, "imu": {"gyro": np.column_stack([U, R, T])}, "dvl": {"t": T[::4], "v": U[::4], "w": 1.0}}
    path = stored(tmp_path, version, dive=dive, name="tank")
    run = read(path)
    assert set(run.names) == {"u", "v"}
    assert np.array_equal(run["v"].t, T[::4])
    columns = {"p": "dive.imu.gyro[0]", "q": {"from": "dive.imu.gyro[1]", "scale": 2.0}, "v": "dive.dvl.v"}
    turned = read(path, ColumnMapping.model_validate({"body": "FLU", "columns": columns}))
    assert np.array_equal(turned["q"].values, -2.0 * R)
    assert np.array_equal(turned["p"].values, U)
    assert np.array_equal(turned["v"].values, -U[::4])


@versions
def test_simulinks_structure_with_time(tmp_path: Path, version: str) -> None:
    path = stored(
        tmp_path, version, u={"time": T, "signals": {"values": U[:, None], "label": "speed"}, "blockName": "m/u"}
    )
    assert np.array_equal(read(path)["u"].values, U)
    wide = stored(tmp_path, version, out={"time": T, "signals": {"values": np.column_stack([U, R]), "dimensions": 2.0}})
    run = read(wide, mapping(r="out.signals.values[1]"))
    assert np.array_equal(run["r"].values, R)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_an_array_of_structs_is_a_struct_of_vectors(tmp_path: Path, version: str) -> None:
    path = stored(tmp_path, version, log=[{"t": float(t), "psi": float(u)} for t, u in zip(T, U, strict=True)])
    run = read(path)
    assert np.array_equal(run["psi"].values, U)
    assert np.array_equal(run["psi"].t, T)


@versions
def test_rates_and_times_by_the_mapping(tmp_path: Path, version: str) -> None:
    path = stored(tmp_path, version, log={"clock": 1000.0 * T, "speed": U})
    run = read(path, mapping(t={"from": "log.clock", "scale": 1e-3}, u="log.speed"))
    assert np.allclose(run["u"].t, T)
    run = read(path, ColumnMapping.model_validate({"rate": 10.0, "columns": {"u": "log.speed"}}))
    assert np.allclose(run["u"].t, 0.1 * np.arange(N))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"u": "dive.sped"}, r'no vector "dive\.sped" in .*did you mean "dive\.speed"\?; it has '),
        ({"u": "dive.gyro"}, r'no vector "dive\.gyro" in .*did you mean "dive\.gyro\[\d\]"'),
        ({"u": "dive.gyro[7]"}, r'no vector "dive\.gyro\[7\]"'),
        ({"u": "odd"}, r'"odd" of .* has 17 values, and no time beside it; name its time'),
        ({"t": "odd", "u": "dive.speed"}, r'"dive\.speed" of .* has 300 values, the time 17'),
        ({"t": "when", "u": "dive.speed"}, 'no vector "when"'),
        ({}, "the mapping names no measurement"),
    ],
)
def test_a_wrong_mapping_names_the_nearest(tmp_path: Path, columns: dict[str, Any], message: str) -> None:
    dive = {"t": T, "speed": U, "gyro": np.column_stack([U, R, T])}
    path = save(tmp_path / "a.mat", dive=dive, odd=np.arange(17.0))
    with pytest.raises(InputError, match=message):
        read(path, mapping(**columns))


def test_nothing_with_a_standard_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no struct with a time .* found dive\.t, dive\.speed; name the columns"):
        read(save(tmp_path / "a.mat", dive={"t": T, "speed": U}))
    with pytest.raises(InputError, match=r'"t" is in days \(datenum\), expected seconds'):
        read(save(tmp_path / "b.mat", t=739_000.0 + T / 86400.0, u=U))


def test_every_kind_of_variable_is_read_as_scipy_does(tmp_path: Path) -> None:
    variables: dict[str, Any] = {
        **{f"n_{kind}": np.arange(6).reshape(2, 3).astype(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "i8", "f4")},
        "cube": np.arange(24.0).reshape(2, 3, 4),
        "yes": np.array([[True, False]]),
        "empty": np.empty((0, 0)),
        "text": "größer",
        "nested": {"a": {"b": {"c": np.arange(3.0)}}},
        "complex": np.array([[1 + 2j, 3 - 4j]]),
    }
    for compressed in (False, True):
        path = tmp_path / "a.mat"
        scipy.io.savemat(path, variables, do_compression=compressed)
        found, damaged = load_variables(path)
        reference = scipy.io.loadmat(path)
        assert damaged == 0
        for name in variables:
            if name in ("text", "nested"):
                continue
            expected = np.real(reference[name])
            assert found[name] is not None
            assert np.array_equal(found[name], expected), name
        assert found["text"] == "größer"
        assert np.array_equal(np.ravel(found["nested"]["a"]["b"]["c"]), np.arange(3.0))


@pytest.mark.parametrize("version", ["5", "5z"])
def test_cut_files_yield_what_stands_before_the_cut(tmp_path: Path, version: str) -> None:
    data = stored(tmp_path, version, t=T, u=U, r=R, dive={"t": T, "v": U, "w": R}).read_bytes()
    found = set()
    for cut in range(len(data) // 3, len(data), 97):
        (tmp_path / "cut.mat").write_bytes(data[:cut])
        try:
            run = read(tmp_path / "cut.mat")
        except InputError:
            continue
        found |= {run.names}
        assert cut == len(data) or run.repairs.damaged == 1
    assert ("u",) in found
    assert ("u", "r") in found
    if version == "5":
        assert ("u", "r", "v") in found


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"MATLAB 5.0 MAT-file".ljust(128), "no header of a MATLAB file of version 5 to 7"),
        (b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM", "no struct with a time"),
        (
            b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(99),
            "not a readable MATLAB file of version 7.3",
        ),
        (b"\0\0\0\0" * 50, "save it in MATLAB with -v7"),
    ],
)
def test_foreign_and_empty_files_are_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(InputError, match=message) as raised:
        read(tmp_path / "a.mat")
    assert "\n" not in str(raised.value)


def test_an_array_of_structs_that_hold_vectors_is_a_table_each(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mat", run=[{"t": T, "speed": U}, {"t": T[:9], "speed": R[:9]}], note=[{"a": "x"}] * 3)
    tables = tables_of(path).tables
    assert {name: (len(each), list(each.columns)) for name, each in tables.items()} == {
        "run[0]": (N, ["run[0].speed"]),
        "run[1]": (9, ["run[1].speed"]),
    }
    run = read(path, mapping(u="run[1].speed"))
    assert np.array_equal(run["u"].values, R[:9])


def test_columns_of_a_matrix_are_taken_whichever_way_it_lies(tmp_path: Path) -> None:
    wide, square = np.stack([U, R]), np.arange(9.0).reshape(3, 3)
    path = save(tmp_path / "a.mat", t=T, wide=wide, cube=np.zeros((2, 3, N)), short=U[:7], text="t", square=square)
    [table] = tables_of(path).tables.values()
    assert list(table.columns) == ["wide[0]", "wide[1]"]
    assert np.array_equal(table.columns["wide[1]"], R)
    read_by = {"rate": 50.0, "columns": {"u": "wide[1]", "v": "short"}}
    run = read(path, ColumnMapping.model_validate(read_by))
    assert np.array_equal(run["u"].values, R)
    assert np.array_equal(run["v"].t, np.arange(7) / 50.0)
    with pytest.raises(InputError, match=r'no vector "wide\[2\]"'):
        read(path, mapping(t="t", u="wide[2]"))
    with pytest.raises(InputError, match=r'no vector "cube\[0\]"'):
        read(path, mapping(t="t", u="cube[0]"))


def test_structs_without_times_belong_to_the_times_above_them(tmp_path: Path) -> None:
    cells = [{"gyro": R}, {"gyro": U}]
    path = save(tmp_path / "a.mat", time=T, imu={"rate": U, "of": cells}, dvl={"t": T[:9], "speed": U[:9]})
    tables = tables_of(path).tables
    assert {name: list(each.columns) for name, each in tables.items()} == {
        "top level": ["imu.rate", "imu.of[0].gyro", "imu.of[1].gyro"],
        "dvl": ["dvl.speed"],
    }


def test_structs_of_an_array_that_have_times_of_their_own_are_tables_of_their_own(tmp_path: Path) -> None:
    runs = [{"t": T[:20], "speed": U[:20]}, {"t": T[:30], "speed": U[:30]}]
    tables = tables_of(save(tmp_path / "a.mat", time=T, rate=R, runs=runs)).tables
    assert {name: list(each.columns) for name, each in tables.items()} == {
        "top level": ["rate"],
        "runs[0]": ["runs[0].speed"],
        "runs[1]": ["runs[1].speed"],
    }


def test_a_struct_with_the_most_standard_names_comes_first(tmp_path: Path) -> None:
    path = save(tmp_path / "a.mat", a={"t": T, "u": U}, b={"t": T[::2], "u": R[::2], "v": R[::2]})
    run = read(path)
    assert set(run.names) == {"u", "v"}
    assert np.array_equal(run["u"].values, R[::2])
    assert {each.name: each.used for each in run.contents} == {"a": (), "b": ("u", "v")}
    assert {each.name: each.reason for each in run.contents} == {"a": "no standard name", "b": ""}


def test_times_in_days_are_told_from_seconds(tmp_path: Path) -> None:
    for first, days in ((600_001.0, True), (599_990.0, False), (899_900.0, True), (899_999.0, False)):
        path = save(tmp_path / "days.mat", t=first + T, u=U)
        if days:
            with pytest.raises(InputError, match=r"is in days \(datenum\)"):
                read(path)
        else:
            assert len(read(path)["u"]) == N
    long = save(tmp_path / "long.mat", t=700_000.0 + 10.0 * T, u=U)  # a minute, of a clock that began a week ago
    assert len(read(long)["u"]) == N


def test_without_h5py_the_remedy_is_named(tmp_path: Path) -> None:
    path = save_73(tmp_path / "a.mat", t=T, u=U)
    code = (
        "import sys; sys.modules['h5py'] = None\n"
        "from towtank.readers import read\n"
        f"try: read({str(path)!r})\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("InputError")
    assert "pip install towtank[matlab]" in done.stdout
