"""Files of somebody who means harm: nothing runs, nothing outside of the folder is read or written, memory holds out."""

import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from objgraph.cli.run_config import CONFIG, read_run
from objgraph.datasets.files import decode_depth, read_json
from objgraph.datasets.sens import SensFile
from objgraph.geometry.mesh_data import parse_mesh
from objgraph.maps.object_map import ObjectMap
from objgraph.priors.store import load_prior_file
from objgraph.training.deepsdf_files import load_experiment
from objgraph.training.meshes.files import read_mesh
from objgraph.training.meshes.index import read_index
from tests.fuzz.inputs import attempt
from tests.fuzz.scans import SCANS, read_lidar, read_scan, write_lidar
from tests.objgraph.datasets import dataset_folders as folders
from tests.objgraph.maps.map_cases import UP, mapped
from tests.objgraph.training.test_convert import LENGTH, SPECS

DEEP = b"[" * 10_000 + b"]" * 10_000


def refused(function: Callable[..., object], *args: object) -> str:
    """The words of the typed error that there must be."""
    error = attempt(function, *args)
    assert error is not None, "it was taken"
    return str(error)


@pytest.fixture
def outside(tmp_path) -> Path:
    """A folder beside the one that is given, with files that are good in themselves."""
    folder = tmp_path / "outside"
    folders.write_bytes(folder / "depth.png", folders.png(folders.depth_image()))
    folders.write_bytes(folder / "box.obj", parse_mesh(BOX, "obj").export(file_type="obj").encode())  # type: ignore[union-attr]
    return folder


BOX = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def ways_to(path: Path, folder: Path) -> list[str]:
    """Up and over, from the root, and through a link that lies in the folder."""
    link = folder / "link"
    link.symlink_to(path.parent)
    return [f"../{path.parent.name}/{path.name}", str(path), f"link/{path.name}"]


def test_names_in_transforms_stay_in_the_folder(tmp_path, outside):
    folder = folders.write_nerfstudio(tmp_path / "scan", folders.toy_scan(2))
    content = json.loads((folder / "transforms.json").read_text())
    for name in ways_to(outside / "depth.png", folder):
        content["frames"][0]["depth_file_path"] = name
        (folder / "transforms.json").write_text(json.dumps(content))
        assert "lies outside of" in refused(read_scan, "nerfstudio", folder)


def test_names_in_lists_of_images_stay_in_the_folder(tmp_path, outside):
    folder = folders.write_tum_sequence(tmp_path / "freiburg1", folders.toy_scan(2))
    for name in ways_to(outside / "depth.png", folder):
        (folder / "depth.txt").write_text(f"1305031102.16 {name}\n")
        assert "lies outside of" in refused(read_scan, "tum", folder)


def test_names_in_an_index_of_meshes_stay_in_the_folder(tmp_path, outside):
    folder = tmp_path / "meshes"
    folder.mkdir()
    for name in ways_to(outside / "box.obj", folder):
        entry = dict.fromkeys(("group", "licence", "attribution", "source_repo"), "-")
        entry |= {"file": name, "category": "chair", "size_m": None}
        (folder / "index.json").write_text(json.dumps({"meshes": [entry]}))
        assert "lies outside of" in refused(read_index, folder, "chair")


@pytest.mark.parametrize(
    "name", ["../outside/object.glb", "/etc/object.glb", "a/../object.glb", "..\\object.glb"]
)
@pytest.mark.parametrize("field", ["mesh", "joint_covariance"])
def test_names_in_a_map_stay_in_the_folder(tmp_path, name, field):
    folder = tmp_path / "map"
    ObjectMap("room", (mapped(1),), UP).save(folder)
    document = json.loads((folder / "map.json").read_text())
    document["objects"][0][field] = name if field == "mesh" else name.replace(".glb", ".safetensors")
    (folder / "map.json").write_text(json.dumps(document))
    assert "in the map's folder" in refused(ObjectMap.load, folder)


@pytest.mark.parametrize("field", ["catid_cad", "id_cad"])
def test_names_of_models_stay_in_their_folder(tmp_path, outside, field):
    write, _ = SCANS["scannet"]
    write(tmp_path)
    folders.write_bytes(outside / "models" / "model_normalized.obj", (outside / "box.obj").read_bytes())
    path = tmp_path / "scan2cad" / "full_annotations.json"
    content = json.loads(path.read_text())
    content[0]["aligned_models"][0][field] = "../../outside" if field == "id_cad" else "../../../outside/.."
    path.write_text(json.dumps(content))
    assert "outside of" in refused(read_scan, "scannet", tmp_path / "scannet")


