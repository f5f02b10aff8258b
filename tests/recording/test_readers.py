"""One way in: suffix and content choose the reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording import ColumnMapping, Recording

RUN = Recording.from_table(np.arange(5.0), {"u": np.arange(5.0)})


def test_by_suffix_and_content(tmp_path: Path) -> None:
    for name in ("a.csv", "a.parquet", "A.CSV"):
        RUN.write(tmp_path / name)
        assert read(tmp_path / name)["u"] == RUN["u"]
    (tmp_path / "a.parquet").rename(tmp_path / "renamed.csv")
    (tmp_path / "a.csv").rename(tmp_path / "a.txt")
    assert read(tmp_path / "renamed.csv")["u"] == RUN["u"]
    assert read(str(tmp_path / "a.txt"))["u"] == RUN["u"]
    assert read(tmp_path / "a.txt", ColumnMapping.model_validate({"columns": {"v": "u"}})).names == ("v",)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"\x1f\x8b\x08", "gzip"),
        ("a.csv", b"PK\x03\x04", "spreadsheet"),
        ("a.xyz", b"\0\1\2", r'cannot read this file \("\.xyz"\); can be read: \.csv, .*\.parquet'),
        ("a.csv", b"", "the file is empty"),
    ],
)
def test_other_kinds_say_what_can_be_read(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read(tmp_path / name)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        read(tmp_path / "none.csv")
    with pytest.raises(InputError, match="this is a folder"):
        read(tmp_path)
