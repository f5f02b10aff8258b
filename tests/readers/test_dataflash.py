"""ArduPilot DataFlash: hand-built logs give the channels that they were built from, and damage is counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.dataflash.records import LETTERS, decode_binary
from towtank.readers.dataflash.text import decode_text
from towtank.recording import ColumnMapping, Recording

from .encoders import DataFlashWriter, dive_bin

SIX = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)}


def written(folder: Path, data: bytes | bytearray, name: str = "dive.BIN") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def used(recording: Recording) -> dict[str, tuple[str, ...]]:
    return {content.name: content.used for content in recording.contents if content.used}


def reasons(recording: Recording) -> dict[str, str]:
    return {content.name: content.reason for content in recording.contents}


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_units_signs_and_frames(tmp_path: Path, text: bool) -> None:
    log = dive_bin(parameters={**SIX, "BARO_PRIMARY": 1.0, "MOT_2_DIRECTION": -1.0})
    run = read(written(tmp_path, "\n".join(log.text).encode(), "dive.log") if text else written(tmp_path, log.data))
    half = {"atol": 6e-8 if text else 1e-5, "rtol": 1e-6}

    def at(name: str) -> np.ndarray:
        return run[name].t

    np.testing.assert_allclose(run["p"].values, 0.1 * at("p"), **half)
    np.testing.assert_allclose(run["r"].values, -0.1 * at("r"), **half)
    np.testing.assert_allclose(run["ax"].values, 1.0 + at("ax"), **half)
    np.testing.assert_allclose(run["az"].values, -9.8, **half)  # specific force in FRD: minus g at rest
    np.testing.assert_allclose(run["phi"].values, np.radians(1.0 + at("phi")), atol=1e-9)
    np.testing.assert_allclose(run["theta"].values, np.radians(-2.0), atol=1e-9)
    np.testing.assert_allclose(run["psi"].values, np.radians(350.0), atol=1e-9)
    np.testing.assert_allclose(run["z"].values, 2.0 + 0.1 * at("z"), **half)  # down, where ArduPilot logs height
    np.testing.assert_allclose(run["u"].values, 0.2 * at("u"), **half)
    np.testing.assert_allclose(run["v"].values, -0.1, **half)
    np.testing.assert_allclose(run["w"].values, 0.05, **half)
    np.testing.assert_allclose(run["voltage"].values, 16.0 - 0.1 * at("voltage"), **half)
    np.testing.assert_allclose(run["cmd_1"].values, 1510.0 + 5.0 * at("cmd_1"), atol=0.5)
    np.testing.assert_allclose(run["cmd_2"].values, 3000.0 - (1520.0 + 5.0 * at("cmd_2")), atol=0.5)
    assert [name for name in run if name.startswith("cmd_")] == [f"cmd_{n}" for n in range(1, 7)]
    assert run["p"].t[:3] == pytest.approx([0.0, 0.02, 0.04])
    assert run["u"].t[:3] == pytest.approx([0.0, 0.1, 0.2])
    assert run.attributes["since_boot_s"] == "100.000000"
    assert not run.repairs


def test_every_message_is_accounted_for(tmp_path: Path) -> None:
    run = read(written(tmp_path, dive_bin(parameters=SIX).data))
    assert used(run)["IMU[0]"] == ("p", "q", "r", "ax", "ay", "az")
    assert used(run)["VISO"] == ("u", "v", "w")
    assert used(run)["BARO[1]"] == ("z",)
    why = reasons(run)
    assert "IMU[0] is used" in why["IMU[1]"]
    assert "air in the hull" in why["BARO[0]"]
    assert "velocity: VISO is nearer the sensor" in why["XKF1[0]"]
    assert {content.kind for content in run.contents} == {"DataFlash"}
    assert {content.name: content.count for content in run.contents}["IMU[0]"] == 200
    assert next(content for content in run.contents if content.name == "VISO").rate == pytest.approx(10.0)


def test_satellites_tell_the_date(tmp_path: Path) -> None:
    log = dive_bin(1.0)
    log.define("GPS", "QBBIHB", "TimeUS,I,Status,GMS,GWk,NSats")
    log.add("GPS", 100_500_000, 0, 3, 259_200_000, 2290, 12)  # 2023-11-29 00:00:00 GPS, 18 s later than UTC
    assert read(written(tmp_path, log.data)).attributes["epoch"] == "2023-11-28T23:59:41.500000+00:00"


def test_raw_samples_stand_where_they_were_taken(tmp_path: Path) -> None:
    log = dive_bin(1.0)
    log.define("GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ")
    for k in range(100):
        log.add("GYR", 100_000_000 + 50_000 * (k // 5), 0, 100_000_000 + 10_000 * k, 0.5, 0.0, 0.0)
    run = read(written(tmp_path, log.data))
    assert used(run)["GYR[0]"] == ("p", "q", "r")  # twice the samples of IMU[0]
    np.testing.assert_allclose(np.diff(run["p"].t), 0.01, atol=1e-9)


def test_lost_bottom_is_not_rest(tmp_path: Path) -> None:
    log = dive_bin(2.0, dvl=False)
    for k in range(20):
        lost = k % 2
        log.add(
            "VISO", 100_000_000 + 100_000 * k, 0.1, 0.0, 0.0, 0.0, 0.0 if lost else 0.03, 0.0, 0.0, 0.0 if lost else 90
        )
    run = read(written(tmp_path, log.data))
    np.testing.assert_allclose(run["u"].values, 0.3, rtol=1e-6)
    assert len(run["u"]) == 10


def test_dvl_is_moved_to_the_origin_where_its_place_is_known(tmp_path: Path) -> None:
    plain = read(written(tmp_path, dive_bin().data))
    moved = read(written(tmp_path, dive_bin(parameters={"VISO_POS_X": 0.5}).data, "moved.BIN"))
    t = moved["v"].t
    np.testing.assert_allclose(moved["v"].values, plain["v"].values[: t.size] - 0.5 * -0.1 * t, atol=1e-6)  # - r x
    assert any("VISO_POS_X" in note for note in moved.notes)


@pytest.mark.parametrize(
    "parameters",
    [{}, {"VISO_POS_X": 0.0, "VISO_POS_Y": 0.0, "VISO_POS_Z": 0.0}, {"VISO_POS_X": 0.5, "VISO_POS_Y": np.nan}],
    ids=["untold", "at the origin", "damaged"],
)
def test_dvl_stays_where_nothing_says_that_it_sits_elsewhere(tmp_path: Path, parameters: dict[str, float]) -> None:
    run = read(written(tmp_path, dive_bin(parameters=parameters).data))
    np.testing.assert_allclose(run["v"].values, -0.1, atol=1e-6)
    assert not any("the DVL sits" in note for note in run.notes)


@pytest.mark.parametrize(("field", "value"), [("Alt", -2.0), ("Press", 120_000.0)])
def test_a_barometer_that_tells_only_half_of_it_tells_no_depth(tmp_path: Path, field: str, value: float) -> None:
    log = DataFlashWriter()
    log.define("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define("BARO", "QBff", f"TimeUS,I,{field},Temp")
    for k in range(100):
        log.add("IMU", 20_000 * k, 0, 0.01 * k, 0.0, 0.0, 0.1 * k, 0.0, -9.8)
        log.add("BARO", 20_000 * k, 0, value + 0.01 * k, 20.0)
    run = read(written(tmp_path, log.data))
    assert "p" in run
    assert "z" not in run


def test_outputs_without_parameters_are_said(tmp_path: Path) -> None:
    run = read(written(tmp_path, dive_bin().data))
    assert [name for name in run if name.startswith("cmd_")] == [f"cmd_{n}" for n in range(1, 7)]  # 7 has no pulse
    assert any("no SERVOn_FUNCTION" in note and "outputs 1 to 6" in note for note in run.notes)


def test_thrusters_beyond_the_fourteenth_output_are_joined(tmp_path: Path) -> None:
    parameters = {**SIX, "SERVO16_FUNCTION": 39.0, "SERVO15_FUNCTION": 40.0}
    run = read(written(tmp_path, dive_bin(parameters=parameters, beyond=True).data))
    assert [name for name in run if name.startswith("cmd_")] == [f"cmd_{n}" for n in range(1, 9)]
    np.testing.assert_allclose(run["cmd_7"].measured.values, 1600.0 - np.arange(40))
    np.testing.assert_allclose(run["cmd_8"].measured.values, 1700.0 + np.arange(40))
    np.testing.assert_allclose(run["cmd_1"].measured.values, 1510.0 + 5.0 * run["cmd_1"].measured.t, atol=0.5)
    assert used(run)["RCOU"] == tuple(f"cmd_{n}" for n in range(1, 9))
    assert reasons(run)["RCO2"] == "commands: joined to RCOU"
    assert any("thrusters of RCO2 are joined" in note for note in run.notes)


def test_mapping_takes_what_it_names_at_its_own_times(tmp_path: Path) -> None:
    path = written(tmp_path, dive_bin().data)
    mapping = {
        "thrusters": ["RCOU.C3", {"from": "RCOU.C4", "scale": -1.0, "offset": 3000.0}],
        "columns": {"p": "IMU[1].GyrX", "psi": {"from": "ATT.Yaw", "scale": np.pi / 180.0}},
    }
    run = read(path, ColumnMapping.model_validate(mapping))
    assert run.names == ("p", "psi", "cmd_1", "cmd_2")
    np.testing.assert_allclose(run["p"].values, 9.0)
    assert (len(run["p"]), len(run["psi"])) == (200, 40)
    np.testing.assert_allclose(run["cmd_2"].values, 3000.0 - (1540.0 + 5.0 * run["cmd_2"].t), atol=0.5)
    assert used(run) == {"IMU[1]": ("p",), "ATT": ("psi",), "RCOU": ("cmd_1", "cmd_2")}
    assert reasons(run)["VISO"] == "not named by the mapping"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"p": "IMU[0].GyrY2"}, r'no "IMU\[0\]\.GyrY2" .*did you mean "IMU\[0\]\.GyrY"\?; IMU\[0\] has TimeUS'),
        ({"p": "IMU.GyrX"}, r'did you mean "IMU\[0\]\.GyrX"'),
        ({"p": "gyro"}, r"expected TABLE\.field, where TABLE is one of"),
        ({"t": "IMU[0].TimeUS", "p": "IMU[0].GyrX"}, r"messages .* have times; leave it out"),
        ({"t": "stamp", "p": "IMU[0].GyrX"}, "without stamps"),
        ({}, "names no measurement"),
    ],
)
def test_mappings_that_cannot_be(tmp_path: Path, columns: dict[str, str], message: str) -> None:
    path = written(tmp_path, dive_bin(1.0).data)
    with pytest.raises(InputError, match=message):
        read(path, ColumnMapping.model_validate({"columns": columns}))


def test_an_old_log_in_milliseconds(tmp_path: Path) -> None:
    log = DataFlashWriter()
    log.define("IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for k in range(50):
        log.add("IMU", 5000 + 20 * k, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    run = read(written(tmp_path, log.data))
    assert run["q"].t[:2] == pytest.approx([0.0, 0.02])
    assert used(run) == {"IMU": ("p", "q", "r", "ax", "ay", "az")}


def test_a_format_that_is_defined_anew(tmp_path: Path) -> None:
    log = dive_bin(1.0)
    log.define("ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF", number=log.number("ATT"))
    for k in range(10, 20):
        log.add("ATT", 100_000_000 + 100_000 * k, 0.0, 1.0 + 0.1 * k, 0.0, -2.0, 0.0, 350.0, 3)
    run = read(written(tmp_path, log.data))
    np.testing.assert_allclose(run["phi"].values, np.radians(1.0 + run["phi"].t), atol=1e-7)
    assert len(run["phi"]) == 20


def test_truncated(tmp_path: Path) -> None:
    whole = dive_bin(4.0, parameters=SIX).data
    run = read(written(tmp_path, whole[: len(whole) // 2 - 7]))
    assert run.duration == pytest.approx(1.9, abs=0.3)
    assert run.repairs.damaged == 1
    assert any("bytes that are no message" in line for line in run.repairs.lines)


def test_padding_of_a_flash_page_is_no_damage(tmp_path: Path) -> None:
    whole = bytes(dive_bin(1.0).data)
    for padding in (b"\xff" * 700, b"\0" * 3):
        assert not read(written(tmp_path, whole + padding)).repairs


def test_garbage_between_messages(tmp_path: Path) -> None:
    whole = bytes(dive_bin(4.0).data)
    cut = whole.index(b"\xa3\x95", len(whole) // 2)
    plain = read(written(tmp_path, whole))
    noise = np.random.default_rng(1).bytes(5000) + b"\xa3\x95\x80\xa3\x95"
    run = read(written(tmp_path, whole[:cut] + noise + whole[cut:], "noise.BIN"))
    assert 1 <= run.repairs.damaged <= 3
    assert len(run["p"]) >= len(plain["p"]) - 2
    assert np.isin(run["p"].t, plain["p"].t).all()


def test_a_lost_byte_costs_one_message(tmp_path: Path) -> None:
    whole = bytearray(dive_bin(4.0).data)
    cut = whole.index(b"\xa3\x95", len(whole) // 2)
    del whole[cut + 10]
    run = read(written(tmp_path, whole))
    assert run.repairs.damaged == 1
    assert run.duration == pytest.approx(3.98)


def test_numbers_that_are_none(tmp_path: Path) -> None:
    """A signalling NaN and infinities, as broken bytes make them, pass without a word of NumPy."""
    log = dive_bin(4.0)
    place = bytes(log.data).index(bytes((0xA3, 0x95, log.number("IMU"))))
    for offset, bits in ((12, 0x7FA00000), (16, 0x7F800000), (20, 0xFF800000)):
        log.data[place + offset : place + offset + 4] = bits.to_bytes(4, "little")
    run = read(written(tmp_path, log.data))
    assert run.repairs.infinities == 2
    assert len(run["p"]) == 199


def test_a_broken_stamp_is_left_out(tmp_path: Path) -> None:
    log = dive_bin(4.0)
    place = log.data.index(b"\xa3\x95", len(log.data) // 2)
    log.data[place + 3 + 6] ^= 0x10  # 142 000 days later
    run = read(written(tmp_path, log.data))
    assert run.duration == pytest.approx(3.98)
    assert run.repairs.damaged == 1


def test_two_logs_in_one_file(tmp_path: Path) -> None:
    """The clock goes back: the longer one is used, the loss said."""
    run = read(written(tmp_path, dive_bin(4.0, start=500.0).data + dive_bin(8.0, start=100.0).data))
    assert run.duration == pytest.approx(7.98)
    assert run.attributes["since_boot_s"] == "100.000000"
    assert any("the clock goes back once" in note and "left out" in note for note in run.notes)


def test_without_its_formats_nothing_can_be_read(tmp_path: Path) -> None:
    whole = bytes(dive_bin(1.0).data)
    headless = whole[whole.rindex(b"\xa3\x95\x80") + 89 :]
    with pytest.raises(InputError, match=r"dive\.BIN: no DataFlash message with a time in it"):
        read(written(tmp_path, headless))


def test_a_log_without_motion(tmp_path: Path) -> None:
    log = DataFlashWriter()
    log.define("PM", "QHH", "TimeUS,NLon,NL")
    for k in range(9):
        log.add("PM", 1_000_000 * k, 1, 2)
    with pytest.raises(InputError, match=r"no message that can be used; it has PM; .*--map"):
        read(written(tmp_path, log.data))


def test_text_with_broken_lines(tmp_path: Path) -> None:
    lines = dive_bin(4.0).text
    lines[60:60] = ["IMU, 1, 2", "nothing known", "FMT, x"]
    run = read(written(tmp_path, "\n".join(lines).encode(), "dive.txt"))
    assert run.repairs.damaged == 3
    assert len(run["p"]) == 200


def test_decoding_is_pymavlinks(tmp_path: Path) -> None:
    """Every number of every message of a hand-built log is what pymavlink's reader says."""
    from pymavlink import DFReader

    log = dive_bin(2.0, parameters=SIX)
    path = written(tmp_path, log.data)
    reader = DFReader.DFReader_binary(str(path))
    expected: dict[str, list[dict[str, float]]] = {}
    while (message := reader.recv_msg()) is not None:
        expected.setdefault(message.get_type(), []).append(message.to_dict())
    reader.close()
    tables = decode_binary(bytes(log.data), "log")
    for kind, rows in expected.items():
        found = tables.named(kind)
        assert sum(len(table) for table in found) == (0 if kind in ("FMT", "FMTU") else len(rows))
        for table in found:
            instance = [row for row in rows if row.get("I", row.get("C", 0)) == (table["I"][0] if "I" in table else 0)]
            for name in table.columns:
                assert table[name].tolist() == [row[name] for row in instance], (kind, name)


def test_letters_are_pymavlinks() -> None:
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    assert set(FORMAT_TO_STRUCT) == set(LETTERS)
    for letter, (code, scale, kind) in FORMAT_TO_STRUCT.items():
        ours = np.dtype([("x", LETTERS[letter][0])])
        assert ours.itemsize == np.dtype(f"S{code[:-1]}" if code.endswith("s") else f"<{code}").itemsize, letter
        if kind is not str:
            assert LETTERS[letter][1] == pytest.approx(1.0 / (scale or 1.0)), letter


def test_text_log_equals_binary(tmp_path: Path) -> None:
    log = dive_bin(2.0, parameters=SIX)
    binary, text = decode_binary(bytes(log.data), "b"), decode_text("\n".join(log.text).encode(), "t")
    assert list(binary.tables) == list(text.tables)
    assert binary.parameters == pytest.approx(text.parameters)
    for name, table in binary.tables.items():
        np.testing.assert_array_equal(table.t, text.tables[name].t)
        for column in table.columns:
            np.testing.assert_allclose(table[column], text.tables[name][column], rtol=1e-6, atol=1e-9)