def test_a_mesh_reads_no_other_file(tmp_path, outside, monkeypatch):
    """Neither materials nor pictures, though the file names them."""
    (outside / "secret.mtl").write_text("newmtl a\nmap_Kd depth.png\n")
    folder = tmp_path / "meshes"
    folders.write_bytes(folder / "a.obj", b"mtllib ../outside/secret.mtl\nusemtl a\n" + BOX)
    gltf = {"asset": {"version": "2.0"}, "buffers": [{"uri": "../outside/depth.png", "byteLength": 8}]}
    folders.write_bytes(folder / "b.glb", glb(gltf))
    ply = b"ply\nformat ascii 1.0\ncomment TextureFile ../outside/depth.png\nelement vertex 3\nproperty float x\n"
    ply += b"property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    folders.write_bytes(folder / "c.ply", ply + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    data = {path: path.read_bytes() for path in folder.iterdir()}
    monkeypatch.setattr("builtins.open", lambda *args, **_: pytest.fail(f"opened {args}"))
    monkeypatch.setattr(Path, "read_bytes", lambda path: data[path])
    assert len(read_mesh(folder / "a.obj").faces) == 4
    assert len(read_mesh(folder / "c.ply").faces) == 1
    assert "cannot be read as a mesh" in refused(read_mesh, folder / "b.glb")


def test_json_that_is_nested_deep_is_refused(tmp_path):
    (tmp_path / "a.json").write_bytes(DEEP)
    assert "nested" in refused(read_json, tmp_path / "a.json")
    (tmp_path / CONFIG).write_bytes(b'{"dataset": ' + DEEP + b"}")
    assert "nested" in refused(read_run, tmp_path / CONFIG, {}, {})
    (tmp_path / "map.json").write_bytes(b'{"objects": ' + b"[" * 500 + b"]" * 500 + b"}")
    assert "nested" in refused(ObjectMap.load, tmp_path)
    (tmp_path / "index.json").write_bytes(DEEP)
    assert "nested" in refused(read_index, tmp_path, "chair")
    (tmp_path / "specs.json").write_bytes(DEEP)
    assert "nested" in refused(load_experiment, tmp_path)


