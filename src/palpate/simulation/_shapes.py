"""Closed surfaces to build objects from, in millimetres, z upwards.

Each function returns a watertight `trimesh.Trimesh`, outward side out. Bodies that
overlap are joined without cutting (`joined`): a ray from outside meets the same
surface either way, only volumes would be counted twice.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._extras import needed
from .._types import Floats

Mesh = Any  # trimesh.Trimesh, whose package is an extra


def needed_for_objects(module: str) -> Any:
    """Import a package of the extra `sim`, or say what to install."""
    return needed(module, "sim", "Simulating touches on 3-D objects")


def trimesh() -> Any:
    """Return the package `trimesh`, or say what to install."""
    return needed_for_objects("trimesh")


def joined(*meshes: Mesh) -> Mesh:
    """Put bodies together; they may overlap."""
    return trimesh().util.concatenate(meshes)


def moved(mesh: Mesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Mesh:
    """Return a copy moved by (x, y, z) mm."""
    copy = mesh.copy()
    copy.apply_translation((x, y, z))
    return copy


def hull(points: ArrayLike) -> Mesh:
    """Return the convex hull of points, (n_points, 3)."""
    return trimesh().PointCloud(np.asarray(points, float)).convex_hull


def ball_points(centre: ArrayLike, radius: float, n: int = 16) -> Floats:
    """Return points on a ball, (n * (n // 2 + 1), 3), for hulls."""
    polar = np.linspace(0, np.pi, n // 2 + 1)[:, None]
    around = np.arange(n) * (2 * np.pi / n)
    x = np.sin(polar) * np.cos(around)
    y = np.sin(polar) * np.sin(around)
    z = np.cos(polar) + 0 * around
    return np.asarray(centre, float) + radius * np.stack([x, y, z], -1).reshape(-1, 3)


def rounded_hull(corners: ArrayLike, radius: float, n: int = 16) -> Mesh:
    """Return the hull of balls at the corners: a convex body with round edges."""
    balls = [ball_points(corner, radius, n) for corner in np.asarray(corners)]
    return hull(np.concatenate(balls))


def rounded_box(size: ArrayLike, radius: float, n: int = 16) -> Mesh:
    """Return a box standing on z = 0, its centre above the origin, edges rounded."""
    half = np.asarray(size, float) / 2
    signs = np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T
    return moved(rounded_hull(signs * (half - radius), radius, n), z=half[2])


def revolved(profile_rz: ArrayLike, n: int = 96) -> Mesh:
    """Turn a profile (r, z), (n_points, 2), about z; it starts and ends at r = 0."""
    r, z = np.asarray(profile_rz, float).T
    around = np.arange(n) * (2 * np.pi / n)
    x, y = r[:, None] * np.cos(around), r[:, None] * np.sin(around)
    return lofted(np.stack([x, y, np.repeat(z[:, None], n, 1)], -1))


def lofted(rings: ArrayLike) -> Mesh:
    """Skin closed rings, (n_rings, n_around, 3), and close both ends with fans."""
    skin = np.asarray(rings, float)
    n_rings, n, _ = skin.shape
    this = np.arange(n_rings * n).reshape(n_rings, n)
    right = np.roll(this, -1, axis=1)
    a, b, c, d = this[:-1], right[:-1], right[1:], this[1:]
    sides = [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    first, last = n_rings * n, n_rings * n + 1
    bottom = np.stack([np.full(n, first), right[0], this[0]], -1)
    top = np.stack([np.full(n, last), this[-1], right[-1]], -1)
    ends = skin[[0, -1]].mean(axis=1)
    vertices = np.concatenate([skin.reshape(-1, 3), ends])
    mesh = trimesh().Trimesh(vertices, np.concatenate([*sides, bottom, top]))
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    if mesh.volume < 0:
        mesh.invert()
    return mesh
