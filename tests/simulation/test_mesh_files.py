"""Mesh files: read alike from every format; refused with a reason when unusable."""

import os
import struct

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from palpate.simulation import load_mesh


@pytest.fixture
def block():
    """A block of 40 x 30 x 20, away from the origin."""
    mesh = trimesh.creation.box((40, 30, 20))
    mesh.apply_translation((100, -50, 7))
    return mesh


@pytest.fixture
def saved(block, tmp_path):
    """Write the block, or another mesh, under a name."""

    def save(name, mesh=None):
        path = tmp_path / name
        (block if mesh is None else mesh).export(path)
        return path

    return save


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".STL"])
def test_every_format_gives_the_same_object(saved, suffix):
    thing = load_mesh(saved("brick" + suffix))
    assert (thing.name, thing.category) == ("brick", "brick")
    assert_allclose(thing.mesh.bounds, [[-20, -15, 0], [20, 15, 20]], atol=1e-4)
    assert thing.mesh.is_watertight
    assert len(thing.resting_rotations) == 7  # as in the file, and on its six faces


def test_stl_files_of_text_are_read(saved, block, tmp_path):
    path = tmp_path / "text.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(block))
    assert_allclose(load_mesh(path).size_mm, [40, 30, 20], atol=1e-4)


@pytest.mark.parametrize(
    ("unit", "mm"), [("mm", 1), ("cm", 10), ("m", 1e3), ("in", 25.4), ("inch", 25.4)]
)
def test_units_are_converted_to_mm(saved, block, unit, mm):
    block.apply_scale(1 / mm)
    size = load_mesh(saved("b.ply"), unit=unit).size_mm
    assert_allclose(size, [40, 30, 20], rtol=1e-5)


def test_labels_can_be_given(saved):
    thing = load_mesh(saved("b.ply"), name="brick 1", category="brick")
    assert (thing.name, thing.category) == ("brick 1", "brick")


def test_split_corners_are_joined_again(tmp_path):
    """OBJ files with a normal per face repeat each corner; that is no hole."""
    box = trimesh.creation.box((40, 30, 20))
    lines = ["v {} {} {}".format(*v) for v in box.triangles.reshape(-1, 3)]
    lines += ["f {} {} {}".format(*t) for t in np.arange(1, 37).reshape(-1, 3)]
    path = tmp_path / "split.obj"
    path.write_text("\n".join(lines))
    assert len(load_mesh(path).mesh.vertices) == 8


def test_open_mesh_is_refused(saved, block):
    block.update_faces(np.arange(12) > 0)
    with pytest.raises(ValueError, match=r"watertight, got 3 of 18 edges.*close its"):
        load_mesh(saved("open.stl", block))


def test_bodies_that_share_a_face_are_refused(saved, block):
    """Two blocks side by side, as an assembly is exported: they have no holes."""
    both = trimesh.util.concatenate([block, block.copy().apply_translation((40, 0, 0))])
    with pytest.raises(ValueError, match="make one body of those that meet at an edge"):
        load_mesh(saved("both.stl", both))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.obj", b""),
        ("empty.stl", b""),
        ("empty.ply", b""),
        ("no_faces.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("no_triangles.stl", b"\0" * 80 + struct.pack("<I", 0)),
        ("garbage.stl", b"\xff\x00garbage" * 30),
        ("garbage.ply", b"ply\nformat ascii 1.0\nelement vertex"),
        ("cut.stl", b"\0" * 80 + struct.pack("<I", 12) + b"\0" * 100),
        ("lies.stl", b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 100),
        ("index.obj", b"v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 9\n"),
        (
            "claims.ply",
            (
                b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
                b"property float x\nproperty float y\nproperty float z\n"
                b"element face 1\nproperty list uchar int vertex_indices\n"
                b"end_header\n\0\0\0\0"
            ),
        ),
    ],
)
def test_damaged_and_empty_files_are_refused(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=name):
        load_mesh(path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("v 0 0 nan\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 2 3\nf 2 3 4\n", "finite"),
        ("v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 3\nf 1 3 2\n", "flat surface"),
        ("v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\n", "a cloud of points"),
    ],
)
def test_what_is_no_solid_is_refused(tmp_path, lines, message):
    path = tmp_path / "thing.obj"
    path.write_text(lines)
    with pytest.raises(ValueError, match=message):
        load_mesh(path)


@pytest.mark.parametrize(
    ("scale", "unit", "message"),
    [
        (1e-3, "mm", r"0\.04 mm.*in metres\? Pass `unit=m`"),
        (1, "m", r"in millimetres\? Pass `unit=mm`"),
        (1e9, "mm", "Scale it first"),
    ],
)
def test_a_size_in_another_unit_is_recognised(saved, block, scale, unit, message):
    block.apply_scale(scale)
    with pytest.raises(ValueError, match=message):
        load_mesh(saved("b.ply"), unit=unit)


def test_too_many_bytes_and_triangles_are_refused(saved, monkeypatch):
    path = saved("b.stl")
    many = trimesh.creation.box()
    many.faces = np.zeros((5_000_001, 3), dtype=np.int64)
    with monkeypatch.context() as patched:
        patched.setattr(trimesh, "load_mesh", lambda *args, **kwargs: many)
        with pytest.raises(ValueError, match="at most 5000000 triangles, got 5000001"):
            load_mesh(path)
    os.truncate(path, 200_000_001)  # sparse: takes no room
    with pytest.raises(ValueError, match=r"at most 200000000 bytes.*Simplify"):
        load_mesh(path)


def test_other_suffix_and_unit_are_refused(saved, tmp_path):
    (tmp_path / "b.glb").write_bytes(b"")
    with pytest.raises(ValueError, match=r"\.stl, \.obj, \.ply, got 'b\.glb'"):
        load_mesh(tmp_path / "b.glb")
    with pytest.raises(ValueError, match="unit must be one of 'mm', 'cm', 'm', 'in'"):
        load_mesh(saved("b.ply"), unit="yard")
    with pytest.raises(FileNotFoundError, match=r"no file '.*missing\.stl'\. Check"):
        load_mesh(tmp_path / "missing.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(FileNotFoundError, match=r"got no file '.*folder\.stl'"):
        load_mesh(tmp_path / "folder.stl")


def test_nothing_else_is_opened(saved, block, monkeypatch, tmp_path):
    """A mesh may name materials and pictures anywhere; none is looked for."""

    def refuse(*args, **kwargs):
        raise AssertionError(f"looked for another file: {args}")

    plain = saved("plain.obj").read_text()
    path = tmp_path / "evil.obj"
    path.write_text(f"mtllib ../../secret.mtl\nusemtl http://example.org/x\n{plain}")
    ply = saved("plain.ply").read_bytes()
    textured = tmp_path / "evil.ply"
    textured.write_bytes(ply.replace(b"\n", b"\ncomment TextureFile /etc/x.png\n", 2))
    for resolver in ("FilePathResolver", "WebResolver"):
        monkeypatch.setattr(trimesh.resolvers, resolver, refuse)
    assert_allclose(load_mesh(path).size_mm, [40, 30, 20], atol=1e-4)
    assert_allclose(load_mesh(textured).size_mm, [40, 30, 20], atol=1e-4)
