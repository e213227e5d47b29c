"""Files that a run wrote, read again: whatever is wrong with them is one sentence with its name."""

import io
import json
import struct
import zipfile

import numpy as np
import pytest

from dropo.core.services.errors import BadFile
from dropo.core.services.files.saved_files import (
    NPZ,
    names_in_npz,
    read_json,
    read_npy,
    read_npz,
    refusing_faults,
    require_shapes,
)

WHAT = "what a test wrote"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "expected what a test wrote, got no such file"),
        (b"", "no JSON"),
        (b'{"a": 1', "no JSON"),
        (b"\xff\xfe\x00", "no JSON"),
        (b"[1]", "an object with keys, got a list"),
        (b"null", "an object with keys, got a NoneType"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"a": NaN}', "NaN, which is no JSON"),
        (b'{"a": -Infinity}', "-Infinity, which is no JSON"),
        (b'{"version": "99.1"}', "version: expected .* or older .*, got 99.1"),
        (b'{"version": "99999999999999999999999999999999999999999999"}', "or older"),
    ],
)
def test_json_that_is_none(tmp_path, content, message):
    path = tmp_path / "file.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadFile, match=message) as caught:
        read_json(path, WHAT)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < len(str(path)) + 250


@pytest.mark.parametrize("version", ["", "0.0.1", "words", "0.1.0+local", None])
def test_older_versions_are_read(tmp_path, version):
    (tmp_path / "file.json").write_text(json.dumps({"version": version}))
    assert read_json(tmp_path / "file.json", WHAT) == {"version": version}


def test_arrays_are_those_of_numpy(tmp_path):
    """Bit for bit, whatever their type and order, packed or not; a part of them by name."""
    arrays = {
        "plain": np.arange(6.0).reshape(2, 3),
        "turned": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "empty": np.zeros((0, 4)),
        "single": np.float32(0.1),
        "words": np.array(["a", "bc"]),
        "flags": np.array([True, False]),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)
        found = read_npz(tmp_path / "a.npz", NPZ)
        assert list(found) == list(arrays) == names_in_npz(tmp_path / "a.npz", NPZ)
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)
            assert found[name].dtype == np.asarray(array).dtype
    assert list(read_npz(tmp_path / "a.npz", NPZ, ["flags", "other"])) == ["flags"]
    np.save(tmp_path / "a.npy", arrays["turned"])
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), arrays["turned"])


def archive(header: dict[str, object], body: bytes = b"", **options: int) -> bytes:
    """An .npz file with one array "x" of that header and body."""
    array = io.BytesIO()
    np.lib.format.write_array_header_1_0(array, header)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", **options) as file:
        file.writestr("x.npy", array.getvalue() + body)
    return out.getvalue()


def header(*shape: int, kind: str = "<f8") -> dict[str, object]:
    return {"descr": kind, "fortran_order": False, "shape": shape}


def with_flag(content: bytes, offset: int, value: int) -> bytes:
    """The archive with a field of its entry's two headers changed."""
    out = bytearray(content)
    for mark, place in ((b"PK\3\4", offset), (b"PK\1\2", offset + 2)):
        struct.pack_into("<H", out, content.index(mark) + place, value)
    return bytes(out)


WHOLE = archive(header(2), bytes(16))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "an empty file"),
        (b"words", "a file that cannot be read as one"),
        (WHOLE[:-30], "a file that cannot be read as one"),
        (WHOLE.replace(bytes(16), bytes(15) + b"1"), "x: .*corrupt"),
        (archive(header(10**12)), r"x: expected an array of numbers, got the shape \(10+,\)"),
        (archive(header(10**18, 10**18)), "x: .* got the shape"),
        (archive(header(-1), bytes(8)), "x: .* got the shape"),
        (archive(header(3), bytes(16)), r"x: .* got the shape \(3,\) and 16 bytes"),
        (archive(header(1, kind="|O"), bytes(8)), "x: .* got an array of Python objects"),
        (with_flag(WHOLE, 6, 1), "x: expected an array that is not encrypted"),
        (with_flag(WHOLE, 8, 97), "x: .*corrupt"),
    ],
)
def test_archives_that_are_none(tmp_path, content, message):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(BadFile, match=message):
        read_npz(tmp_path / "a.npz", NPZ)


def test_an_archive_that_unpacks_to_far_more(tmp_path, monkeypatch):
    """Before it is unpacked; what is packed as tightly and small is read."""
    path = tmp_path / "a.npz"
    path.write_bytes(archive(header(10**5), bytes(8 * 10**5), compression=zipfile.ZIP_DEFLATED))
    assert read_npz(path, NPZ)["x"].shape == (10**5,)
    monkeypatch.setattr("dropo.core.services.files.saved_files.LARGE", 10**5)
    with pytest.raises(BadFile, match="x: expected an array packed at most 100 times, got 800128"):
        read_npz(path, NPZ)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"y": None}, r"y: expected an array of numbers of shape \(W, p\), got nothing"),
        ({"y": np.zeros(3)}, r"of shape \(W, p\), got one of float64 of shape \(3,\)"),
        ({"y": np.zeros((3, 2))}, r"with W = 4, got one of float64 of shape \(3, 2\)"),
        ({"x": np.array(["a"] * 4)}, "x: expected an array of finite numbers"),
        ({"z": np.zeros((2, 1))}, r"z: .*of shape \(1, p\), got"),
        ({"x": np.array([0, 1, np.nan, 3])}, "x: expected an array of finite .* one with other"),
        ({"n": np.array(0.5)}, r"n: expected an array of whole numbers of shape \(\)"),
    ],
)
def test_shapes_that_do_not_fit(tmp_path, changed, message):
    rules = {"x": "finite W", "y": "number W p", "z": "number 1 p", "n": "whole"}
    arrays = {"x": np.zeros(4), "y": np.ones((4, 2)), "z": np.ones((1, 2)), "n": np.array(3)}
    require_shapes(tmp_path, arrays, rules)
    require_shapes(tmp_path, arrays, rules, {"p": 2})
    with pytest.raises(BadFile, match="with p = 3"):
        require_shapes(tmp_path, arrays, rules, {"p": 3})
    arrays = {name: a for name, a in {**arrays, **changed}.items() if a is not None}
    with pytest.raises(BadFile, match=message):
        require_shapes(tmp_path, arrays, rules)


def test_faults_of_a_content_are_refused_and_refusals_go_through(tmp_path):
    with (
        pytest.raises(BadFile, match="expected what a test wrote, got KeyError: 'a'"),
        refusing_faults(tmp_path, WHAT),
    ):
        {}["a"]
    with pytest.raises(BadFile, match="own"), refusing_faults(tmp_path, WHAT):
        raise BadFile(tmp_path, "own", "x", "y")
    with pytest.raises(OSError, match="full"), refusing_faults(tmp_path, WHAT):
        raise OSError("full")
