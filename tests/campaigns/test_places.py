"""Object stores that refuse, and logs by their patterns; a stand-in answers as S3 does where a bucket is missing."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from towtank.app.terminal.guard import line_of
from towtank.campaigns.places import Unreachable, logs_of, patiently, place_of, remote_place, without_credentials
from towtank.errors import InputError


class Refusing(BaseHTTPRequestHandler):
    """Has no bucket but one, to which nobody has access."""

    def do_GET(self) -> None:
        code = 403 if self.path.startswith("/closed") else 404
        self.send_response(code)
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_HEAD = do_PUT = do_POST = do_GET

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def _endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    server = HTTPServer(("127.0.0.1", 0), Refusing)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "nobody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    remote_place.cache_clear()
    yield
    remote_place.cache_clear()
    server.shutdown()
    server.server_close()


@pytest.mark.usefixtures("_endpoint")
def test_a_bucket_that_is_missing_is_one_line() -> None:
    with pytest.raises(InputError, match=r"^s3://nowhere/store: there is no such bucket; create it first"):
        place_of("s3://nowhere/store")


@pytest.mark.usefixtures("_endpoint")
def test_a_bucket_that_nobody_may_use_asks_for_credentials() -> None:
    with pytest.raises(InputError, match=r"^s3://closed/store: access is denied, expected credentials .*AWS_ACCESS"):
        place_of("s3://key:secret@closed/store")


def test_other_schemes_and_places_without_a_bucket_are_refused() -> None:
    with pytest.raises(InputError, match=r"^ftp://host/store: found ftp://, expected s3://BUCKET/FOLDER"):
        place_of("ftp://host/store")
    with pytest.raises(InputError, match=r"^s3:///store: names no bucket"):
        place_of("s3:///store")
    with pytest.raises(InputError, match=r"^s3://\[b/x: names no bucket"):
        place_of("s3://key:secret@[b/x")


@pytest.mark.parametrize("pattern", ["**.BIN", ".", "~nobody-at-all/*.BIN"])
def test_what_is_no_pattern_of_paths_is_one_line(pattern: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no pattern of paths"):
        logs_of(pattern, tmp_path)


def test_a_store_that_is_a_file_or_below_one_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file: this is a file, expected a folder"):
        place_of(str(tmp_path / "file"))
    below = place_of(str(tmp_path / "file" / "store"))
    assert below.read("campaign.json") is None
    with pytest.raises(InputError, match="store: cannot be made a folder"):
        below.write("campaign.json", b"")


def test_messages_hold_no_credentials() -> None:
    assert without_credentials("s3://key:secret@archive/logs?endpoint_override=x") == "s3://archive/logs"
    assert without_credentials("s3://key:sec/ret@archive/a@b?.BIN") == "s3://b?.BIN"
    assert without_credentials("s3://archive/a@b#c?.BIN") == "s3://archive/a@b#c?.BIN"


def test_what_fails_now_and_then_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.campaigns.places._FIRST_PAUSE", 0.0)
    answers = iter([OSError("503 slow down"), OSError("reset by peer"), 7])

    def ask() -> int:
        answer = next(answers)
        if isinstance(answer, OSError):
            raise answer
        return answer

    assert patiently(ask, "place") == 7
    answers = iter([OSError("503 slow down")] * 100)
    with pytest.raises(Unreachable, match=r"^place: 503 slow down, 8 times in a row; check the network, ") as found:
        patiently(ask, "place")
    assert line_of(found.value) == (f"towtank: {found.value}", 1)  # a line of ours, without a word of Python
    assert str(pickle.loads(pickle.dumps(found.value))) == str(found.value)  # from a worker


def test_a_file_is_whole_or_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = place_of(str(tmp_path / "store"))
    place.write("parts/a.parquet", b"first")
    assert (place.names("parts", ".parquet"), place.read("parts/a.parquet")) == ({"a"}, b"first")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        place.write("parts/a.parquet", b"second")
    assert place.read("parts/a.parquet") == b"first"
    assert [path.name for path in (tmp_path / "store" / "parts").iterdir()] == ["a.parquet"]


def test_patterns_name_files_and_bags_and_no_other_folders(tmp_path: Path) -> None:
    for name in ("a.bin", "deep/b.bin", "deep/er/c.bin", "bag/metadata.yaml", "bag/x.db3", "other/x.db3"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)

    def labels(pattern: str) -> list[str]:
        return [each.label for each in logs_of(pattern, tmp_path)]

    assert labels("*.bin") == ["a.bin"]
    assert labels("**/*.bin") == ["a.bin", "deep/b.bin", "deep/er/c.bin"]
    assert labels("*") == ["a.bin", "bag"]
    assert labels(str(tmp_path / "deep" / "*.bin")) == ["deep/b.bin"]


def test_a_relative_path_is_of_the_folder_that_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert place_of("results").root == str(tmp_path / name / "results")
