"""PCD files: what open3d writes is read as it reads it; what is damaged is refused."""

import struct

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from objgraph.datasets.pcd import parse_pcd


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ascii_form", [False, True])
@pytest.mark.parametrize("colours", [False, True])
@pytest.mark.parametrize("repeated", [1, 50])
def test_what_open3d_writes_is_read_as_it_reads_it(tmp_path, compressed, ascii_form, colours, repeated):
    rng = np.random.default_rng(0)
    points = np.tile(rng.normal(size=(200, 3)), (repeated, 1))  # what repeats is compressed by copies
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if colours:
        cloud.colors = o3d.utility.Vector3dVector(rng.uniform(size=points.shape))
        cloud.normals = o3d.utility.Vector3dVector(points)
    path = str(tmp_path / "a.pcd")
    o3d.io.write_point_cloud(path, cloud, "pcd", ascii_form, compressed)
    expected = np.asarray(o3d.io.read_point_cloud(path).points)
    np.testing.assert_allclose(parse_pcd((tmp_path / "a.pcd").read_bytes()), expected, rtol=1e-6, atol=1e-9)


def head(**changes: str) -> bytes:
    fields = {
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "POINTS": "2",
        "DATA": "binary",
    }
    return (
        b"# a comment\nVERSION .7\n" + "".join(f"{k} {v}\n" for k, v in (fields | changes).items()).encode()
    )


def test_fields_of_all_types_lie_where_the_header_says():
    layout = np.dtype([("i", "u1"), ("z", "<f8"), ("_", "V6"), ("x", "<f4"), ("y", "<i2"), ("n", "<f4", 3)])
    rows = np.zeros(2, layout)
    rows["x"], rows["y"], rows["z"] = [1.5, 2.5], [-3, 4], [1e-3, 7]
    header = head(FIELDS="i z _ x y n", SIZE="1 8 1 4 2 4", TYPE="U F U F I F", COUNT="1 1 6 1 1 3")
    np.testing.assert_array_equal(
        parse_pcd(header + rows.tobytes()), np.column_stack([rows[k].astype(float) for k in "xyz"]).round(7)
    )


@given(st.lists(st.sampled_from([b"\0", b"ab", b"abcabcabc", b"xyz" * 100]), min_size=8).map(b"".join))
def test_runs_and_copies_are_unpacked(text):
    """By a packer of its own: literals, and copies of the byte or the three bytes before."""
    size = len(text) // 12 * 12
    text, packed, at = text[:size], bytearray(), 0
    while at < size:
        for back in (1, 3):
            length = 0
            while (
                at >= back
                and at + length < size
                and length < 264
                and text[at + length] == text[at + length - back]
            ):
                length += 1
            if length >= 3:
                short = min(length - 2, 7)
                packed += bytes([short << 5] if short < 7 else [224, length - 9]) + bytes([back - 1])
                break
        else:
            length = 1
            packed += bytes([0, text[at]])
        at += length
    data = struct.pack("<II", len(packed), size) + packed
    header = head(
        FIELDS="x y z",
        SIZE="1 1 1",
        TYPE="U U U",
        COUNT="4 4 4",
        POINTS=str(size // 12),
        DATA="binary_compressed",
    )
    if not size:
        return
    columns = np.frombuffer(text, np.uint8).reshape(3, -1, 4)[:, :, 0]
    np.testing.assert_array_equal(parse_pcd(header + data), columns.T)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "no PCD header"),
        (head(DATA="text") + bytes(24), "DATA 'text'"),
        (head(FIELDS="x y w") + bytes(24), "no field z"),
        (head(SIZE="4 4") + bytes(24), "do not fit"),
        (head(SIZE="4 4 3") + bytes(24), "field z"),
        (head(TYPE="F F X") + bytes(24), "field z"),
        (head(COUNT="1 1 -1") + bytes(24), "field z"),
        (head(COUNT="1 1 0") + bytes(24), "field z"),
        (head(POINTS="-2") + bytes(24), "POINTS"),
        (head(POINTS="0"), "truncated or empty"),
        (head() + bytes(23), "truncated or empty"),
        (head(DATA="ascii") + b"1 2 3 4 5\n", "truncated or empty"),
        (head(DATA="ascii") + b"1 2 3 4 5 x\n", "could not convert"),
        (head(DATA="binary_compressed") + bytes(3), "truncated"),
        (
            head(DATA="binary_compressed") + struct.pack("<II", 13, 12) + b"\x0b" + bytes(12),
            "not those of its points",
        ),
        (head(DATA="binary_compressed") + struct.pack("<II", 2, 24) + b"\x20\x00", "what is not there"),
        (head(DATA="binary_compressed") + struct.pack("<II", 2, 24) + b"\x05\x00", "in place of"),
    ],
)
def test_what_is_damaged_is_refused(data, reason):
    with pytest.raises(ValueError, match=reason):
        parse_pcd(data)