def header_of_png(width: int, height: int, depth: int = 16) -> bytes:
    """An image that says how large it is, and has next to nothing of it."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0))]
    chunks += [(b"IDAT", zlib.compress(bytes(100))), (b"IEND", b"")]
    body = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


@pytest.mark.parametrize("size", [(30_000, 30_000), (2**31 - 1, 2**31 - 1), (10**9, 1)])
def test_an_image_of_huge_size_is_refused_before_it_is_unpacked(size):
    assert "pixels" in refused(decode_depth, header_of_png(*size), "depth/0.png", 1000.0)


def test_masks_of_huge_size_are_refused(tmp_path):
    folder = folders.write_plain_folder(tmp_path, folders.toy_scan(1))
    mask = next((folder / "masks").iterdir())
    mask.unlink()
    runs = {"size": [10**6, 10**6], "counts": [0, 10**12]}
    mask.with_suffix(".json").write_text(json.dumps([{"segmentation": runs, "instance_id": 1}]))
    assert "pixels" in refused(read_scan, "folder", folder)


def test_an_archive_that_unpacks_to_gigabytes_is_refused(tmp_path):
    write, read = SCANS["scannet"]
    write(tmp_path)
    folder = tmp_path / "scannet" / "scans" / folders.SCENE
    archive = folder / f"{folder.name}_2d-instance-filt.zip"
    with (
        zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file,
        file.open("instance-filt/0.png", "w") as member,
    ):
        for _ in range(300):
            member.write(bytes(2**20))
    assert archive.stat().st_size < 10**6
    assert "would unpack to" in refused(read, tmp_path)


def test_depth_that_unpacks_to_gigabytes_is_refused(tmp_path):
    good = folders.sens_bytes(1)
    depth = zlib.compress(folders.depth_image().astype("<u2").tobytes())
    bomb = zlib.compress(bytes(2**27))
    at = good.index(depth)
    folders.write_bytes(
        tmp_path / "a.sens",
        good[:at].replace(struct.pack("<Q", len(depth)), struct.pack("<Q", len(bomb))) + bomb,
    )
    assert "16-bit pixels" in refused(lambda: SensFile(tmp_path / "a.sens").depth(0))


def glb(document: dict, data: bytes = b"") -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    parts = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


def triangle(**changes: object) -> dict:
    """A GLB document of one triangle."""
    return {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "buffers": [{"byteLength": 48}], **changes,
    }  # fmt: skip


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()


def test_a_triangle_is_one():
    assert len(parse_mesh(glb(triangle(), CORNERS), "glb").faces) == 1


@pytest.mark.parametrize(
    "document",
    [
        triangle(accessors=[{"componentType": 5126, "count": 10**9, "type": "MAT4"}] * 2),
        triangle(accessors=[{"bufferView": 0, "componentType": 5126, "count": -5, "type": "VEC3"}] * 2),
        triangle(nodes=[{"mesh": 0, "children": [0]}]),
        triangle(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}]),
        triangle(
            images=[{"uri": "../outside/depth.png"}], textures=[{"source": 0}], extensionsRequired=["x"]
        ),
    ],
)
def test_a_scene_that_asks_for_more_than_it_has_ends(tmp_path, document):
    folders.write_bytes(tmp_path / "a.glb", glb(document, CORNERS))
    attempt(read_mesh, tmp_path / "a.glb")


def test_a_mesh_that_is_shown_a_million_times_is_refused(tmp_path):
    many = np.tile(np.arange(3, dtype="<u4"), 40_000).tobytes()
    document = triangle(
        scenes=[{"nodes": list(range(300))}],
        nodes=[{"mesh": 0}] * 300,
        bufferViews=[
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": len(many)},
        ],
        buffers=[{"byteLength": 36 + len(many)}],
    )
    document["accessors"][1]["count"] = 120_000
    folders.write_bytes(tmp_path / "a.glb", glb(document, CORNERS[:36] + many))
    assert "more than" in refused(read_mesh, tmp_path / "a.glb")


HEADERS = {
    "a.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 100000000\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 100000000\nproperty list uchar int vertex_indices\nend_header\n",
    "b.ply": b"ply\nformat ascii 1.0\nelement vertex 100000000\nproperty float x\nproperty float y\nproperty float z\n"
    b"end_header\n1 2 3\n",
    "c.stl": bytes(80) + struct.pack("<I", 10**8) + bytes(50),
    "d.off": b"OFF\n100000000 100000000 0\n0 0 0\n",
    "e.obj": b"v 0 0 0\nf 1 100000000 2\n",
    "f.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9 -8 -7\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_mesh_of_faces_that_its_header_alone_has_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(HEADERS[name])
    assert name in refused(read_mesh, tmp_path / name)


PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nPOINTS {points}\nDATA {form}\n"


@pytest.mark.parametrize(
    ("count", "points", "form", "body"),
    [
        ("1 1 1", 10**8, "binary", bytes(60)),
        ("1 1 1", 10**8, "ascii", b"1 2 3\n"),
        ("1 1 -1", 5, "binary", bytes(60)),
        ("1 1 1000000000", 1, "binary", bytes(60)),
        # what open3d believes, and reads beyond its memory
        ("1 1 1", 10**8, "binary_compressed", struct.pack("<II", 13, 12) + b"\x0b" + bytes(12)),
        ("1 1 1", 10**8, "binary_compressed", struct.pack("<II", 13, 12 * 10**8) + b"\x0b" + bytes(12)),
        ("1 1 1", 1, "binary_compressed", struct.pack("<II", 2, 12) + b"\xff\xff"),
    ],
)
def test_points_that_a_header_alone_has_are_refused(tmp_path, count, points, form, body):
    write_lidar(tmp_path, "pcd")
    head = PCD.format(count=count, points=points, form=form).encode()
    (tmp_path / "points.pcd").write_bytes(head + body)
    assert "no readable points" in refused(read_lidar, tmp_path)


class Harm:
    """Makes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_pickles_in_disguise_do_not_run(tmp_path):
    mark = tmp_path / "harm"
    harm = pickle.dumps(Harm(mark))
    experiment = tmp_path / "experiment"
    folders.write_bytes(experiment / "specs.json", json.dumps(SPECS).encode())
    (experiment / "ModelParameters").mkdir()
    model = experiment / "ModelParameters" / "latest.pth"
    torch.save({"model_state_dict": {"lin0.weight": Harm(mark)}}, model)
    assert "could run code" in refused(load_experiment, experiment)
    model.write_bytes(harm)
    refused(load_experiment, experiment)
    (experiment / "LatentCodes").mkdir()
    torch.save({"latent_codes": Harm(mark), "length": LENGTH}, experiment / "LatentCodes" / "latest.pth")
    refused(load_experiment, experiment)
    np.save(tmp_path / "a.npy", np.array([Harm(mark)], dtype=object), allow_pickle=True)
    for data in (harm, (tmp_path / "a.npy").read_bytes()):
        (tmp_path / "lamp.safetensors").write_bytes(data)
        refused(load_prior_file, tmp_path / "lamp.safetensors")
        write_lidar(tmp_path / "lidar", "bin")
        (tmp_path / "lidar" / "points.bin").unlink()
        (tmp_path / "lidar" / "points.ply").write_bytes(data)
        refused(read_lidar, tmp_path / "lidar")
        (tmp_path / "lidar" / "points.ply").unlink()
    assert not mark.exists()
